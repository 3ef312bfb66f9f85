"""What newcomers meet: the examples of every `--help` work; a fault has one message, one code."""

from __future__ import annotations

import bz2
import gzip
import re
import shlex
import shutil

import pytest

from topobatch.cli.main import COMMANDS
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.writing import write_run

from ..conftest import command as call_topobatch

NAMES = tuple(COMMANDS)


@pytest.fixture(scope="session")
def site(once):
    """A folder as the examples have it: logs of three overlapping runs, their merge, and docks."""
    settings = ScenarioSettings(
        runs=3, junctions_per_run=12, overlap=0.6, drift="low", odometry_hz=10, seed=5
    )

    def make(folder):
        places = ("run1.mcap", "run2.bag", "rosbag2_folder")
        simulated = simulate_scenario(settings).simulated
        for name, kind, one in zip(places, ("mcap", "bag", "db3"), simulated, strict=True):
            written = write_run(folder / kind, one, kind)
            shutil.move(written, folder / name)
            shutil.rmtree(folder / kind)
        (folder / "logs").mkdir()
        shutil.copy(folder / "run1.mcap", folder / "logs")
        (folder / "docks.csv").write_text("name,x,y\nstart,0,0\n")

    return once("site", make)


@pytest.fixture(scope="session")
def merged_site(site, once):
    """The same, with `topobatch-workspace` in it: run1, run2, run3."""

    def make(folder):
        shutil.copytree(site, folder, dirs_exist_ok=True)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            for call in (
                "ingest run1.mcap run2.bag -q -j 1",
                "ingest rosbag2_folder --name run3 -q",
                "merge --all -q -j 1",
            ):
                call_topobatch(*call.split())

    return once("merged-site", make)


@pytest.fixture
def own_site(merged_site, tmp_path, monkeypatch):
    """A copy of it that may be changed, and the current folder."""
    shutil.copytree(merged_site, tmp_path / "site")
    monkeypatch.chdir(tmp_path / "site")
    return tmp_path / "site"


def examples(shown: str) -> list[list[str]]:
    """The calls that a help text shows, without the name of the command."""
    return [shlex.split(line)[1:] for line in re.findall(r"(?m)^    (topobatch .*)$", shown)]


SLOW = {"simulate": [pytest.mark.slow]}  # its examples make logs of lasers


@pytest.mark.parametrize("command", [pytest.param(n, marks=SLOW.get(n, [])) for n in NAMES])
def test_the_examples_of_every_help_work(topobatch, own_site, command):
    calls = examples(topobatch(command, "--help").out)
    assert calls
    assert any(call[0] == command for call in calls)
    if command == "ingest":
        shutil.rmtree(own_site / "topobatch-workspace")
    for call in calls:
        if "--web" in call:  # it serves until Ctrl-C: `test_view`
            continue
        done = topobatch(*call)
        assert done.code == 0, (call, done)


OF_A_WORKSPACE = (
    "merge --all", "view", "view run1", "draw run1 a.png", "draw merged a.png", "report", "list",
    "explain run1 run2", "export run1 -f csv", "export merged -f csv", "changes", "lock",
    "lock run1 run2 --same", "discard", "discard run1", "rename run1 b", "history",
    "transfer docks.csv --from run1 --to run2",
)  # fmt: skip


@pytest.mark.parametrize("call", OF_A_WORKSPACE)
def test_a_workspace_that_is_not_there(topobatch, site, tmp_path, monkeypatch, call):
    monkeypatch.chdir(site)
    error = topobatch(*call.split(), "-w", tmp_path / "mistyped").error(1)
    assert error == (
        f"error: {tmp_path / 'mistyped'}: there is no such workspace; make maps with "
        "`topobatch ingest LOG…`, or name another --workspace"
    )
    assert not (tmp_path / "mistyped").exists()


OF_A_RUN = (
    "merge {} run2", "view {}", "draw {} a.png", "explain {} run2", "export {} -f csv",
    "lock {} run2 --same", "discard {}", "discard {}:run2", "rename {} b",
    "transfer docks.csv --from {} --to run2", "transfer docks.csv --from run2 --to {}",
)  # fmt: skip


@pytest.mark.parametrize(
    ("call", "name"),
    [
        *((call, "rum1") for call in OF_A_RUN),
        *((OF_A_RUN[0], name) for name in ("run1.mcap", "topobatch-workspace/maps/run1")),
    ],
)
def test_a_run_that_is_not_there(topobatch, merged_site, monkeypatch, call, name):
    monkeypatch.chdir(merged_site)
    error = topobatch(*call.format(name).split()).error(2)
    assert name in error
    assert re.search(r"did you mean run1\? there are: (merged-site, )?run1, run2, run3", error)


@pytest.mark.parametrize(
    "call",
    ["view site-b", "draw site-b a.png", "export site-b -f csv", "report --merge site-b",
     "changes --merge site-b", "explain run1 run2 --merge site-b",
     "transfer docks.csv --from run1 --to run2 --merge site-b"],
)  # fmt: skip
def test_a_merge_that_is_not_there(topobatch, merged_site, monkeypatch, call):
    monkeypatch.chdir(merged_site)
    error = topobatch(*call.split()).error(2)
    assert "site-b" in error
    if "--merge" in call:
        assert "`topobatch merge … --output site-b` makes it" in error
    if "--merge" in call:
        error = topobatch(*call.replace("site-b", "run1").split()).error(2)
        assert "run1.json: is not there; that is a run" in error


@pytest.mark.parametrize(
    ("call", "told"),
    [
        ("merge --method best", "'best' is not one of 'robust', 'paper'; see `topobatch merge -"),
        ("ingest run1.mcap -j -1", "must be greater than or equal to 0; see `topobatch ingest -"),
        ("merge --all -w", "requires an argument; see `topobatch merge --help`"),
        ("ingest", "see `topobatch ingest --help`"),
        ("merg --all", "did you mean 'merge'? see `topobatch --help`"),
        ("changes --component 9", "there is no component 9; there are: "),
        ("export merged -f nav2 --component 9", "there is no component 9; there are: "),
        ("lock run1 run2 --never --at 3,7", "--at goes with --same"),
        ("ingest run2.bag --name run1", "give this one another --name"),
        ("explain run1", "two runs are needed: topobatch explain a b"),
        ("explain run1:run1", "two runs are needed, got 'run1' twice"),
        ("explain run1:rum2", "no map of rum2 in"),
    ],
)
@pytest.mark.usefixtures("own_site")
def test_wrong_calls(topobatch, call, told):
    assert told.lower() in topobatch(*call.split()).error(2).lower()


@pytest.mark.parametrize("call", ["report", "draw merged a.png", "export merged -f csv", "changes"])
def test_a_damaged_merge(topobatch, own_site, call):
    (own_site / "topobatch-workspace" / "merged.json").write_text("{")
    assert "(to make it anew: topobatch merge --all)" in topobatch(*call.split()).error(1)
    folder = str(own_site / "topobatch-workspace")
    told = topobatch(*call.split(), "-w", folder).error(1)
    assert f"(to make it anew: topobatch merge --all -w {folder})" in told
    shown = topobatch("list")
    assert "merged.json: is not JSON" in shown.err
    assert "3 runs" in shown.out


def test_the_two_runs_of_explain_may_be_named_as_elsewhere(topobatch, own_site):
    assert topobatch("explain", "run2:run1").out == topobatch("explain", "run1", "run2").out


@pytest.mark.parametrize("place", ["run1.mcap/ws", "/dev/null/ws"])
def test_a_workspace_that_cannot_be_made(topobatch, own_site, place):
    error = topobatch("ingest", "run1.mcap", "-w", place).error(1)
    assert error == f"error: {place}: cannot be written (Not a directory); name another --workspace"


def test_the_metadata_of_a_bag_folder_stand_for_it(topobatch, own_site, tmp_path):
    named = own_site / "rosbag2_folder" / "metadata.yaml"
    assert "run rosbag2_folder, sqlite3" in topobatch("info", named).out
    assert topobatch("ingest", named, "-w", tmp_path / "ws").out.startswith("rosbag2_folder: ")
    other = own_site / "logs" / "metadata.yaml"  # of a folder that is no bag, beside a log
    other.write_text("a: 1\n")
    for command in ("info", "ingest"):
        assert "metadata.yaml: is no log" in topobatch(command, other).error(1)


@pytest.mark.parametrize("command", ["info", "ingest"])
def test_packed_logs_are_to_be_unpacked(topobatch, own_site, command):
    for name, pack in (("run9.mcap.gz", gzip.compress), ("run9.bag.bz2", bz2.compress)):
        (own_site / name).write_bytes(pack((own_site / "run1.mcap").read_bytes()))
        assert "is packed (" in topobatch(command, own_site / name).error(1)
        assert "unpack it, and name the log" in topobatch(command, own_site / name).error(1)


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        ("ingest run1.mcap --odometry-topic /odmo", "/odom"),
        ("ingest run1.mcap --junction-topic /juntcions", "/junctions"),
    ],
)
def test_what_is_misspelt_is_guessed(topobatch, own_site, call, meant):
    done = topobatch(*call.split())
    assert done.code != 0
    assert f"did you mean {meant}?" in done.err
