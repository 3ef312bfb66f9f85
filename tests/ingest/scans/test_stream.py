"""Scans of every encoding as a stream of batches: the same numbers, or a count of what is wrong."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from topobatch.ingest.logs.foxglove import PROTOBUF, load_json, protobuf_object
from topobatch.ingest.logs.lasers import object_scan, scan_decoder
from topobatch.ingest.logs.messages import Block, Channel
from topobatch.ingest.logs.recording import recording_at
from topobatch.ingest.scans.scan import ScanBatch
from topobatch.ingest.scans.slicing import DEFAULT_SLICES, SliceSettings, sliced
from topobatch.ingest.scans.stream import Mounting, ScanStream
from topobatch.simulation.scenario import SimulatedRun, simulate_scenario
from topobatch.simulation.settings import LASERS, MotionSettings, ScenarioSettings
from topobatch.simulation.writing import write_run

LEVEL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
ANYWHERE = Mounting(otherwise=lambda _: LEVEL)
NAN, INF = float("nan"), float("inf")


def at(x: float, y: float, yaw: float, roll: bool = False) -> np.ndarray:
    s, c = np.sin(yaw / 2), np.cos(yaw / 2)
    return np.array([x, y, 0.2, *((c, s, 0.0, 0.0) if roll else (0.0, 0.0, s, c))])


def stream(log: Path, mounting: Mounting = ANYWHERE, topic: str = "/scan", **options: Any) -> Any:
    return ScanStream(recording_at(log), topic, mounting, **options)


def together(batches: list[ScanBatch]) -> tuple[list[int], np.ndarray]:
    times = [int(t) for batch in batches for t in batch.times_ns]
    return times, np.concatenate([batch.ranges_m for batch in batches])


def one(sensors: ModuleType, tmp_path: Path, *payloads: bytes, **options: Any) -> Any:
    """The stream of a log with these scans, and its batches."""
    kind = options.pop("kind", sensors.SCAN)
    rows = [("/scan", kind, sensors.START_NS + 10**9 * (k + 1), p) for k, p in enumerate(payloads)]
    log = sensors.mcap(tmp_path / "log.mcap", rows, options.pop("encoding", "cdr"))
    found = stream(log, **options)
    return found, list(found)


# --- containers --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulated() -> SimulatedRun:
    settings = ScenarioSettings(
        "maze",
        runs=1,
        junctions_per_run=5,
        motion=MotionSettings(1.2, 1.4),
        laser=LASERS["mild"],
        tells_junctions=False,
        seed=4,
    )
    return simulate_scenario(settings).simulated[0]


@pytest.mark.parametrize("container", ["mcap", "bag", "db3", "ros2-mcap"])
def test_every_container_gives_the_scans_that_were_written(
    simulated: SimulatedRun, tmp_path: Path, container: str
) -> None:
    found = stream(write_run(tmp_path, simulated, container))
    batches = list(found)
    times, ranges = together(batches)
    scans = simulated.scans
    assert scans is not None
    assert found.tally.scans == len(scans) == found.tally.messages
    assert found.tally.warnings("/scan") == []
    assert np.abs(np.array(times) - simulated.scans_ns - 50_000_000).max() < 10
    np.testing.assert_array_equal(
        ranges, np.where(np.isfinite(scans.ranges_m), scans.ranges_m, np.nan)
    )
    assert {len(batch.angles_rad) for batch in batches} == {180}
    np.testing.assert_allclose(batches[0].angles_rad, scans.angles_rad, atol=1e-5)
    assert batches[0].sweep_s == pytest.approx(0.1)
    assert batches[0].free_m.tolist()[:1] == [12.0]


def no_cloud(_: Any) -> Any:
    raise AssertionError("no cloud is expected")


# --- decoding ----------------------------------------------------------------------------------


def decoded(decoder: Any, payloads: list[bytes]) -> list[Any]:
    size = np.array([len(p) for p in payloads], np.int64)
    data = np.frombuffer(b"".join(payloads) + bytes(16), np.uint8)
    return list(decoder.decode(Block(data, 0, size, np.cumsum(size) - size, size)))


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_columns_are_what_rosbags_decodes(sensors: ModuleType, encoding: str) -> None:
    rng = np.random.default_rng(3)
    payloads = []
    for k in range(60):
        ranges = rng.uniform(0.0, 12.0, rng.choice([4, 5, 5, 5, 9]))
        frame = rng.choice(["laser", "a", "scanner_front"])
        payloads.append(
            sensors.scan(ranges, sensors.START_NS + k, str(frame), encoding, range_max=k % 2 + 8.0)
        )
    found = decoded(scan_decoder(Channel("/scan", sensors.SCAN, encoding), no_cloud), payloads)
    assert np.concatenate([s.message for s in found]).tolist() == list(range(60))
    store = sensors.store(encoding)
    read = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
    for scans in found:
        for row, number in enumerate(scans.message.tolist()):
            scan = object_scan(read(payloads[number], sensors.SCAN))
            _, _, (stamp,), (ranges,), geometry, _ = scan
            assert stamp == scans.stamp_ns[row]
            assert ranges.tolist() == scans.ranges_m[row].tolist()
            assert geometry == scans.geometry


def test_big_endian_messages(sensors: ModuleType) -> None:
    message = sensors.ROS2.deserialize_cdr(sensors.scan([1, 2, 3, 4, 5]), sensors.SCAN)
    raw = bytes(sensors.ROS2.serialize_cdr(message, sensors.SCAN, little_endian=False))
    (found,) = decoded(scan_decoder(Channel("/scan", sensors.SCAN, "cdr"), no_cloud), [raw])
    assert found.ranges_m.tolist() == [[1, 2, 3, 4, 5]]
    assert found.geometry.angle_increment == 0.5
    assert found.stamp_ns.tolist() == [sensors.START_NS]


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_of_echoes_the_strongest_else_the_first(sensors: ModuleType, encoding: str) -> None:
    ranges = [[1.0, 2.0], [], [3.0], [4.0, 5.0, 6.0], [7.0]]
    strengths = [[5.0, 9.0], [], [1.0], [8.0, 2.0, 8.0], [1.0]]
    payloads = [
        sensors.echoes(ranges, strengths, encoding),
        sensors.echoes(ranges, [], encoding),
        sensors.echoes(ranges[::-1], strengths[::-1], encoding),
    ]
    found = decoded(scan_decoder(Channel("/scan", sensors.ECHOES, encoding), no_cloud), payloads)
    rows = np.concatenate([scans.ranges_m for scans in found])
    np.testing.assert_array_equal(rows[0], [2, NAN, 3, 4, 7])
    np.testing.assert_array_equal(rows[1], [1, NAN, 3, 4, 7])
    np.testing.assert_array_equal(rows[2], [7, 4, 3, NAN, 2])


def test_foxglove_scans_in_json_and_protobuf(sensors: ModuleType) -> None:
    ranges = [1.0, 2.5, 3.0, INF, 5.0]
    for raw in (sensors.foxglove_protobuf(ranges), sensors.foxglove_protobuf(ranges, whole=False)):
        _, _, (stamp,), (found,), geometry, _ = object_scan(
            protobuf_object(PROTOBUF["foxglove.LaserScan"], raw)
        )
        assert (stamp, found.tolist()) == (sensors.START_NS, ranges)
        assert (geometry.angle_min, geometry.angle_increment) == (-1.0, 0.5)
        assert geometry.pose == (0.5, 0.0, 0.0)
    _, _, (stamp,), (found,), geometry, _ = object_scan(
        load_json(sensors.foxglove_json([1.0, NAN, 3.0, 4.0, 5.0]))
    )
    np.testing.assert_array_equal(found, [1, NAN, 3, 4, 5])
    assert geometry.pose == (0.5, 0.0, 0.0)


# --- clouds ------------------------------------------------------------------------------------

RING = np.column_stack(
    [3 * np.cos(np.arange(8) * 0.7), 3 * np.sin(np.arange(8) * 0.7), np.zeros(8)]
)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@pytest.mark.parametrize(
    "layout",
    [
        {},
        {"kind": ">f4", "lead": 3},
        {"kind": "<f8", "tail": 0},
        {"kind": ">f8", "lead": 16, "tail": 9},
        {"height": 4, "gap": 7},
    ],
    ids=str,
)
def test_clouds_of_any_layout(
    sensors: ModuleType, tmp_path: Path, encoding: str, layout: dict[str, Any]
) -> None:
    payload = sensors.cloud(RING, encoding=encoding, **layout)
    _, (batch,) = one(sensors, tmp_path, payload, kind=sensors.CLOUD, encoding=encoding)
    seen = np.flatnonzero(np.isfinite(batch.ranges_m[0]))
    assert len(seen) == 8
    np.testing.assert_allclose(batch.ranges_m[0, seen], 3.0, rtol=1e-6)
    want = np.sort(np.angle(np.exp(0.7j * np.arange(8))))
    assert np.abs(batch.angles_rad[seen] - want).max() <= np.pi / 360 + 1e-9
    assert batch.free_m.tolist() == [0.0], "no point is no free way"


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_clouds_of_foxglove(sensors: ModuleType, tmp_path: Path, encoding: str) -> None:
    payload = sensors.foxglove_cloud(RING, encoding)
    found = {"kind": "foxglove.PointCloud", "encoding": encoding}
    _, (batch,) = one(sensors, tmp_path, payload, **found)
    seen = np.flatnonzero(np.isfinite(batch.ranges_m[0]))
    np.testing.assert_allclose(batch.ranges_m[0, seen], np.full(8, 3.0), rtol=1e-6)
    assert batch.times_ns.tolist() == [sensors.START_NS]
    # Its pose places the points in the frame: a quarter turn, then a metre ahead.
    turned = (1.0, 0.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    payload = sensors.foxglove_cloud([(3.0, 0.0, 0.0)], encoding, pose=turned)
    _, (batch,) = one(sensors, tmp_path, payload, **found)
    (beam,) = np.flatnonzero(np.isfinite(batch.ranges_m[0]))
    assert batch.ranges_m[0, beam] == pytest.approx(np.hypot(1, 3), rel=1e-6)
    assert batch.angles_rad[beam] == pytest.approx(np.arctan2(3, 1), abs=0.01)


def test_a_cloud_is_sliced_at_the_sensors_height_in_the_robots_frame() -> None:
    from topobatch.ingest.logs.clouds import Cloud

    def seen(points: Any, mount: np.ndarray, band: Any = None) -> list[float]:
        cloud = Cloud(0, "c", np.array(points, np.float64))
        ranges = sliced(cloud, mount, SliceSettings(band)).ranges_m[0]
        return sorted(np.round(ranges[np.isfinite(ranges)], 5).tolist())

    column = [(2.0, 0.0, z) for z in (-0.5, -0.1, 0.1, 0.5)] + [(NAN, 0.0, 0.0), (1.0, 1.0, INF)]
    assert seen([*column, (0.0, 5.0, 0.0)], LEVEL) == [2.0, 5.0]
    assert seen([(2.0, 0.0, 0.5)], LEVEL) == []
    assert seen([(2.0, 0.0, 0.5)], LEVEL, (0.4, 0.6)) == [2.0]
    # A metre up, the same band of the robot's frame lies below the sensor.
    raised = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    assert seen([(2.0, 0.0, -0.5), (3.0, 0.0, 0.0)], raised, (0.4, 0.6)) == [2.0]
    # The floor is no wall: a sensor at 0.25 m sees it 0.25 m below.
    low = np.array([0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 1.0])
    assert seen([(2.0, 0.0, -0.18), (4.0, 0.0, 0.0)], low) == [4.0]
    # A camera looks along z, with y downwards: 2 m ahead and 1 m to the right.
    from topobatch.ingest.scans.slicing import mount_of_camera

    ranges = sliced(
        Cloud(0, "c", np.array([(1.0, 0.0, 2.0)])),
        mount_of_camera("eye_optical_frame"),
        DEFAULT_SLICES,
    )
    (beam,) = np.flatnonzero(np.isfinite(ranges.ranges_m[0]))
    angle = ranges.geometry.angle_min + beam * ranges.geometry.angle_increment
    assert angle == pytest.approx(-np.arctan2(1, 2), abs=0.01)


# --- what is wrong with scans ------------------------------------------------------------------


def test_ranges_without_echo_however_they_are_written(sensors: ModuleType, tmp_path: Path) -> None:
    payloads = [
        sensors.scan([1.0, 2.0, 3.0, INF, 10.0], sensors.START_NS),
        sensors.scan([1.0, NAN, 0.0, -1.0, 0.05], sensors.START_NS + 1),
        sensors.scan([-INF, NAN, INF, 99.0, 0.0], sensors.START_NS + 2),
        sensors.scan([1, 2, 3, 4, INF], sensors.START_NS + 3, range_max=0.0),
    ]
    found, batches = one(sensors, tmp_path, *payloads)
    _, ranges = together(batches)
    np.testing.assert_array_equal(ranges[0], [1, 2, 3, NAN, NAN])
    np.testing.assert_array_equal(ranges[1], [1, NAN, NAN, NAN, NAN])
    assert np.isnan(ranges[2]).all()
    np.testing.assert_array_equal(ranges[3], [1, 2, 3, 4, NAN])
    free = np.concatenate([batch.free_m for batch in batches])
    assert free.tolist() == [10.0, 10.0, 10.0, 0.0]
    assert found.tally.warnings("/scan") == ["/scan: 1 scan holds no usable range"]


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"angle_increment": 0.0}, "no turn"),
        ({"angle_increment": NAN}, "no numbers"),
        ({"angle_min": INF}, "no numbers"),
        ({"angle_increment": 3.0}, "more than a whole one"),
    ],
)
def test_scans_without_sensible_angles_are_counted(
    sensors: ModuleType, tmp_path: Path, changes: dict[str, float], why: str
) -> None:
    good = sensors.scan([1, 2, 3, 4, 5])
    bad = [sensors.scan([1, 2, 3, 4, 5], sensors.START_NS + k, **changes) for k in (1, 2)]
    found, batches = one(sensors, tmp_path, good, *bad)
    assert sum(map(len, batches)) == 1
    (warning,) = found.tally.warnings("/scan")
    assert warning.startswith("/scan: 2 scans")
    assert why in warning


def test_times_that_are_missing_or_go_back(sensors: ModuleType, tmp_path: Path) -> None:
    stamps = [sensors.START_NS, sensors.START_NS + 10**9, sensors.START_NS - 10**12, 0]
    # Each too large to be decoded with others: together they would be put in order.
    payloads = [sensors.scan(np.ones(1 << 16), t, angle_increment=0.0001) for t in stamps]
    found, batches = one(sensors, tmp_path, *payloads)
    assert sum(map(len, batches)) == 2
    told = " ".join(found.tally.warnings("/scan"))
    assert "1 scan carries no header time" in told
    assert "1 scan goes back in time" in told
    by_log, batches = one(sensors, tmp_path, *payloads, clock="log")
    assert sum(map(len, batches)) == 4
    assert by_log.tally.left_out == {}


@settings(max_examples=40)
@given(st.data())
def test_any_bytes_are_scans_or_damage(sensors: ModuleType, data: st.DataObject) -> None:
    """Flipped bytes of real messages, in every decoder: scans come out, or failures are counted."""
    kind, encoding, whole = data.draw(
        st.sampled_from(
            [
                (sensors.SCAN, "cdr", sensors.scan([1, 2, 3, 4, 5])),
                (sensors.SCAN, "ros1", sensors.scan([1, 2, 3, 4, 5], encoding="ros1")),
                (sensors.ECHOES, "cdr", sensors.echoes([[1], [2, 3]], [[1], [1, 2]])),
                (sensors.CLOUD, "cdr", sensors.cloud(RING)),
                ("foxglove.LaserScan", "protobuf", sensors.foxglove_protobuf([1, 2, 3])),
                ("foxglove.LaserScan", "json", sensors.foxglove_json([1, 2, 3])),
                ("foxglove.PointCloud", "json", sensors.foxglove_cloud(RING, "json")),
                ("foxglove.PointCloud", "protobuf", sensors.foxglove_cloud(RING, "protobuf")),
            ]
        )
    )
    raw = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 6))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raw = raw[: data.draw(st.integers(0, len(raw)))] if data.draw(st.booleans()) else raw
    channel = Channel("/scan", kind, encoding)
    decoder = scan_decoder(channel, lambda c: sliced(c, LEVEL, DEFAULT_SLICES))
    found = decoded(decoder, [bytes(raw), whole])
    rows = sum(len(scans.message) for scans in found)
    assert rows + decoder.failed == 2
    assert all(scans.ranges_m.dtype == np.float32 for scans in found)


# --- mounting ----------------------------------------------------------------------------------


def points(batches: list[ScanBatch]) -> np.ndarray:
    """(k, 2) what the beams meet, in the robot's frame."""
    (batch,) = batches
    x, y, yaw = batch.T_body_laser
    angle = batch.angles_rad + yaw
    xy = batch.ranges_m[0][:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return xy[np.argsort(batch.ranges_m[0])] + [x, y]


def test_beams_that_go_round_clockwise(sensors: ModuleType, tmp_path: Path) -> None:
    turned = sensors.scan([5, 4, 3, 2, 1], angle_min=1.0, angle_max=-1.0, angle_increment=-0.5)
    _, (batch,) = one(sensors, tmp_path, turned)
    assert batch.ranges_m.tolist() == [[1, 2, 3, 4, 5]]
    np.testing.assert_allclose(batch.angles_rad, [-1, -0.5, 0, 0.5, 1])
    assert batch.sweep_s == pytest.approx(-0.04)


def test_a_tilted_laser_and_an_unknown_frame_are_left_out(
    sensors: ModuleType, tmp_path: Path
) -> None:
    tilted = np.array([0.0, 0.0, 1.0, 0.0, np.sin(0.3), 0.0, np.cos(0.3)])
    found, batches = one(
        sensors, tmp_path, sensors.scan([1, 2, 3, 4, 5]), mounting=Mounting({"laser": tilted})
    )
    assert batches == []
    assert "tilted" in found.tally.warnings("/scan")[0]
    found, batches = one(sensors, tmp_path, sensors.scan([1, 2, 3, 4, 5]), mounting=Mounting())
    assert batches == []
    assert "'laser'" in found.tally.warnings("/scan")[0]
