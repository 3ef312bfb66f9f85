"""`topobatch merge`: which runs, and what is said when something is wrong with them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from topobatch.cli.merge import MOST_SHOWN, _show
from topobatch.cli.output import show
from topobatch.cli.workspace import Workspace
from topobatch.merge.result import Alignment, Component, MergeResult, PairVerdict, Verdict
from topobatch.simulation.settings import ScenarioSettings

from .conftest import simulated_maps

a, b = "run1", "run2"
"""Of the workspace."""


def test_which_runs(topobatch, workspace):
    assert "--all" in topobatch("merge", "-w", workspace).error(2)
    assert "not both" in topobatch("merge", a, "--all", "-w", workspace).error(2)
    error = topobatch("merge", a, "nobody", "-w", workspace).error(2)
    assert "nobody" in error
    assert b in error
    assert topobatch("merge", a, "-w", workspace).code == 0
    document = json.loads((workspace / "merged.json").read_bytes())
    assert [list(c["runs"]) for c in document["graph"]["components"]] == [[a]]


def test_the_order_of_names_does_not_matter(topobatch, workspace):
    topobatch("merge", a, b, "-w", workspace)
    first = (workspace / "merged.json").read_bytes()
    topobatch("merge", b, a, "-w", workspace)
    assert (workspace / "merged.json").read_bytes() == first
    topobatch("merge", "--all", "-w", workspace)
    assert (workspace / "merged.json").read_bytes() == first


def test_a_merge_of_fewer_runs_does_not_replace_a_larger_one(topobatch, workspace):
    assert topobatch("merge", "--all", "-w", workspace).code == 0
    files = [workspace / f"merged.{kind}" for kind in ("json", "rrd")]
    before = [path.read_bytes() for path in files]
    error = topobatch("merge", a, "-w", workspace).error(2)
    assert f"merge of 2 runs, and this one leaves out {b}" in error
    assert "another --output NAME" in error
    assert "--replace" in error
    done = topobatch("merge", a, "--output", "alone", "-w", workspace)
    assert "topobatch view alone" in done.out
    assert done.code == 0
    assert [path.read_bytes() for path in files] == before
    document = json.loads((workspace / "alone.json").read_bytes())
    assert [list(c["runs"]) for c in document["graph"]["components"]] == [[a]]
    assert "alone.rrd" in topobatch("view", "alone", "-w", workspace).out
    assert "another --output" in topobatch("merge", b, "--output", "alone", "-w", workspace).error(
        2
    )
    assert topobatch("merge", a, b, "--output", "alone", "-w", workspace).code == 0
    assert topobatch("merge", b, "--replace", "-w", workspace).code == 0
    document = json.loads(files[0].read_bytes())
    assert [list(c["runs"]) for c in document["graph"]["components"]] == [[b]]


def test_what_was_discarded_or_renamed_is_left_out_unasked(topobatch, workspace):
    merge = ("merge", "--all", "-w", workspace)
    assert topobatch(*merge).code == 0
    assert topobatch("rename", a, "new", "-w", workspace).code == 0
    assert topobatch(*merge).code == 0
    assert topobatch("discard", b, "-w", workspace).code == 0
    assert topobatch(*merge).code == 0


def test_shares_of_a_merge_have_no_output(topobatch, workspace):
    share = ("merge", "--all", "--shard", "1/2", "-w", workspace)
    error = topobatch(*share, "--output", "y").error(2)
    assert "--output goes with the last merge --all" in error
    assert "--shard goes with --all" in topobatch(*share, "run1").error(2)


def test_a_file_that_is_no_merge_is_not_overwritten(topobatch, workspace):
    other = workspace / "notes.json"
    other.write_text('{"my": "notes"}')
    for chosen in ("--all", "run1"):
        error = topobatch("merge", chosen, "--output", "notes", "-w", workspace).error(2)
        assert "--replace" in error
    assert other.read_text() == '{"my": "notes"}'


@pytest.mark.parametrize(
    "name", ["merged", "Locks", "maps", "cache", "../x", ".hidden", "", "run1", "a:b", "x" * 300]
)
def test_names_that_cannot_be_a_merges(topobatch, workspace, name):
    assert (workspace / "maps" / "run1.json").exists()
    error = topobatch("merge", "--all", "--output", name, "-w", workspace).error(2)
    assert "cannot name a merge" in error
    assert ("that is one without --output" in error) == (name == "merged")


def test_explain_asks_the_merge_that_is_named(topobatch, workspace):
    assert "not there" in topobatch("explain", a, b, "--merge", "mine", "-w", workspace).error(2)
    assert topobatch("merge", a, b, "--output", "mine", "-w", workspace).code == 0
    shown = topobatch("explain", a, b, "--merge", "mine", "-w", workspace).out
    assert "not merged yet" not in shown
    assert "Note" not in shown
    assert "not merged yet" in topobatch("explain", a, b, "-w", workspace).out
    path = workspace / "maps" / f"{b}.json"
    path.write_bytes(path.read_bytes() + b"\n")
    shown = topobatch("explain", a, b, "--merge", "mine", "-w", workspace).out
    assert f"Note: the map of {b} changed since the merge; merge again" in shown


def test_a_broken_map_does_not_stop_the_others(topobatch, workspace):
    (workspace / "maps" / "broken.json").write_text('{"schema": "topobatch.map/1"}')
    done = topobatch("merge", "--all", "-w", workspace)
    assert done.code == 1
    assert "broken.json" in done.err
    assert "1 pair: " in done.out
    assert (workspace / "merged.rrd").exists()


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"{")])
def test_a_merge_whose_map_is_lost_or_damaged_is_not_overwritten(topobatch, workspace, harm):
    assert topobatch("merge", "--all", "-w", workspace).code == 0
    before = (workspace / "merged.json").read_bytes()
    harm(workspace / "maps" / f"{b}.json")
    done = topobatch("merge", "--all", "-w", workspace)
    assert done.code in (1, 2)
    assert f"this one leaves out {b}" in done.err
    assert "--replace" in done.err
    assert (workspace / "merged.json").read_bytes() == before
    done = topobatch("merge", "--all", "--replace", "-w", workspace)
    assert f"{b}.json" in done.err or not (workspace / "maps" / f"{b}.json").exists()
    document = json.loads((workspace / "merged.json").read_bytes())
    assert [list(c["runs"]) for c in document["graph"]["components"]] == [[a]]


def test_only_broken_maps(topobatch, tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "x.json").write_text("{}")
    done = topobatch("merge", "--all", "-w", tmp_path)
    assert done.code == 1
    assert "none of the 1 map can be read" in done.err


def test_locks_are_kept_shown_and_cleared(topobatch, workspace):
    assert "no locks" in topobatch("lock", "-w", workspace).out
    assert topobatch("lock", b, a, "--same", "--at", "1,2", "-w", workspace).code == 0
    assert f"{a} + {b}: same, junction 2 = junction 1" in topobatch("lock", "-w", workspace).out
    assert topobatch("lock", a, b, "--never", "-w", workspace).code == 0
    assert f"{a} + {b}: never" in topobatch("lock", "-w", workspace).out
    assert topobatch("lock", a, b, "--clear", "-w", workspace).code == 0
    assert "no locks" in topobatch("lock", "-w", workspace).out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["A", "B"], "--same"),
        (["A", "B", "--same", "--never"], "--clear"),
        (["A"], "two runs"),
        (["A", "A", "--same"], "'run1'"),
        (["A", "nobody", "--same"], "nobody"),
        (["A", "B", "--same", "--at", "3"], "--at"),
        (["A", "B", "--never", "--at", "0,0"], "goes with --same"),
        (["A", "B", "--clear", "--at", "0,0"], "--at"),
        (["--at", "0,0"], "two runs"),
    ],
)
def test_locks_that_make_no_sense(topobatch, workspace, arguments, word):
    called = [{"A": a, "B": b}.get(argument, argument) for argument in arguments]
    assert word in topobatch("lock", *called, "-w", workspace).error(2)


def test_a_lock_on_a_junction_that_is_not_there(topobatch, workspace):
    error = topobatch("lock", a, b, "--same", "--at", "0,999", "-w", workspace).error(2)
    assert "not 999" in error


def test_a_never_lock_keeps_runs_apart(topobatch, workspace):
    topobatch("lock", a, b, "--never", "-w", workspace)
    assert topobatch("merge", "--all", "-w", workspace).code == 0
    document = json.loads((workspace / "merged.json").read_bytes())
    assert len(document["graph"]["components"]) == 2
    assert document["merges"][0]["locked"] == "never"


def test_a_lock_that_nothing_honours_is_told(topobatch, workspace):
    first = min((workspace / "maps").glob("*.json"))
    document = json.loads(first.read_bytes())
    document["graph"]["run"] = "dot"
    document |= {"nodes": document["nodes"][:1], "edges": []}
    (workspace / "maps" / "dot.json").write_text(json.dumps(document))
    topobatch("lock", "dot", first.stem, "--same", "-w", workspace)
    done = topobatch("merge", "dot", first.stem, "-w", workspace)
    assert done.code == 0
    assert f"dot and {first.stem} are not joined: locked as the same, but no" in done.err
    assert "0 merged" in done.out


def test_a_merge_as_json_is_the_same_whether_or_not_it_was_there(topobatch, workspace):
    calls = [topobatch("merge", "--all", "--json", "-w", workspace) for _ in range(2)]
    assert [done.code for done in calls] == [0, 0]
    one, two = (json.loads(done.out) for done in calls)
    assert one == two
    assert one["merged"] == str(workspace / "merged.json")
    assert sum(one["pairs"].values()) == 1
    runs = [run for site in one["sites"] for run in site["runs"]]
    assert sorted(runs) == sorted(p.stem for p in (workspace / "maps").glob("*.json"))
    done = topobatch("merge", "--all", "--shard", "1/2", "--json", "-w", workspace)
    assert "--json" in done.error(2)


@pytest.mark.parametrize("where", ["merge.merging.merge_maps", "cli.merge.read_maps"])
def test_an_interrupted_merge_says_how_to_go_on(topobatch, workspace, monkeypatch, where):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"topobatch.{where}", interrupted)
    done = topobatch("merge", "--all", "-w", workspace)
    assert done.code == 130
    assert "what was matched is kept: run again to go on" in done.err


def test_explain(topobatch, workspace):
    shown = topobatch("explain", b, a, "-w", workspace)
    assert shown.code == 0, shown
    assert "not merged yet" in shown.out
    topobatch("merge", "--all", "-w", workspace)
    (said,) = json.loads((workspace / "merged.json").read_bytes())["merges"]
    shown = topobatch("explain", a, b, "-w", workspace)
    assert shown.out.startswith(f"{a} and {b}: {said['verdict']}: {said['evidence_bits']:.1f} bits")
    assert f"= {said['evidence_bits']:.1f}  evidence" in shown.out
    assert "Note" not in shown.out
    assert len(shown.out.splitlines()) <= 23
    document = json.loads(topobatch("explain", a, b, "--json", "-w", workspace).out)
    assert document["schema"] == "topobatch.decision/1"
    for field in ("a", "b", "verdict", "evidence_bits", "threshold_bits", "reason"):
        assert document[field] == said[field]
    assert "twice" in topobatch("explain", a, a, "-w", workspace).error(2)
    shutil.copy(workspace / "maps" / f"{a}.json", workspace / "maps" / "copy.json")
    assert "not 'copy'" in topobatch("explain", a, "copy", "-w", workspace).error(1)


def test_explain_tells_of_locks(topobatch, workspace):
    topobatch("merge", "--all", "-w", workspace)
    topobatch("lock", a, b, "--never", "-w", workspace)
    assert "locked apart since the merge" in topobatch("explain", a, b, "-w", workspace).out
    topobatch("merge", "--all", "-w", workspace)
    assert "Note" not in topobatch("explain", a, b, "-w", workspace).out
    topobatch("lock", a, b, "--clear", "-w", workspace)
    assert "unlocked since the merge" in topobatch("explain", a, b, "-w", workspace).out
    topobatch("lock", a, b, "--same", "-w", workspace)
    locked = topobatch("discard", f"{a}:{b}", "-w", workspace).error(2)
    assert locked.endswith(f"first: topobatch lock {a} {b} --clear -w {workspace}")
    topobatch("lock", a, b, "--clear", "-w", workspace)
    topobatch("lock", a, b, "--same", "-w", workspace)
    topobatch("merge", "--all", "-w", workspace)
    assert "Note" not in topobatch("explain", a, b, "-w", workspace).out
    document = json.loads((workspace / "merged.json").read_bytes())
    why = "locked as the same, but no alignment of the two honours the lock"
    said = {"accepted": False, "accepted_by": None, "reason": f"{why}; the maps alone say: much"}
    document["merges"][0] |= said
    (workspace / "merged.json").write_text(json.dumps(document))
    told = " ".join(topobatch("explain", a, b, "-w", workspace).out.split())
    assert f"Note: {why}" in told


def test_explain_by_the_papers_figures(topobatch, workspace):
    shown = topobatch("explain", b, a, "--method", "paper", "-w", workspace)
    assert shown.code == 0, shown
    assert "hypotheses" in shown.out
    assert "cluster" in shown.out
    topobatch("merge", "--all", "-w", workspace)
    options = ("--method", "paper", "--json", "-w", workspace)
    document = json.loads(topobatch("explain", a, b, *options).out)
    assert document["schema"] == "topobatch.explanation/1"
    assert document["verdict"]["a"] == a
    paper = ("explain", a, b, "--method", "paper", "-w", workspace)
    assert "verdict of merged.json, by the robust method: " in topobatch(*paper).out
    topobatch("merge", "--all", "--method", "paper", "-w", workspace)
    assert "verdict of merged.json, by the paper method: " in topobatch(*paper).out
    topobatch("merge", a, "--method", "paper", "--output", "one", "-w", workspace)
    assert "verdict" not in topobatch(*paper, "--merge", "one").out


@pytest.fixture(scope="session")
def clean(once):
    """A workspace with the maps of two runs of a maze that overlap, without drift or faults."""
    maze = ScenarioSettings("maze", 2, 0.6, 30, drift="none", faults="none", seed=3)
    return once("clean", lambda folder: simulated_maps(folder, maze))


PAPER = ("run1", "run2", "--method", "paper")
OPTIONS = [
    ("--degree", "inexact"),
    ("--confidence", "0.9999"),
    ("--confidence-of", "corridor"),
    ("--weights", "reweighted"),
    ("--iterative",),
]


@pytest.mark.parametrize("option", [(), sum(OPTIONS, ())])
def test_the_papers_method_and_its_options(topobatch, clean, tmp_path, option):
    workspace = shutil.copytree(clean, tmp_path / "ws")
    merged = topobatch("merge", "--all", "--method", "paper", *option, "-w", workspace)
    assert merged.code == 0, merged
    assert "1 merged" in merged.out
    document = json.loads((workspace / "merged.json").read_bytes())
    assert document["merges"][0]["threshold_bits"] == pytest.approx(9.97)
    settings = document["graph"]["settings"]
    told = json.loads(topobatch("explain", *PAPER, "--json", "-w", workspace).out)
    assert told["settings"] == settings
    best = told["clusters"][0]
    assert best["transform"] == document["merges"][0]["transform"]
    assert best["evidence_bits"] == document["merges"][0]["evidence_bits"]
    for name, *value in OPTIONS:
        key = name.removeprefix("--").replace("-", "_")
        held = settings["growth"] | settings["clusters"]
        assert (str(held[key]) == (value or ["True"])[0]) == (name in option)


def test_explain_takes_options_in_place_of_the_merges_own(topobatch, clean, tmp_path):
    workspace = shutil.copytree(clean, tmp_path / "ws")
    topobatch("merge", "--all", "--method", "paper", "--degree", "inexact", "-w", workspace)
    shown = topobatch("explain", *PAPER, "--confidence", "0.9", "-w", workspace)
    assert "degree inexact, confidence 0.9 of each match" in shown.out
    mine = ("--output", "mine", "--replace")
    topobatch("merge", "--all", "--method", "paper", "--degree", "inexact", *mine, "-w", workspace)
    topobatch("merge", "--all", "-w", workspace)
    shown = topobatch("explain", *PAPER, "-w", workspace)
    assert "degree exact, confidence 0.999 of each match" in shown.out
    shown = topobatch("explain", *PAPER, "--merge", "mine", "-w", workspace)
    assert "degree inexact, confidence 0.999 of each match" in shown.out
    told = " ".join(topobatch("explain", "--help").out.replace("│", " ").split())
    assert "settings of merged.json, or of the merge that --merge names, if that is" in told


def test_settings_that_make_no_sense(topobatch, workspace):
    for call in (["--degree", "exact"], ["--iterative"], ["--met", "a@1,b@1"]):
        assert "belong to --method paper" in topobatch("merge", "--all", *call).error(2)
    paper = ["merge", "--all", "--method", "paper", "-w", workspace]
    assert "confidence" in topobatch(*paper, "--confidence", "1.0").error(2)
    assert topobatch(*paper).code == 0
    path = workspace / "merged.json"
    document = json.loads(path.read_bytes())
    document["graph"]["settings"]["growth"]["confidence"] = 7
    path.write_text(json.dumps(document))
    explain = ["explain", a, b, "-w", workspace]
    assert "graph.settings" in topobatch(*explain, "--method", "paper").error(1)
    assert "belong to --method paper" in topobatch(*explain, "--iterative").error(2)


def test_a_merge_ends_with_its_sites_and_what_to_do_next(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bits = [3.0, 9.0, 5.0, 4.0, 8.0, 6.0, 7.0, 1.0, 2.0, 2.5]
    pairs = [
        PairVerdict(
            "b", f"c{k}", Verdict.AMBIGUOUS, False, found, "long", advice=f"drive {k}",
            threshold_bits=12.0, lacks="too little",
        )
        for k, found in enumerate(bits)
    ]  # fmt: skip
    best = Alignment(np.zeros(3), 20.0, np.zeros((1, 2), np.int64), 0.1)
    pairs.append(PairVerdict(a, "run9", Verdict.MERGED, True, 20.0, "helped", best))
    sites = {"north": [f"n{k:02}" for k in range(16)], "site-run1": [a, "run9"], "b": ["b"]}
    sites["lab"] = ["c"]
    components = [
        Component(k, dict.fromkeys(own), site=s) for k, (s, own) in enumerate(sites.items())
    ]
    merge = MergeResult(components, None, pairs)
    shown = []
    for say in ("say", "say_folded"):
        monkeypatch.setattr(f"topobatch.cli.merge.{say}", shown.append)
    show()
    _show(merge, Workspace(Path("topobatch-workspace")))
    assert shown[0] == "  b ? c1: ambiguous: 9.0 bits, 12.0 needed; too little"
    assert shown[MOST_SHOWN] == "  and 2 more ambiguous: --verbose lists them"
    assert shown[MOST_SHOWN + 1] == "  to settle b ? c1: drive 1"
    assert shown[-10].startswith("190 pairs: 1 merged, 10 ambiguous")
    assert shown[-10].endswith("; 3 sites, 1 run alone")
    assert shown[-9] == "site north: 16 runs: n00, n01, n02, n03, n04, n05, n06, n07 and 8 more"
    assert shown[-8:-5] == [
        "site site-run1: 2 runs: run1, run9", "site lab: 1 run: c", "alone: b"
    ]  # fmt: skip
    assert shown[-4:] == [
        "name a site: topobatch site run1 NAME",
        "10 pairs are open; what to record to settle most: topobatch next",
        "all on one page: topobatch report",
        "route graphs: topobatch export --format nav2",
    ]
    assert "  run1 + run9: helped" not in shown
    show(verbose=True)
    _show(merge, Workspace(Path("topobatch-workspace")))
    assert "  run1 + run9: helped" in shown
