"""A few of the floods, split folders and absurd messages, read in this process; and arguments."""

from __future__ import annotations

import random
import sqlite3
from pathlib import Path

import logs_floods
import logs_messages
import logs_split
import numpy as np
import pytest
from case import read_of, writers
from judge import print_of

from topobatch.cli import transfer
from topobatch.cli.transfer import read_places
from topobatch.ingest.logs.fields import JunctionFields
from topobatch.ingest.logs.foxglove import POSES, protobuf_rows, protobuf_transforms
from topobatch.ingest.logs.messages import NAME_BYTES, DamageError
from topobatch.ingest.logs.pose_wire import WireDecoder
from topobatch.ingest.logs.poses import Frames
from topobatch.ingest.reading import read_log
from topobatch.topology.errors import DataError, LogError, UsageError


class Least(random.Random):
    """Draws the smallest flood of every class."""

    def choice(self, seq):
        return seq[0] if seq[0] in (0.05, 10) else super().choice(seq)


NOT_QUICK = ("bag-connections", "names-bag", "bag-packed-records", "mcap-packed-records")
NOT_QUICK += ("bag-packed-connections",)
QUICK = {
    **{k: v for k, v in logs_floods.CASES.items() if k not in NOT_QUICK},
    **logs_split.CASES,
    **logs_messages.CASES,
}


@pytest.mark.parametrize("name", sorted(QUICK))
@pytest.mark.parametrize("seed", range(2))
def test_what_is_sound_is_used_and_the_rest_is_told(tmp_path, name, seed):
    case = QUICK[name](Least(seed), tmp_path)
    before = print_of(case.log.parent) if "huge" not in name else ""
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
    assert not before or print_of(case.log.parent) == before


@pytest.mark.parametrize("payload", [b"", bytes(40)])
def test_messages_that_are_alike_and_broken_are_counted_one_by_one(payload):
    decoder = WireDecoder("odometry", ros1=False)
    data = np.frombuffer(payload * 5000 + bytes(8), np.uint8)
    start = np.arange(5000) * len(payload)
    poses = decoder.decode(data, start, np.full(5000, len(payload)))
    assert (len(poses.message), decoder.failed) == (0, 5000)
    assert decoder.reason


def test_connections_described_without_end_are_read(tmp_path):
    case = logs_floods._bag(
        lambda _: logs_floods._bag_chunk(
            flood := logs_floods._connection(2, b"/t", b"x/Y") * 3000, b"none", len(flood)
        ),
        "",
    )(random.Random(1), tmp_path)
    used, failed, _ = read_of(case.log)
    assert (used, failed) == (case.intact, 0)


def test_of_two_topics_of_one_number_the_first_is_the_recorders(tmp_path):
    folder = writers().ros2_folder(tmp_path / "run", writers().drive(100))
    with sqlite3.connect(folder / "run.db3") as base:
        base.execute("ALTER TABLE topics RENAME TO kept")
        base.execute("CREATE TABLE topics AS SELECT * FROM kept")
        columns = "type, serialization_format, offered_qos_profiles, type_description_hash"
        base.execute(f"INSERT INTO topics SELECT 3 - id, name, {columns} FROM kept")
    base.close()
    assert read_log(folder).source["odometry"]["messages"] == 100


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("name", ["bag-false-index", "mcap-false-summary"])
def test_the_data_are_believed_where_an_index_describes_other_channels(tmp_path, name, seed):
    case = logs_floods.CASES[name](random.Random(seed), tmp_path)
    run = read_log(case.log)
    used = run.source["odometry"]["messages"] + run.source["junctions"]["messages"]
    assert used == case.intact
    assert case.lost == 0
    assert any("otherwise than the data" in text for text in run.warnings)


def test_a_name_of_a_million_characters_is_none(tmp_path):
    """Its message is left out and counted; shorter ones are names."""
    logs = writers()
    drive = logs.drive(100)
    for length, used in ((NAME_BYTES - 1, 110), (NAME_BYTES, 109)):
        long = logs.relabelled(drive[5:6], frame="x" * length)
        log = logs.mcap(tmp_path / "run.mcap", [*drive[:5], *long, *drive[6:]])
        found, failed, _ = read_of(log)
        assert (found, failed) == (used, 110 - used)


def test_more_poses_than_any_message_has_are_refused_and_none_is_dropped():
    pose = b"\x1a\x00"
    assert len(protobuf_rows(pose * POSES, Frames())[0][2]) == POSES
    with pytest.raises(DamageError, match="implausibly many"):
        protobuf_rows(pose * (POSES + 1), Frames())
    with pytest.raises(DamageError, match="implausibly many"):
        protobuf_transforms(b"\x0a\x00" * (POSES + 1), Frames())


@pytest.mark.parametrize(
    "mapping",
    [
        "center=" + "a." * 100_000,
        "center=[],branches=a",
        "center=__class__,branches=a",
        "center=a,branches=\x1b[31m",
        "center=\0,branches=\udcff",
        "," * 1000,
        "",
    ],
)
def test_mappings_that_lead_nowhere_are_refused(mapping):
    with pytest.raises(UsageError):
        JunctionFields.parse(mapping)


def test_tables_of_places_are_bounded(tmp_path, monkeypatch):
    path = tmp_path / "places.csv"
    monkeypatch.setattr(transfer, "MOST_PLACES", 3)
    path.write_text("name,x,y\n" + "a,1,2\n" * 3)
    assert len(read_places(path).rows) == 3
    path.write_text("name,x,y\n" + "a,1,2\n" * 4)
    with pytest.raises(DataError, match="more than 3 places of 3 columns"):
        read_places(path)
    monkeypatch.setattr(transfer, "MOST_VALUES", 6)
    path.write_text("name,x,y\n" + "a,1,2\n" * 3)
    with pytest.raises(DataError, match="more than 2 places of 3 columns"):
        read_places(path)
    with pytest.raises(DataError, match="larger than"):
        read_places(Path("/dev/zero"))
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(DataError, match="cannot be read"):
        read_places(tmp_path / "loop")
