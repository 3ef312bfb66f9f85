"""`import topobatch`: what it offers, that its examples are right, and that it costs nothing."""

from __future__ import annotations

import doctest
import inspect
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import topobatch
from topobatch.cli import ingest as command
from topobatch.cli import library

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "library.md"


def test_examples_of_the_docstrings_are_right(monkeypatch) -> None:
    monkeypatch.chdir(ROOT)
    failed, tried = doctest.testmod(library, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert failed == 0
    assert tried > 6


def test_examples_of_the_page_are_right(monkeypatch, tmp_path) -> None:
    """All blocks of docs/library.md, one after the other, as a reader would type them."""
    monkeypatch.chdir(ROOT)
    text = PAGE.read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 5
    joined = "\n".join(blocks).replace('"out"', repr(str(tmp_path / "out")))
    test = doctest.DocTestParser().get_doctest(joined, {}, PAGE.name, str(PAGE), 0)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    said: list[str] = []
    runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)


@pytest.mark.parametrize("name", topobatch.__all__)
def test_everything_offered_is_described(name) -> None:
    assert getattr(library, name).__doc__
    assert name in PAGE.read_text()
    assert callable(getattr(topobatch, name))


def test_folders_stay_folders_and_can_be_called() -> None:
    code = (
        "import topobatch\n"
        "assert callable(topobatch.ingest) and callable(topobatch.merge)\n"
        "import topobatch.ingest.mapping, topobatch.merge.merging\n"
        "from topobatch import ingest, merge\n"
        "assert ingest is topobatch.ingest and callable(ingest) and callable(merge)\n"
        "assert callable(topobatch.ingest.mapping.build_map)\n"
        "try: topobatch.nothing\n"
        "except AttributeError as error: assert 'nothing' in str(error)\n"
        "else: raise SystemExit(1)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_importing_it_loads_nothing() -> None:
    code = (
        "import sys; before = set(sys.modules); import topobatch\n"
        "own = {m for m in sys.modules if m.split('.')[0] == 'topobatch'}\n"
        "print(sorted(own), 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['topobatch'] False"


def test_ingest_takes_what_the_command_takes() -> None:
    of_the_command = {
        "logs",
        "workspace",
        "jobs",
        "force",
        "quiet",
        "verbose",
        "as_json",
        "context",
    }
    offered = set(inspect.signature(library.ingest).parameters) - {"log"}
    assert offered == set(inspect.signature(command.ingest).parameters) - of_the_command


@pytest.mark.parametrize(
    "option",
    [
        {"closure": "most"},
        {"scan_stamp": "last"},
        {"junctions_from": "sonar"},
        {"time": "now"},
        {"laser_pose": (1.0, 2.0)},
        {"laser_pose": (1.0, 2.0, np.nan)},
        {"cloud_band": (1.0,)},
        {"cloud_band": (2.0, 1.0)},
    ],
    ids=str,
)
def test_options_that_make_no_sense_are_refused(option) -> None:
    from topobatch.topology.errors import UsageError

    named = f"--{next(iter(option)).replace('_', '-')}"
    with pytest.raises(UsageError, match=named):
        topobatch.ingest(ROOT / "sample_logs" / "maze-1.mcap", **option)


def test_several_logs_may_be_given_as_people_have_them(tmp_path) -> None:
    """As texts, paths or patterns, in any sequence, with folders; of one name, too."""
    logs = [ROOT / "sample_logs" / name for name in ("maze-1.mcap", "maze-2.bag")]
    for robot, log in zip(("r1", "r2"), logs, strict=True):
        (tmp_path / robot).mkdir()
        shutil.copy(log, tmp_path / robot / f"run{log.suffix}")
    ways = (
        [str(tmp_path / "r1" / "run.mcap"), tmp_path / "r2" / "run.bag"],
        (tmp_path / robot for robot in ("r1", "r2")),
        [tmp_path],
        tmp_path,
        str(tmp_path / "*" / "run.*"),
    )
    for way in ways:
        assert [m.run for m in topobatch.ingest(way)] == ["r1-run", "r2-run"]
    (alone,) = topobatch.ingest(str(tmp_path / "r1"))
    assert alone.run == "run"


def test_calls_that_cannot_be(tmp_path) -> None:
    from topobatch.topology.errors import LogError, TopobatchError, UsageError

    with pytest.raises(LogError, match="nowhere"):
        topobatch.ingest(tmp_path / "nowhere.mcap")
    with pytest.raises(LogError, match="nothing matches"):
        topobatch.ingest(str(ROOT / "sample_logs" / "none-*"))
    with pytest.raises(UsageError, match="a MergeResult is needed"):
        topobatch.explain(None, [], "a", "b")
    with pytest.raises(UsageError, match="name goes with one log; 5 are given"):
        topobatch.ingest([ROOT / "sample_logs"], name="x")
    with pytest.raises(LogError, match="nowhere"):
        topobatch.ingest([ROOT / "sample_logs", "nowhere"])
    with pytest.raises(UsageError, match="false_merge_rate"):
        topobatch.merge([], false_merge_rate=2.0)
    with pytest.raises(TopobatchError):
        topobatch.read_map(tmp_path / "nowhere.json")


def test_the_notebook_runs(monkeypatch, capsys) -> None:
    cells = json.loads((ROOT / "docs" / "tour.ipynb").read_text())["cells"]
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)  # as a notebook does
    assert repr(names["maps"]).startswith("(<map of maze-1: 26 junctions, 29 corridors of 156 m>")
    assert repr(names["result"]).startswith("<merge of 4 runs: 1 site, 1 run alone; pairs: 2 ")
    assert "12 junctions and 13 corridors agree" in capsys.readouterr().out
    picture = topobatch.draw(names["result"], names["maps"])
    assert picture._repr_svg_().startswith("<?xml")
    assert names["graph"].startswith('{"type": "FeatureCollection"')
    assert len(topobatch.to_dataframe(names["maze"])) == len(names["maze"])


def test_what_a_merge_does_not_have_is_said() -> None:
    from topobatch.topology.errors import UsageError

    (maze,) = topobatch.ingest(ROOT / "sample_logs" / "maze-1.mcap")
    result = topobatch.merge([maze])
    result = replace(result, components=(replace(result.components[0], site="maze"),))
    assert topobatch.site_map(result, [maze], "maze").run == "maze"
    with pytest.raises(UsageError, match="no run 'lab' was merged; there are maze-1"):
        topobatch.explain(result, [maze], "maze-1", "lab")
    with pytest.raises(UsageError, match="no map is exported as 'dxf': nav2"):
        topobatch.export(maze, "dxf")
    with pytest.raises(UsageError, match="of a merge that of a site: site_map"):
        topobatch.export(result, "nav2")
    with pytest.raises(UsageError, match="no table of 'rooms'"):
        topobatch.to_dataframe(maze, "rooms")
