"""From odometry and scans to corrected odometry and junctions, in a building drawn by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.scans.detection import detect
from topobatch.ingest.scans.keyframes import Keyframes
from topobatch.ingest.scans.scan import ScanBatch, ScanResult
from topobatch.topology.errors import DataError
from topobatch.topology.odometry import Odometry
from topobatch.topology.run import NO_DETECTIONS, Run
from topobatch.topology.se2 import apply, between, wrap

from .building import HALF_TURN, RING, WHOLE_TURN, Building, biased, drive, parts, scans

BIAS = np.radians(2.0)
# Once around the western half, then through the middle and around the eastern one.
ROUND = drive((0, 0), (10, 0), (10, 20), (0, 20), (0, 0), (20, 0), (20, 20), (10, 20), (10, 0))
CROSSINGS = {(10, 0): 3, (10, 20): 3, (20, 8): 3}


@cache
def seen() -> ScanBatch:
    return scans(RING, ROUND)


@cache
def found() -> ScanResult:
    return detect(biased(ROUND, BIAS), parts(seen(), 64))


def drift(result: ScanResult, truth: Odometry, way_m: float) -> np.ndarray:
    """(q,) errors of the position after `way_m` [m]."""
    time_ns = result.odometry.time_ns
    real, ours = truth.at(time_ns), result.odometry.pose
    way = np.cumsum(np.concatenate([[0], np.hypot(*np.diff(real[:, :2], axis=0).T)]))
    last = np.searchsorted(way, way + way_m)
    first = np.flatnonzero(last < len(way))
    last = last[first]
    off = between(between(real[first], real[last]), between(ours[first], ours[last]))
    return np.hypot(off[:, 0], off[:, 1])


def true_centres(result: ScanResult, truth: Odometry) -> np.ndarray:
    return apply(truth.at(result.scanned.passes.time_ns), result.scanned.passes.centre)


def test_odometry_is_corrected() -> None:
    result = found()
    assert np.percentile(drift(result, ROUND, 20.0), 90) < 0.2
    assert result.statistics.drift_before_m > 1.0
    assert result.statistics.drift_after_m < 0.5
    assert result.statistics.bias_rad_per_m == pytest.approx(BIAS, abs=np.radians(0.3))
    assert result.statistics.covered > 0.95
    assert result.statistics.scans == len(seen())


def test_every_crossing_is_passed_and_nothing_else() -> None:
    result = found()
    centres = true_centres(result, ROUND)
    for place, degree in CROSSINGS.items():
        near = np.flatnonzero(np.hypot(*(centres - place).T) < 0.6)
        assert len(near) >= 1, place
        assert set(result.scanned.passes.branches.counts[near].tolist()) == {degree}
        assert (result.scanned.passes.confidence[near] >= 6 / 7 - 1e-9).all()
    away = np.min([np.hypot(*(centres - place).T) for place in CROSSINGS], axis=0)
    assert (away < 0.6).all()


def test_branches_point_along_the_corridors() -> None:
    result = found()
    passes, centres = result.scanned.passes, true_centres(result, ROUND)
    row = int(np.argmin(np.hypot(*(centres - (20, 8)).T)))
    heading = passes.branches[row] + ROUND.at(passes.time_ns[row : row + 1])[0, 2]
    wanted = np.array([-np.pi / 2, 0.0, np.pi / 2])
    off = np.abs(wrap(np.sort(wrap(heading)) - wanted))
    assert off.max() < 0.2
    # Straight corridors hardly turn, and their crossings' centres are not aside.
    assert passes.askew_rad < 0.05
    assert (passes.shared_m < 0.2).all()


def test_map_closes_its_loops() -> None:
    result = found()
    run = Run("ring", result.odometry, NO_DETECTIONS, scanned=result.scanned)
    topomap = build_map(run)
    # No pass is left out, and every crossing is one junction, however often it was passed.
    centres = true_centres(result, ROUND)
    crossings = np.array([*CROSSINGS])
    crossing = np.hypot(*(centres[:, None] - crossings).transpose(2, 0, 1)).argmin(axis=1)
    pairs = set(zip(crossing.tolist(), topomap.observation_vertex.tolist(), strict=True))
    assert len(centres) > len(topomap) == len(pairs) == len(set(crossing.tolist()))


def test_result_does_not_depend_on_batches_or_the_order_of_beams() -> None:
    small = detect(biased(ROUND, BIAS), parts(seen(), 17))
    batch = seen()
    turned = ScanBatch(
        batch.times_ns, batch.ranges_m[:, ::-1], batch.free_m, batch.angles_rad[::-1]
    )
    backwards = detect(biased(ROUND, BIAS), [turned])
    for other in (small, backwards):
        assert other.odometry.pose.tobytes() == found().odometry.pose.tobytes()
        assert other.scanned.passes.centre.tobytes() == found().scanned.passes.centre.tobytes()
        assert (
            other.scanned.passes.confidence.tobytes() == found().scanned.passes.confidence.tobytes()
        )


def test_a_robot_that_turned_round_between_two_scans_keeps_its_heading() -> None:
    rng = np.random.default_rng(6)
    boxes = rng.uniform((0, -2.8, 0.2, 0.2), (19, 2.5, 0.6, 0.6), (40, 4))
    aside = np.abs(boxes[:, 1] + boxes[:, 3] / 2) > 0.8
    hall = Building.of((-1, -3, 21, 3)).without(*boxes[aside].tolist())
    ends = [
        (0.0, 0.0),
        *((x, 0.0) for _ in range(6) for x in rng.uniform((15, 1), (19, 5)).tolist()),
    ]
    truth = drive(*ends)
    whole = scans(hall, truth)
    # The last scan of every metre: none while it turns on the spot.
    row = np.flatnonzero(np.diff(np.floor(np.cumsum(truth.step_m))) > 0)
    apart = ScanBatch(whole.times_ns[row], whole.ranges_m[row], 0.0, whole.angles_rad)
    result = detect(biased(truth, BIAS), [apart])
    real, ours = truth.at(result.odometry.time_ns), result.odometry.pose
    turned = wrap(np.diff(real[:, 2]))
    assert np.count_nonzero(np.abs(turned) > 3) == 11
    assert np.abs(wrap(np.diff(ours[:, 2]) - turned)).max() < np.radians(4.0)


def test_scans_alone() -> None:
    result = detect(None, parts(seen(), 100))
    assert not result.statistics.odometry
    assert np.percentile(drift(result, ROUND, 20.0), 90) < 1.0
    assert result.scanned.noise.along_m_per_sqrt_m > found().scanned.noise.along_m_per_sqrt_m
    assert any("no odometry" in warning for warning in result.warnings)


def test_scans_alone_say_where_they_do_not_tell_the_distance() -> None:
    hall = Building.of((-1, -1, 61, 1), (-1, -1, 1, 12), (59, -1, 61, 12))
    result = detect(None, [scans(hall, drive((0, 10), (0, 0), (60, 0), (60, 10)))])
    (told,) = (warning for warning in result.warnings if "no odometry" in warning)
    # From 15 m behind the first corner to 15 m before the second, at 10 m / 0.6 m/s and on.
    along, way = (float(n) for n in re.findall(r"along (\d+) of (\d+) m", told)[0])
    assert along > 0.2 * way
    assert "the longest of them" in told


def test_motion_during_the_sweep_is_taken_out() -> None:
    quick = drive((0, 0), (10, 0), (10, 12), speed=1.5)
    batch = scans(RING, quick, WHOLE_TURN, sweep_s=0.18)
    plain = ScanBatch(batch.times_ns, batch.ranges_m, 0.0, batch.angles_rad)
    told, untold = detect(quick, [batch]), detect(quick, [plain])
    assert np.median(drift(told, quick, 5.0)) < 0.7 * np.median(drift(untold, quick, 5.0))


def test_several_lasers_see_together() -> None:
    truth = drive((0, 0), (10, 0), (10, 12))
    front = scans(RING, truth, mount=np.array([0.2, 0.0, 0.0]))
    back = scans(RING, truth, mount=np.array([-0.2, 0.1, np.pi]))
    both = [b for pair in zip(parts(front, 5), parts(back, 5), strict=True) for b in pair]
    result = detect(biased(truth, BIAS), both)
    assert result.statistics.scans == 2 * len(truth)
    assert np.percentile(drift(result, truth, 5.0), 90) < 0.12
    assert np.hypot(*(true_centres(result, truth) - (10, 0)).T).min() < 0.5


def test_a_corridor_without_a_junction_has_a_map() -> None:
    corridor = Building.of((-5, -1, 45, 1), (12, 0.9, 14, 1.4), (27, -1.4, 28.5, -0.9))
    way = drive((0, 0), (40, 0))
    batch = scans(corridor, way)
    result = detect(way, [batch])
    assert any("no junction shows" in line for line in result.warnings)
    assert abs(true_centres(result, way) - (20, 0)).max() < 0.5
    topomap = build_map(Run("r", result.odometry, NO_DETECTIONS, scanned=result.scanned))
    assert len(topomap) == 1
    assert np.ptp(topomap.views.pose[:, 0]) > 30
    kept: list[Keyframes] = []
    matched = detect(way, [batch], on_keyframes=kept.append)
    assert (len(kept), len(matched.scanned.passes), matched.warnings) == (1, 0, ())
    short = drive((0, 0), (9, 0))
    assert len(detect(short, [scans(corridor, short)]).scanned.passes) == 0


def test_views_of_a_part_without_a_junction_are_left_out() -> None:
    """The odometry was reset behind the third junction, and no other shows from there on."""
    result = found()
    scanned, odometry = result.scanned, result.odometry
    cut = int(np.searchsorted(odometry.time_ns, scanned.passes.time_ns[3]))
    odometry = replace(odometry, breaks=np.array([cut]))
    columns = ("time_ns", "start_ns", "end_ns", "centre", "confidence", "windows", "clearance_m")
    first = {name: getattr(scanned.passes, name)[:3] for name in (*columns, "shared_m")}
    few = replace(scanned.passes, branches=scanned.passes.branches.take(np.arange(3)), **first)
    run = Run("ring", odometry, NO_DETECTIONS, scanned=replace(scanned, passes=few))
    views = build_map(run).views
    assert 0 < len(views) < len(scanned.views)
    assert views.time_ns.max() < odometry.time_ns[cut]


@pytest.mark.parametrize("odometry", [ROUND, None])
def test_nothing_to_go_by(odometry: Odometry | None) -> None:
    with pytest.raises(DataError, match="no usable scan"):
        detect(odometry, [])
    blind = ScanBatch(ROUND.time_ns[:20], np.full((20, 181), np.nan, np.float32), 0.0, HALF_TURN)
    with pytest.raises(DataError, match=r"none of the 20 scans has an echo$"):
        detect(odometry, [blind])


def test_beams_too_far_apart_to_show_surfaces_are_told() -> None:
    batch = parts(seen(), 120)[0]
    ranges = np.where(np.arange(batch.ranges_m.shape[1]) % 9 == 0, batch.ranges_m, np.nan)
    sparse = ScanBatch(batch.times_ns, ranges.astype(np.float32), 0.0, batch.angles_rad)
    assert any("too few surfaces" in line for line in detect(ROUND, [sparse]).warnings)
    assert not any("too few surfaces" in line for line in detect(ROUND, [batch]).warnings)
