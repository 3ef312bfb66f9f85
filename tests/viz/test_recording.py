"""What recordings are written with."""

import numpy as np
import pytest
import rerun as rr

from topobatch.viz.recording import strips


@pytest.mark.parametrize("sizes", [(), (2,), (2, 5, 3, 2), (0, 2)])
def test_lines_taken_together_are_those_that_rerun_makes(sizes):
    lines = [np.arange(2.0 * n).reshape(n, 2) + k / 3 for k, n in enumerate(sizes)]
    ours, theirs = (rr.components.LineStrip2DBatch(x) for x in (strips(lines), lines))
    assert ours.as_arrow_array() == theirs.as_arrow_array()
    assert len(ours) == len(lines)
