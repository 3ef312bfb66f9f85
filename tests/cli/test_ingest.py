"""`topobatch ingest`: what lands where, what is said, what a bad log costs."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.rosbag1 import Reader
from rosbags.rosbag1 import Writer as BagWriter

from topobatch.cli.ingest_worker import IngestJob, outcomes_of
from topobatch.cli.workspace import Workspace
from topobatch.ingest.mapping_settings import MappingSettings
from topobatch.ingest.reading import ReadSettings
from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.writing import write_run
from topobatch.topology.document import read_map


def test_a_folder_of_logs_then_merge(topobatch, logs, tmp_path):
    shutil.copy(logs["mcap"], tmp_path / "first.mcap")
    shutil.copy(logs["other"], tmp_path / "second.mcap")
    workspace = tmp_path / "ws"
    done = topobatch("ingest", tmp_path, "-w", workspace)
    assert done.code == 0, done
    assert "first: " in done.out
    assert "second: " in done.out
    assert re.search(r"\n2 logs, \d+ m → \d+ junctions, \d+ corridors\n", done.out)
    assert "topobatch merge" in done.out
    done = topobatch("merge", "--all", "-w", workspace)
    assert done.code == 0, done
    assert "1 pair: " in done.out
    document = json.loads((workspace / "merged.json").read_bytes())
    assert [(m["a"], m["b"]) for m in document["merges"]] == [("first", "second")]
    assert sorted(p.name for p in workspace.iterdir() if not p.name.startswith(".")) == [
        "cache",
        "history.jsonl",
        "maps",
        "merged.json",
        "merged.rrd",
    ]


def test_finished_runs_are_kept_until_something_changes(topobatch, logs, tmp_path):
    log = shutil.copy(logs["mcap"], tmp_path / "run.mcap")
    call = ("ingest", log, "-w", tmp_path / "ws")
    document = tmp_path / "ws" / "maps" / "run.json"
    topobatch(*call)
    first = document.stat().st_mtime_ns
    assert "unchanged" in topobatch(*call).out
    assert document.stat().st_mtime_ns == first
    assert "1 map of 1 log in " in topobatch(*call, "--closure", "none").out
    assert "unchanged" not in topobatch(*call, "--closure", "full").out
    assert "unchanged" not in topobatch(*call, "--force").out
    document.unlink()
    assert "unchanged" not in topobatch(*call).out
    assert document.exists()


def test_a_reset_of_the_odometry_is_mended(topobatch, reset_logs, tmp_path):
    log = shutil.copy(reset_logs["joins"], tmp_path / "run.mcap")
    done = topobatch("ingest", log, "-w", tmp_path / "ws")
    assert done.code == 0, done
    assert "2 pieces, 1 joined to another by what they saw" in done.err
    (document,) = (tmp_path / "ws" / "maps").glob("*.json")
    mended = read_map(document)
    assert len(mended) == 14


def test_pieces_that_nothing_ties_together_are_runs_until_the_log_is_whole(
    topobatch, reset_logs, tmp_path
):
    log = shutil.copy(reset_logs["parts"], tmp_path / "run.mcap")
    call = ("ingest", log, "-w", tmp_path / "ws")
    maps = tmp_path / "ws" / "maps"
    done = topobatch(*call)
    assert done.code == 0, done
    assert "on their own: run#2" in done.err
    assert "(run#2)" in done.out
    assert "2 maps of 1 log in" in done.out
    assert sorted(p.name for p in maps.iterdir()) == [
        "run#2.json",
        "run#2.rrd",
        "run.json",
        "run.rrd",
    ]
    assert read_map(maps / "run#2.json").run == "run#2"
    assert "unchanged" in topobatch(*call).out
    assert topobatch("merge", "--all", "-w", tmp_path / "ws").code == 0
    (maps / "run#2.json").unlink()
    assert "unchanged" not in topobatch(*call).out
    assert (maps / "run#2.json").exists()
    shutil.copy(reset_logs["whole"], log)
    assert topobatch(*call).code == 0
    assert sorted(p.name for p in maps.iterdir()) == ["run.json", "run.rrd"]
    merge = topobatch("merge", "--all", "-w", tmp_path / "ws")
    assert (merge.code, merge.err) == (0, "")  # though the last one held run#2


def test_several_processes_give_the_same_maps(topobatch, logs, tmp_path):
    shutil.copy(logs["mcap"], tmp_path / "a.mcap")
    shutil.copy(logs["other"], tmp_path / "b.mcap")
    for jobs in (1, 2):
        done = topobatch("ingest", tmp_path, "-w", tmp_path / f"ws{jobs}", "--jobs", jobs)
        assert done.code == 0, done
    for name in ("a.json", "b.json"):
        one, two = (tmp_path / f"ws{jobs}" / "maps" / name for jobs in (1, 2))
        assert one.read_bytes() == two.read_bytes()


def test_what_an_interrupted_ingest_has_told_is_in_the_history(
    topobatch, logs, tmp_path, monkeypatch
):
    from topobatch.cli import ingest

    for name in ("a", "b", "c"):
        shutil.copy(logs["mcap"], tmp_path / f"{name}.mcap")
    files = sorted(tmp_path.glob("*.mcap"))
    shown = ingest._show

    def interrupted(outcome):
        shown(outcome)
        raise KeyboardInterrupt

    call = ("ingest", *files, "-j", 2, "-w", tmp_path / "ws")
    with monkeypatch.context() as patch:
        patch.setattr(ingest, "_show", interrupted)
        stopped = topobatch(*call)
    assert stopped.code == 130
    assert "1 of 3 logs finished; run again to go on" in stopped.err
    done = topobatch(*call)
    assert done.code == 0, done
    told = json.loads(topobatch("history", "--json", "-w", tmp_path / "ws").out)
    assert len(told) == 2
    assert told[0]["text"].startswith("1 log: ")


def test_outcomes_as_json(topobatch, logs, tmp_path):
    done = topobatch("ingest", logs["mcap"], tmp_path / "gone.mcap", "--json", "-w", tmp_path)
    assert done.code == 1
    one, other = sorted(json.loads(done.out), key=lambda outcome: outcome["status"])
    assert (one["status"], one["maps"], one["warnings"]) == ("done", 1, [])
    assert (other["status"], other["maps"]) == ("failed", 0)
    assert "gone.mcap" in other["text"]
    assert "gone.mcap" in done.err


def test_folder_that_holds_no_log(topobatch, tmp_path):
    (tmp_path / "empty").mkdir()
    error = topobatch("ingest", tmp_path / "empty", "-w", tmp_path / "ws").error(1)
    assert str(tmp_path / "empty") in error


def test_a_truncated_log_is_salvaged_and_said(topobatch, logs, tmp_path):
    log = tmp_path / "cut.mcap"
    raw = logs["mcap"].read_bytes()
    log.write_bytes(raw[: len(raw) * 7 // 10])
    done = topobatch("ingest", log, "-w", tmp_path / "ws")
    assert done.code == 0
    assert "warning: cut: " in done.err
    assert topobatch("ingest", log, "-w", tmp_path / "ws", "--strict").code == 1
    assert topobatch("info", log).code == 1
    # So the pages say.
    root = Path(__file__).parents[2]
    readme, page = (
        " ".join((root / name).read_text().split()) for name in ("README.md", "docs/reliability.md")
    )
    assert "0: done, possibly with warnings; a damaged log is read as far as possible." in readme
    assert "`ingest` warns, and the exit code stays 0" in page


def test_logs_of_one_name_are_told_apart_and_cost_no_other(topobatch, logs, tmp_path):
    for folder in ("robot1", "robot2"):
        (tmp_path / "logs" / folder).mkdir(parents=True)
    shutil.copy(logs["mcap"], tmp_path / "logs" / "robot1" / "run.mcap")
    shutil.copy(logs["other"], tmp_path / "logs" / "robot2" / "run.mcap")
    (tmp_path / "logs" / "circle.mcap").symlink_to("circle.mcap")
    call = ("ingest", tmp_path / "logs", "-w", tmp_path / "ws")
    done = topobatch(*call)
    assert done.code == 1
    assert "circle.mcap" in done.err
    maps = [p.name for p in sorted((tmp_path / "ws" / "maps").glob("*.json"))]
    assert maps == ["robot1-run.json", "robot2-run.json"]
    assert "2 unchanged" in topobatch(*call).out
    for log in ("robot2/run.mcap", "robot1/run.mcap"):
        assert "1 unchanged" in topobatch("ingest", tmp_path / "logs" / log, *call[2:]).out


def test_a_run_of_another_log_is_not_overwritten(topobatch, logs, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first = shutil.copy(logs["mcap"], tmp_path / "a" / "run.mcap")
    second = shutil.copy(logs["other"], tmp_path / "b" / "run.mcap")
    maps = tmp_path / "ws" / "maps"
    assert topobatch("ingest", first, "-w", tmp_path / "ws").code == 0
    before = (maps / "run.json").read_bytes()
    error = topobatch("ingest", second, "-w", tmp_path / "ws", "--name", "run").error(2)
    assert "--force" in error
    assert topobatch("ingest", second, "-w", tmp_path / "ws").code == 0
    assert sorted(p.stem for p in maps.glob("*.json")) == ["b-run", "run"]
    assert (maps / "run.json").read_bytes() == before
    call = ("ingest", second, "-w", tmp_path / "ws", "--name", "run", "--force")
    assert topobatch(*call).code == 0
    assert (maps / "run.json").read_bytes() != before


def test_parts_of_a_split_recording_beside_other_logs_are_one_run(topobatch, tmp_path):
    """As `rosbag record --split` leaves them: a folder of several recordings."""
    run = simulate_scenario(ScenarioSettings(runs=1, junctions_per_run=10, seed=3)).simulated[0]
    source = write_run(tmp_path / "whole", run, "bag")
    folder = tmp_path / "logs"
    folder.mkdir()
    with Reader(source) as bag:
        half = (bag.start_time + bag.end_time) // 2
        for number in range(2):
            with BagWriter(folder / f"drive_{number}.bag") as part:
                ids = {
                    c.id: part.add_connection(
                        c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest
                    )
                    for c in bag.connections
                }
                for connection, time_ns, data in bag.messages():
                    if (time_ns > half) == (number == 1):
                        part.write(ids[connection.id], time_ns, data)
    shutil.copy(source, folder / "other.bag")
    call = ("ingest", folder, "-w", tmp_path / "ws")
    assert topobatch(*call).code == 0
    maps = tmp_path / "ws" / "maps"
    assert sorted(p.stem for p in maps.glob("*.json")) == ["drive", "other"]
    one, other = (json.loads((maps / f"{name}.json").read_text()) for name in ("drive", "other"))
    assert one["nodes"] == [
        node | {"observations": [seen | {"run": "drive"} for seen in node["observations"]]}
        for node in other["nodes"]
    ]
    assert "2 unchanged" in topobatch(*call).out
    named = topobatch("ingest", *sorted(folder.glob("drive_*.bag")), "-w", tmp_path / "ws")
    assert "1 unchanged" in named.out
    # The log is read again by its path.
    tum = ("export", "drive", "--format", "tum", "-w", tmp_path / "ws")
    assert topobatch(*tum).code == 0
    assert topobatch(*call, "--separate").code == 0
    assert {"drive_0", "drive_1"} <= {p.stem for p in maps.glob("*.json")}
    (folder / "drive_0.bag").unlink()
    assert "drive_*.bag: the log of run drive is not there" in topobatch(*tum).err


@pytest.mark.parametrize("name", ["a/b", "..", "", ".hidden", "a:b"])
def test_names_that_are_no_file_names(topobatch, logs, tmp_path, name):
    done = topobatch("ingest", logs["mcap"], "-w", tmp_path / "ws", "--name", name)
    assert "cannot name a run" in done.error(2)


@pytest.mark.parametrize("name", ["r" * 230, "two\nlines", ".hidden"])
def test_a_log_whose_name_cannot_be_a_run_costs_no_other(topobatch, logs, tmp_path, name):
    bad = shutil.copy(logs["mcap"], tmp_path / f"{name}.mcap")
    done = topobatch("ingest", bad, logs["other"], "-w", tmp_path / "ws")
    assert done.code == 2
    assert "cannot name a run" in done.err
    assert len(list((tmp_path / "ws" / "maps").glob("*.json"))) == 1
    done = topobatch("ingest", bad, "-w", tmp_path / "ws", "--name", "good")
    assert (done.code, done.err) == (0, "")


def test_quiet_says_nothing_but_errors(topobatch, logs, tmp_path):
    done = topobatch("ingest", logs["mcap"], "-w", tmp_path / "ws", "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert topobatch("merge", "--all", "-w", tmp_path / "ws", "-q").out == ""


def test_info_takes_what_ingest_takes_of_reading(topobatch, logs):
    options = ("--time", "log", "--laser-pose", "0,0,0", "--scan-stamp", "end")
    assert topobatch("info", logs["mcap"], *options, "--cloud-band", "0,1").code == 0
    done = topobatch("info", logs["mcap"], *options, "--base-frame", "arm")
    assert done.code == 1
    assert "no usable pose to arm (--base-frame)" in done.out
    assert "--laser-pose is '0', expected x,y,yaw" in topobatch(
        "info", logs["mcap"], "--laser-pose", "0"
    ).error(2)


def test_info_on_a_folder_tells_of_every_log(topobatch, logs, tmp_path):
    for kind in ("mcap", "other"):
        shutil.copy(logs[kind], tmp_path / f"{kind}.mcap")
    (tmp_path / "broken.mcap").write_bytes(b"")
    done = topobatch("info", tmp_path)
    assert done.code == 1
    assert ("run mcap" in done.out, "run other" in done.out) == (True, True)
    assert done.out.endswith("3 logs: 2 usable, 0 of them with a laser or clouds\n")
    assert "broken.mcap" in done.err


def test_info_of_a_damaged_or_unusable_log_fails(topobatch, logs, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(logs["mcap"].read_bytes()[:-5000])
    done = topobatch("info", cut)
    assert done.code == 1
    assert "problem: the log is cut short" in done.out
    assert done.out.endswith("usable: ingest takes what could be read\n")
    assert json.loads(topobatch("info", cut, "--json").out)[0]["usable"]
    done = topobatch("info", logs["mcap"], "--junction-topic", "/nothing")
    assert done.code == 1
    assert "problem: " in done.out
    assert "usable" not in done.out


def test_a_run_is_not_called_like_a_merge(topobatch, logs, tmp_path):
    ws = tmp_path / "ws"
    for name in ("merged", "Merged"):
        done = topobatch("ingest", logs["mcap"], "-w", ws, "--name", name)
        assert "cannot name a run" in done.error(2)
    assert topobatch("ingest", logs["mcap"], "-w", ws, "--name", "a").code == 0
    assert topobatch("merge", "a", "--output", "both", "-w", ws).code == 0
    done = topobatch("ingest", logs["other"], "-w", ws, "--name", "both")
    assert "a merge is called so" in done.error(2)


def test_what_is_of_lasers_goes_with_a_laser(topobatch, tmp_path):
    assert "--laser" in topobatch("simulate", tmp_path / "out", "--detections").error(2)


def test_what_is_broken_in_a_folder_costs_no_other_log(topobatch, logs, tmp_path):
    folder = tmp_path / "fleet"
    (folder / "parts").mkdir(parents=True)
    shutil.copy(logs["mcap"], folder / "good.mcap")
    shutil.copy(logs["mcap"], folder / "parts" / "run_0.mcap")
    (folder / "parts" / "run_1.mcap").write_bytes(logs["mcap"].read_bytes()[:8])
    broken = {folder / "parts" / "run_1.mcap"}
    if sys.platform != "win32":
        (folder / "away.bag").symlink_to(tmp_path / "gone.bag")
        os.mkfifo(folder / "fifo.mcap")
        broken |= {folder / "away.bag", folder / "fifo.mcap"}
    done = topobatch("ingest", folder, tmp_path / ("x" * 5000), "-w", tmp_path / "ws")
    assert done.code == 1
    maps = {path.name for path in (tmp_path / "ws" / "maps").glob("*.json")}
    assert maps == {"good.json", "run_0.json"}
    *told, last = done.err.splitlines()
    assert len(told) == len(broken) + 1
    assert all(any(str(path) in line for line in told) for path in broken)
    assert f"{len(broken) + 1} of {len(broken) + 3} logs failed" in last


class Deadly:
    """In place of a path: whoever unpickles it is killed."""

    def __reduce__(self):
        return eval, ("__import__('os').kill(__import__('os').getpid(), 9)",)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are of another kind there")
def test_a_process_that_dies_costs_no_other_log(logs, tmp_path):
    kinds = ("mcap", "bag", "other")
    place = Workspace(tmp_path / "ws")
    jobs = [
        IngestJob(logs[k], k, place, ReadSettings(), MappingSettings(), force=False) for k in kinds
    ]
    jobs[1] = replace(jobs[1], log=Deadly())
    found = {o.run: o.status for o in outcomes_of(jobs, 2, lambda done: None)}
    assert found == {"mcap": "done", "bag": "failed", "other": "done"}
