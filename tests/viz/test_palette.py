"""Colours of runs: forty that can be told apart on either paper."""

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from topobatch.viz.palette import DARK, LIGHT, Theme, rgb


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_no_two_of_forty_runs_are_drawn_nearly_alike(theme: Theme) -> None:
    colours = np.array([rgb(theme.run(rank)) for rank in range(40)], np.uint8)
    lab = rgb2lab(colours)
    apart = deltaE_ciede2000(lab[:, None], lab[None]) + 100 * np.eye(len(lab))
    assert apart.min() > 8  # 1 is just noticeable
