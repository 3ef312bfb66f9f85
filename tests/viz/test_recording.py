"""What recordings are written with."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from topobatch.viz.recording import Recording, blueprint, strips, write_recording

from .readback import Readback


@pytest.mark.parametrize("sizes", [(), (2,), (2, 5, 3, 2), (0, 2)])
def test_lines_taken_together_are_those_that_rerun_makes(sizes):
    lines = [np.arange(2.0 * n).reshape(n, 2) + k / 3 for k, n in enumerate(sizes)]
    ours, theirs = (rr.components.LineStrip2DBatch(x) for x in (strips(lines), lines))
    assert ours.as_arrow_array() == theirs.as_arrow_array()
    assert len(ours) == len(lines)


def test_entities_logged_together_are_those_logged_one_by_one(tmp_path: Path) -> None:
    names, xy = ["a", "none", "b"], np.arange(8.0).reshape(4, 2)
    own = {"a": xy[:1], "b": xy[1:]}
    hues = np.array([(9, 8, 7), (0, 0, 0), (6, 5, 4)], np.uint8)

    def together(recording: Recording) -> rrb.Blueprint:
        points = rr.Points2D.from_fields(positions=xy, radii=0.5, labels=list("pqrs"))
        once = rr.Points2D.from_fields(colors=hues)
        recording.static_each([(name,) for name in names], [1, 0, 3], points, once=once)
        return blueprint(rrb.Tabs(), rrb.TimePanel())

    def apart(recording: Recording) -> rrb.Blueprint:
        for name, labels in (("a", ["p"]), ("b", ["q", "r", "s"])):
            hue = hues[names.index(name)]
            points = rr.Points2D(own[name], radii=0.5, colors=[hue], labels=labels)
            recording.static((name,), points)
        return blueprint(rrb.Tabs(), rrb.TimePanel())

    found = []
    for fill in (together, apart):
        write_recording(tmp_path / "points.rrd", "points", fill)
        found.append(Readback(tmp_path / "points.rrd"))
    assert found[0].entities == {"/a", "/b"}
    assert found[0].content() == found[1].content()
