"""Settings of trusted merging."""

import pytest

from topobatch.merge.robust.settings import RobustSettings


def test_settings_are_checked():
    with pytest.raises(ValueError, match="false_merge_rate"):
        RobustSettings(false_merge_rate=0.0)
    with pytest.raises(ValueError, match="min_matches"):
        RobustSettings(min_matches=1)
