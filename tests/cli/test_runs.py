"""Seeing runs and taking them back: list, discard, rename, history, completion, info of many."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.cli.options import complete_run
from topobatch.cli.workspace import Workspace
from topobatch.topology.document import read_map, write_map
from topobatch.topology.files import read_json
from topobatch.topology.view_file import views_path
from topobatch.topology.views import FREE, SIDE, WALL, Views

from .conftest import nameless


@pytest.fixture
def merged(buildings):
    return buildings


def document(workspace):
    return json.loads((workspace / "merged.json").read_bytes())


def entries(workspace):
    return {(e["a"], e["b"]): e for e in document(workspace)["merges"]}


def accepted_pair(workspace):
    return next(pair for pair, entry in entries(workspace).items() if entry["accepted"])


def test_list(topobatch, merged):
    shown = topobatch("list", "-w", merged)
    assert shown.code == 0, shown
    lines = shown.out.splitlines()
    assert lines[0].split() == [
        "run", "junctions", "corridors", "first", "pass", "(UTC)", "health", "stale",
    ]  # fmt: skip
    titles = [line for line in lines[1:-1] if not line.startswith("  ")]
    folded = [line for line in lines if line.startswith("    ")]
    assert len(lines) == 9 + len(titles) + len(folded)
    assert "; weakest link " in " ".join(shown.out.split())
    assert lines[-1] == "7 runs"
    told = json.loads(topobatch("list", "--json", "-w", merged).out)
    home = {run: c["id"] for c in document(merged)["graph"]["components"] for run in c["runs"]}
    assert {row["run"]: row["component"] for row in told} == home
    assert all(row["health"] == "ok" and row["stale"] == [] for row in told)
    for row in told:
        topomap = json.loads((merged / "maps" / f"{row['run']}.json").read_text())
        # Rounded once, when it is shown: 128.53 m are 129 m, as in the report.
        assert row["length_m"] == pytest.approx(
            sum(e["length"] for e in topomap["edges"]), abs=1e-3
        )
        first = min(o["time_ns"] for node in topomap["nodes"] for o in node["observations"])
        assert row["recorded"] == datetime.fromtimestamp(first // 10**9, UTC).isoformat()


def test_list_tells_what_is_stale(topobatch, merged):
    maps = sorted((merged / "maps").glob("*.json"))
    maps[0].write_bytes(maps[0].read_bytes() + b"\n")
    maps[1].write_text("{}")
    shutil.copy(maps[2], merged / "maps" / "copy.json")
    (merged / "cache" / "ingest").mkdir(parents=True)
    record = {"log": "/nowhere/at all", "bytes": 3, "version": "0.0.0", "runs": [maps[3].stem]}
    (merged / "cache" / "ingest" / f"{maps[3].stem}.json").write_text(json.dumps(record))
    rows = {r["run"]: r for r in json.loads(topobatch("list", "--json", "-w", merged).out)}
    assert rows[maps[0].stem]["stale"] == ["map changed since the merge"]
    assert rows[maps[1].stem]["health"].startswith("unreadable: ")
    assert rows["copy"]["stale"][0] == "not merged"
    assert rows[maps[3].stem]["stale"] == ["made by another version", "log changed, or gone"]


def test_a_discarded_run_leaves_nothing(topobatch, merged, two_buildings, tmp_path):
    gone = accepted_pair(merged)[0]
    other = next(p.stem for p in (merged / "maps").glob("*.json") if p.stem != gone)
    topobatch("lock", gone, other, "--never", "-w", merged)
    assert topobatch("explain", gone, other, "-w", merged).code == 0
    assert topobatch("export", gone, "-f", "csv", "-w", merged).code == 0
    assert topobatch("export", gone, "-f", "g2o", "-w", merged).code == 0
    record = Workspace(merged).ingest_record(gone)
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_text('{"log": "/logs/x.mcap"}')
    done = topobatch("discard", gone, "-w", merged)
    assert done.code == 0, done
    back = f"{gone} comes back when its log is ingested again"
    assert f"{back}, unless you remove it: /logs/x.mcap\n" in done.out
    never = tmp_path / "never"
    shutil.copytree(two_buildings, never)
    (never / "maps" / f"{gone}.json").unlink()
    topobatch("merge", "--all", "-j", 1, "-q", "-w", never)
    assert nameless(merged) == nameless(never)  # sites keep their names
    assert not [p for p in merged.rglob("*") if gone in p.name]
    assert not (merged / "locks.json").exists()


def test_a_discarded_match_is_as_if_it_was_not_found(topobatch, merged):
    before, (a, b) = (merged / "merged.json").read_bytes(), accepted_pair(merged)
    done = topobatch("discard", f"{a}:{b}", "-w", merged)
    assert done.code == 0, done
    entry = entries(merged)[a, b]
    assert not entry["accepted"]
    assert entry["verdict"] == "unrelated"
    assert "the match was discarded by a person" in entry["reason"]
    assert topobatch("discard", "-w", merged).out == f"{a}:{b}\n"
    assert "discarded by a person" in topobatch("explain", a, b, "-w", merged).out
    topobatch("merge", "--all", "-j", 1, "-q", "-w", merged)
    assert not entries(merged)[a, b]["accepted"]
    done = topobatch("discard", f"{b}:{a}", "--undo", "-w", merged)
    assert done.code == 0, done
    assert (merged / "merged.json").read_bytes() == before
    assert not (merged / "discards.json").exists()


def test_every_merge_that_holds_a_run_is_made_anew(topobatch, merged):
    gone, kept = accepted_pair(merged)
    runs = {row["run"] for row in json.loads(topobatch("list", "--json", "-w", merged).out)}
    rest = sorted(runs - {gone})
    for name, some in (("two", (gone, kept)), ("rest", rest), ("alone", (gone,))):
        assert topobatch("merge", *some, "--output", name, "-q", "-w", merged).code == 0
    (merged / "mine.json").write_text("{}")
    untouched = (merged / "rest.json").read_bytes()
    done = topobatch("discard", gone, "-w", merged)
    assert done.code == 0, done
    assert "\nmerged again: 6 runs" in done.out
    assert "\nmerged again, two: 1 run" in done.out
    assert "\njunctions of sites have other numbers now" in done.out
    assert f'"{gone}"'.encode() not in (merged / "two.json").read_bytes()
    assert (merged / "rest.json").read_bytes() == untouched
    assert not (merged / "alone.json").exists()
    assert f"\n{merged / 'alone.json'}: removed; none of its runs is left" in done.out
    assert (merged / "mine.json").read_text() == "{}"
    renamed = topobatch("rename", kept, f"{kept} new", "-w", merged)  # in the same order
    assert "other numbers" not in renamed.out
    assert topobatch("rename", f"{kept} new", "new name", "-q", "-w", merged).code == 0
    for name in ("two", "rest", "merged"):
        text = (merged / f"{name}.json").read_text()
        assert '"new name"' in text
        assert f'"{kept}"' not in text


def test_a_merge_says_that_junctions_have_other_numbers(topobatch, merged):
    assert "other numbers" not in topobatch("merge", "--all", "-w", merged).out
    for pair in combinations(sorted(p.stem for p in (merged / "maps").glob("*.json")), 2):
        topobatch("lock", *pair, "--never", "-w", merged)
    told = topobatch("merge", "--all", "-w", merged).out
    assert "\njunctions of sites have other numbers now; draw and export them again" in told
    assert " came apart: " in told
    assert " came apart: " in topobatch("history", "-w", merged).out


@pytest.mark.parametrize("content", ['{"my": "notes"}', '["topobatch.map/1"]', "no json"])
def test_a_file_that_is_no_map_is_not_discarded(topobatch, merged, content):
    notes = merged / "maps" / "notes.json"
    notes.write_text(content)
    run, before = accepted_pair(merged)[0], (merged / "merged.json").read_bytes()
    assert f"{notes}: " in topobatch("discard", run, "notes", "-w", merged).error(1)
    assert notes.read_text() == content
    assert (merged / "maps" / f"{run}.json").exists()
    assert (merged / "merged.json").read_bytes() == before


@pytest.mark.parametrize("content", ['{"schema": "topobatch.map/0"}', "{"])
def test_a_map_that_cannot_be_read_is_discarded(topobatch, merged, content):
    run = accepted_pair(merged)[0]
    (merged / "maps" / f"{run}.json").write_text(content)
    (merged / "maps" / f"{run}.rrd").write_bytes(b"its recording")
    assert topobatch("discard", run, "-w", merged).code == 0
    assert not list((merged / "maps").glob(f"{run}.*"))


@pytest.mark.parametrize("what", ["nobody", "a:b", "::", "../x"])
def test_discard_of_what_is_not_there(topobatch, merged, what):
    told = topobatch("discard", what, "-w", merged).error(2)
    assert f"no run or runs A:B named {what} in" in told


def test_a_match_that_is_locked_is_not_discarded(topobatch, merged):
    a, b = accepted_pair(merged)
    topobatch("lock", a, b, "--same", "-w", merged)
    assert "--clear" in topobatch("discard", f"{a}:{b}", "-w", merged).error(2)
    assert "was not discarded" in topobatch("discard", f"{a}:{b}", "--undo", "-w", merged).error(2)


def test_a_match_that_was_discarded_is_not_locked(topobatch, merged):
    a, b = accepted_pair(merged)
    assert topobatch("discard", f"{a}:{b}", "-q", "-w", merged).code == 0
    told = topobatch("lock", b, a, "--same", "-w", merged).error(2)
    assert f"was discarded; first: topobatch discard {a}:{b} --undo -w" in told
    assert not (merged / "locks.json").exists()
    assert topobatch("lock", b, a, "--never", "-w", merged).code == 0
    assert topobatch("discard", f"{a}:{b}", "--undo", "-q", "-w", merged).code == 0
    assert topobatch("lock", b, a, "--same", "-w", merged).code == 0


def test_rename(topobatch, merged):
    a, b = accepted_pair(merged)
    topobatch("lock", a, b, "--same", "-w", merged)
    topobatch("merge", "--all", "-j", 1, "-q", "-w", merged)
    before = document(merged)
    done = topobatch("rename", a, "zz new", "-w", merged)
    assert done.code == 0, done
    assert not (merged / "maps" / f"{a}.json").exists()
    assert read_json(merged / "maps" / "zz new.json")["graph"]["run"] == "zz new"
    after = document(merged)
    renamed = {
        "zz new" if run == a else run for c in before["graph"]["components"] for run in c["runs"]
    }
    assert {run for c in after["graph"]["components"] for run in c["runs"]} == renamed
    assert entries(merged)[b, "zz new"]["locked"] == "same"
    assert len(after["nodes"]) == len(before["nodes"])
    assert topobatch("rename", "zz new", a, "-w", merged).code == 0
    assert document(merged) == before


@pytest.mark.parametrize("new", ["../x", "", "a/b", ".x", "x#2", "a:b"])
def test_names_that_cannot_be(topobatch, merged, new):
    run = sorted(p.stem for p in (merged / "maps").glob("*.json"))[0]
    assert topobatch("rename", run, new, "-w", merged).code == 2


def test_a_name_that_is_taken(topobatch, merged):
    a, b, *_ = sorted(p.stem for p in (merged / "maps").glob("*.json"))
    assert "already" in topobatch("rename", a, b, "-w", merged).error(2)
    assert "no map of" in topobatch("rename", "nobody", "x", "-w", merged).error(2)


def test_a_renamed_run_stays_renamed_when_its_log_is_read_again(topobatch, logs, tmp_path):
    log = logs["mcap"]
    ws = tmp_path / "ws"
    assert topobatch("ingest", log, "-w", ws).code == 0
    (run,) = (p.stem for p in (ws / "maps").glob("*.json"))
    for old, new in ((run, "b"), ("b", "c")):
        assert topobatch("rename", old, new, "-w", ws).code == 0
    again = topobatch("ingest", log, "-w", ws)
    assert "unchanged, kept" in again.out
    assert [p.stem for p in (ws / "maps").glob("*.json")] == ["c"]
    assert topobatch("ingest", log, "--force", "-w", ws).code == 0
    assert [p.stem for p in (ws / "maps").glob("*.json")] == ["c"]


def test_a_moved_log_is_found_again_by_ingesting_it(topobatch, logs, tmp_path):
    """The map is kept, its bytes too, and what reads the log again knows where it is."""
    ws, log = tmp_path / "ws", tmp_path / "here" / "a.mcap"
    log.parent.mkdir()
    shutil.copy(logs["mcap"], log)
    assert topobatch("ingest", log, "-w", ws).code == 0
    before = (ws / "maps" / "a.json").read_bytes()
    moved = log.parent.rename(tmp_path / "there") / "a.mcap"
    assert "log changed, or gone" in topobatch("list", "-w", ws).out
    told = topobatch("export", "a", "-f", "tum", "-w", ws).error(1)
    assert "ingest it from where it is now" in told
    assert "unchanged, kept" in topobatch("ingest", moved, "-w", ws).out
    assert "stale" not in topobatch("list", "-w", ws).out.splitlines()[-1]
    assert topobatch("export", "a", "-f", "tum", "-w", ws).code == 0
    assert (ws / "maps" / "a.json").read_bytes() == before


def test_history(topobatch, merged):
    a, b = accepted_pair(merged)
    topobatch("lock", a, b, "--never", "-w", merged)
    topobatch("discard", f"{a}:{b}", "-w", merged)
    with (merged / "history.jsonl").open("a") as file:
        file.write('no json\n{"time":1}\n[]\n')
    told = json.loads(topobatch("history", "--json", "-w", merged).out)
    assert [entry["what"] for entry in told] == ["merge", "lock", "discard"]
    assert topobatch("history", "-n", 1, "-w", merged).out.splitlines()[1].split()[1] == "discard"


def test_shells_complete_names_of_runs(merged, monkeypatch):
    runs = sorted(p.stem for p in (merged / "maps").glob("*.json"))
    context = SimpleNamespace(params={"workspace": merged})
    assert complete_run(context, "") == runs
    assert complete_run(context, runs[0]) == [runs[0]]
    monkeypatch.setenv("TOPOBATCH_WORKSPACE", str(merged))
    assert complete_run(SimpleNamespace(params={}), "") == runs
    assert complete_run(SimpleNamespace(params={"workspace": merged / "none"}), "") == []


def test_info_of_several_logs(topobatch, logs, tmp_path):
    both = [logs["mcap"], logs["bag"], logs["mcap"]]
    told = topobatch("info", *both, "--json")
    assert told.code == 0, told
    one, two = json.loads(told.out)
    assert (one["path"], two["path"]) == (str(logs["mcap"]), str(logs["bag"]))
    assert {t["topic"] for t in one["topics"]} >= {"/odom", "/junctions"}
    shown = topobatch("info", *both)
    assert sum(": run " in line for line in shown.out.splitlines()) == 2
    for words in ("nav_msgs/msg/Odometry", "odometry: ", "junctions: "):
        assert shown.out.count(words) == 2
    for k in range(9):
        shutil.copy(logs["mcap"], tmp_path / f"log{k}.mcap")
    head, *rows, last = topobatch("info", tmp_path).out.splitlines()
    assert head.split() == ["run", "format", "MB", "seconds", "used", "problem"]
    assert [row.split()[0] for row in rows] == [f"log{k}" for k in range(9)]
    assert all(row.endswith("junctions, odometry") for row in rows)
    assert last.startswith("9 logs: 9 usable")
    bad = topobatch("info", logs["mcap"], tmp_path / "gone.mcap", "--json")
    assert bad.code == 1
    assert len(json.loads(bad.out)) == 1


def test_verbose(topobatch, merged, logs, tmp_path):
    done = topobatch("merge", "--all", "-v", "-w", merged)
    assert "pairs of maps: 21, of which 21 are known already" in done.err
    assert "s] 7 maps, 21 of 21 pairs to match" in done.err
    done = topobatch("ingest", logs["mcap"], "-v", "-w", tmp_path / "other")
    assert "nav_msgs/msg/Odometry on /odom" in done.err
    brief = topobatch("merge", "--all", "-w", merged)
    assert "known already" not in brief.err
    assert " agree, " not in brief.out
    assert "\nsite s0000: 6 runs: s0000-00, " in brief.out


def test_views_go_with_their_run(topobatch, two_buildings, tmp_path):
    """They are read, renamed and removed with its map, and a merge without them says so."""
    place = tmp_path / "ws"
    shutil.copytree(two_buildings, place)
    path = min((place / "maps").glob("*.json"))
    cells = np.zeros((4, SIDE, SIDE), np.uint8)
    cells[:, 30, 20:60], cells[:, 31:50, 20:60] = WALL, FREE
    views = Views(np.arange(4), np.zeros((4, 3)), cells)
    write_map(path, replace(read_map(path), views=views))
    run = path.stem
    merge = ("merge", "--all", "-j", 1, "-w", place)
    assert "lost" not in topobatch(*merge).out
    assert topobatch("rename", run, "monday", "-w", place).code == 0
    assert not views_path(path).exists()
    assert len(read_map(place / "maps" / "monday.json").views) == 4
    kept = views_path(place / "maps" / "monday.json").read_bytes()
    views_path(place / "maps" / "monday.json").unlink()
    shown = topobatch(*merge)
    assert shown.code == 0
    assert "the views of run 'monday' are lost or damaged" in shown.out + shown.err
    views_path(place / "maps" / "monday.json").write_bytes(kept)
    assert "lost" not in topobatch(*merge).out
    assert topobatch("discard", "monday", "-w", place).code == 0
    assert not [*(place / "maps").glob("*.views")]


def test_a_list_says_what_a_warning_is_about(topobatch, merged):
    path = next((merged / "maps").glob("*.json"))
    document = json.loads(path.read_text())
    document["graph"]["warnings"] = ["odometry jumps once (0.4 m): steps of unknown size", "other"]
    path.write_text(json.dumps(document))
    assert "2 warnings: odometry jumps once; …" in topobatch("list", "-w", merged).out
