"""A few of the hostile logs, read in this process: what is whole is used, the rest is told."""

from __future__ import annotations

import random

import logs_bombs
import logs_flips
import logs_floods
import logs_messages
import logs_split
import pytest
from case import read_of, writers
from judge import print_of

from topobatch.ingest.logs import chunks, inflate
from topobatch.ingest.logs.metadata import parse_metadata
from topobatch.ingest.reading import read_log, read_run
from topobatch.topology.errors import LogError

SLOW = ("511-mib", "large", "small-chunks", "packed-records", "wal-of-images", "huge")
QUICK = {
    name: make
    for logs in (logs_bombs, logs_floods, logs_split, logs_messages)
    for name, make in logs.CASES.items()
    if name not in ("bag-connections", "names-bag") and not any(text in name for text in SLOW)
}


class Least(random.Random):
    """Draws the smallest flood of every class."""

    def choice(self, seq):
        return seq[0] if seq[0] in (0.05, 10) else super().choice(seq)


@pytest.mark.parametrize("name", sorted(QUICK))
def test_what_is_sound_is_used_and_the_rest_is_told(tmp_path, name):
    case = QUICK[name](Least(1), tmp_path)
    before = print_of(case.log.parent)
    said = ""
    try:
        said = " ".join(read_log(case.log).warnings)
    except LogError as error:
        said = str(error)
        assert len(said.splitlines()) == 1
    if case.intact is not None:
        used, failed, findings = read_of(case.log)
        assert used >= 0.99 * case.intact, said
        assert case.lost is None or used + failed >= case.intact + case.lost or findings.damage
    assert print_of(case.log.parent) == before


@pytest.mark.parametrize("name", sorted(logs_flips.CASES))
def test_what_one_wrong_bit_costs_is_told(tmp_path, name):
    for seed in range(15):
        case = logs_flips.CASES[name](random.Random(f"{name}-{seed}"), tmp_path)
        used, failed, findings = read_of(case.log)
        total = logs_flips.sound(name.removeprefix("flip-")).messages
        assert used + failed <= total
        assert used + failed == total or findings.damage, case.note


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
