"""What the noise of scan-matched odometry means in metres."""

import numpy as np
import pytest

from topobatch.ingest.scans.noise import HALF, expected_drift, matched_noise, recorded_drift
from topobatch.ingest.scans.scan import ScanPasses
from topobatch.ingest.scans.step_errors import SpanErrors
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import RunNoise

NOISE = RunNoise(
    along_m_per_sqrt_m=0.03, heading_rad_per_sqrt_m=0.01, heading_rad_per_sqrt_rad=0.02
)


def circle(turns: float, radius: float, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Poses on a circle, far from the origin, and the way so far."""
    t = np.linspace(0, 2 * np.pi * turns, n)
    xy = 500 + radius * np.stack([np.sin(t), -np.cos(t)], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    return np.column_stack([xy, t]), way


def test_straight_on_it_is_the_integral_of_the_heading() -> None:
    way = np.linspace(0, 40, 401)
    pose = np.column_stack([way, np.zeros((401, 2))])
    across = 0.01**2 * 20**3 / 3
    want = HALF * np.sqrt(across + 0.03**2 * 20)
    assert expected_drift(NOISE, pose, way, 20.0) == pytest.approx(want, rel=0.01)


def test_round_a_bend_as_many_drives_say() -> None:
    pose, way = circle(0.6, 5.0)
    rng = np.random.default_rng(4)
    step, turn = np.diff(way), np.diff(pose[:, 2])
    sigma = np.sqrt(0.01**2 * step + 0.02**2 * turn)
    ahead = step + rng.normal(0, 0.03, (2000, len(step))) * np.sqrt(step)
    heading = pose[:-1, 2] + turn / 2
    heading = heading + np.cumsum(rng.normal(0, 1, (2000, len(step))) * sigma, axis=1)
    end = np.stack([(ahead * f(heading)).sum(axis=1) for f in (np.cos, np.sin)], axis=1)
    real = np.stack([(step * f(pose[:-1, 2] + turn / 2)).sum() for f in (np.cos, np.sin)])
    spread = np.sqrt(np.sum((end - real) ** 2, axis=1).mean())
    assert expected_drift(NOISE, pose, way, way[-1] - 1e-9) == pytest.approx(
        HALF * spread, rel=0.06
    )


def test_a_run_too_short_tells_none() -> None:
    pose, way = circle(0.1, 1.0)
    assert np.isnan(expected_drift(NOISE, pose, way, 20.0))
    assert np.isnan(recorded_drift(pose, pose, way, 20.0))


def test_a_walk_is_as_uncertain_as_its_spans() -> None:
    rng = np.random.default_rng(2)
    way = rng.uniform(2, 5, 300)
    far, around = rng.uniform(15, 20, 300), rng.uniform(0, 9, 300)
    no_time, no_rows = np.zeros(0, np.int64), Ragged.from_rows([])
    none = ScanPasses(
        time_ns=no_time,
        start_ns=no_time,
        end_ns=no_time,
        centre=np.zeros((0, 2)),
        branches=no_rows,
        support=no_rows,
        confidence=np.zeros(0),
        windows=no_time,
        clearance_m=np.zeros(0),
        shared_m=np.zeros(0),
    )

    def noise(loud: float, together: float = 1.3) -> RunNoise:
        heading = loud**2 * (2e-6 * far + 4e-6 * around) * rng.chisquare(20, 300) / 20
        told = SpanErrors(
            way,
            4e-4 * way,
            far,
            around,
            walls=heading / 2 / 1.3,
            absorbed=np.zeros(300),
            odometry=heading / 2,
            apart=together * heading,
            apart_alone=heading,
        )
        return matched_noise([told], none)

    quiet, loud = noise(1.0), noise(2.0)
    assert quiet.heading_rad_per_sqrt_m**2 == pytest.approx(2e-6, rel=0.2)
    assert quiet.heading_rad_per_sqrt_rad**2 == pytest.approx(4e-6, rel=0.2)
    assert loud.heading_rad_per_sqrt_m == pytest.approx(2 * quiet.heading_rad_per_sqrt_m, rel=0.1)
    # Of the spans' own 3.0 and the usual 1.3, by what either tells: 2.7 times half of the variance.
    bent = noise(1.0, together=3.0)
    total = [
        20 * n.heading_rad_per_sqrt_m**2 + 5 * n.heading_rad_per_sqrt_rad**2 for n in (bent, quiet)
    ]
    assert total[0] / total[1] == pytest.approx(0.5 + 0.5 * 2.7 / 1.3, rel=0.05)
    short = (np.array([x]) for x in (4.0, 1e-4, 4.0, 0.1, 1e-12, 1.0, *3 * [1e-12]))
    few = matched_noise([SpanErrors(*short)], none)
    assert few.heading_rad_per_sqrt_m > 8e-4
    assert loud.along_m_per_sqrt_m == quiet.along_m_per_sqrt_m == pytest.approx(0.02, rel=0.01)
