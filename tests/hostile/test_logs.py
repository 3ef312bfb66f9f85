"""A few of the hostile logs, read in this process: what is whole is used, the rest is counted."""

from __future__ import annotations

import random
from pathlib import Path

import logs_bombs
import logs_flips
import pytest
import sweep
from case import read_of, writers

from topobatch.ingest.logs import chunks, inflate, mcap
from topobatch.ingest.logs.messages import Channel, DamageError, Findings
from topobatch.ingest.logs.metadata import parse_metadata
from topobatch.ingest.logs.schema import object_decoder
from topobatch.ingest.reading import read_run
from topobatch.topology.errors import LogError


def used_of(path: Path) -> tuple[int, Findings]:
    """How many messages of the wanted types decode, and what was met on the way."""
    used, _, findings = read_of(path)
    return used, findings


@pytest.mark.parametrize("name", sorted(logs_flips.CASES))
def test_what_one_wrong_bit_costs_is_told(tmp_path, name):
    for seed in range(15):
        case = logs_flips.CASES[name](random.Random(f"{name}-{seed}"), tmp_path)
        used, failed, findings = read_of(case.log)
        total = logs_flips.sound(name.removeprefix("flip-")).messages
        assert used + failed <= total
        assert used + failed == total or findings.damage, case.note


@pytest.mark.parametrize("name", sorted(logs_flips.SOUND))
def test_no_wrong_bit_costs_anything_in_silence(tmp_path, monkeypatch, name):
    """`python tests/hostile/sweep.py` tries many more."""
    monkeypatch.setattr(logs_flips, "recorded", logs_flips.recorded)
    assert list(sweep.failures(name, 120, 1, tmp_path)) == []


QUICK = sorted(
    name
    for name in logs_bombs.CASES
    if name.startswith(("yaml-", "mcap-declared", "mcap-strange", "mcap-far", "mcap-nested"))
    or name.startswith(("bag-declared", "bag-large", "db3-large", "db3-many"))
    or name in ("mcap-broken-chunks", "mcap-false-heads", "bag-false-marks")
)


class Least(random.Random):
    """Draws the smallest flood of every class."""

    def choice(self, seq):
        return seq[0] if seq[0] == 0.05 else super().choice(seq)


@pytest.mark.parametrize("name", QUICK)
def test_what_is_sound_beside_a_bomb_is_used(tmp_path, name):
    case = logs_bombs.CASES[name](Least(1), tmp_path)
    used, _ = used_of(case.log)
    assert used >= (case.intact or 0)


@pytest.mark.parametrize(
    "name", sorted(n for n in logs_bombs.CASES if n[4:] in logs_bombs.FORMULAS)
)
def test_tables_that_are_formulas_are_not_asked(tmp_path, name):
    """What is left of the true tables is read from the pages; a formula's rows are none."""
    case = logs_bombs.CASES[name](random.Random(1), tmp_path)
    try:
        said, used = read_run(case.log).warnings, used_of(case.log)[0]
    except LogError as error:
        said, used = (str(error),), 0
    assert any("no plain table" in text or "generated columns" in text for text in said)
    assert used in (0, logs_bombs.SOUND)


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_chunks_read_in_pieces_hold_the_same(tmp_path, monkeypatch, compression, kind):
    logs = writers()
    if kind == "mcap":
        path = logs.mcap(tmp_path / "run", logs.drive(), compression=compression)
    else:
        named = {"ZSTD": "bz2"}.get(compression, compression.lower())
        path = logs.bag(tmp_path / "run", logs.drive(), named)
    whole = read_run(path)
    for module in (chunks, inflate):
        monkeypatch.setattr(module, "WHOLE_BYTES", 100)
    monkeypatch.setattr(inflate, "PIECE_BYTES", 1000)
    run = read_run(path)
    assert run.warnings == whole.warnings == ()
    assert run.odometry.pose.tobytes() == whole.odometry.pose.tobytes()
    assert run.detections.branches.values.tobytes() == whole.detections.branches.values.tobytes()


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_many_small_chunks_are_read_together_and_hold_the_same(tmp_path, kind):
    logs = writers()
    if kind == "mcap":
        path = logs.mcap(tmp_path / "run", logs.drive(), chunk_size=1)
    else:
        path = logs.bag(tmp_path / "run", logs.drive(), chunk=1)
    run = read_run(path)
    large = read_run(getattr(logs, kind)(tmp_path / "large", logs.drive()))
    assert run.warnings == ()
    assert run.odometry.pose.tobytes() == large.odometry.pose.tobytes()
    assert run.detections.branches.values.tobytes() == large.detections.branches.values.tobytes()


def test_messages_too_large_are_passed_over_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "RECORD_BYTES", 5000)
    monkeypatch.setattr(mcap, "RECORD_BYTES", 5000)
    monkeypatch.setattr(chunks, "WHOLE_BYTES", 5000)
    monkeypatch.setattr(inflate, "PIECE_BYTES", 1000)
    case = logs_bombs.CASES["mcap-large-message"](Least(1), tmp_path)
    used, findings = used_of(case.log)
    assert (used, findings.lost["/odom"]) == (330, 0)
    assert findings.faults == {("message", "of /odom above 16 MiB left out"): 1}


LINE = "=" * 80


@pytest.mark.parametrize(
    "definition",
    [
        "\n".join(f"p/T{k} a\np/T{k} b\n{LINE}\nMSG: p/T{k}" for k in range(40)) + "\nuint8 a",
        "string[2147483647] a",
        f"p/E[] a\n{LINE}\nMSG: p/E",
        f"p/A[10000] a\n{LINE}\nMSG: p/A\nuint8 a\nuint8 b",
        "p/M a",
        "p/Missing a",
    ],
)
def test_definitions_that_inflate_are_refused(definition):
    channel = Channel("/t", "p/msg/M", "ros1", definition.encode(), "ros1msg")
    with pytest.raises(DamageError):
        object_decoder(channel)


@pytest.mark.parametrize("text", [*logs_bombs.YAML.values(), "", "a: *b", "{", "x: [1"])
def test_metadata_of_no_bag_is_refused(text):
    with pytest.raises(ValueError, match="it "):
        parse_metadata(text)


def test_metadata_as_recorders_and_people_write_it():
    block = (
        "---\nrosbag2_bagfile_information:\n  version: 5\n  message_count: 12\n"
        "  topics_with_message_count:\n    - topic_metadata:\n        name: /a\n"
        "      message_count: 3\n  relative_file_paths:\n    - sub/run_0.mcap # the first\n"
        "    - \"run ä.mcap\"\n    - 'it''s.mcap'\n  files:\n    - path: x\n"
    )
    names = ["run_0.mcap", "run ä.mcap", "it's.mcap"]
    assert parse_metadata(block) == (names, 12)
    flow = "rosbag2_bagfile_information:\n  relative_file_paths: [a.db3, 'b.db3']\n"
    assert parse_metadata(flow) == (["a.db3", "b.db3"], None)


@pytest.mark.parametrize(("factor", "problem"), [(1e6, "spans"), (10**4, "moves at")])
def test_odometry_that_nobody_can_have_driven_is_refused(tmp_path, factor, problem):
    from dataclasses import replace

    logs = writers()
    drive = [
        replace(m, poses=((m.poses[0][0] * factor, *m.poses[0][1:]),)) if m.child else m
        for m in logs.drive()
    ]
    with pytest.raises(LogError, match=f"/odom {problem}.*expected in metres"):
        read_run(logs.mcap(tmp_path / "run.mcap", drive))
