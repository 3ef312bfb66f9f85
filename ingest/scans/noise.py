"""Noise of scan-matched odometry, in the terms of loop closure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from ...topology.arrays import FloatArray, IntArray
from ...topology.columns import joined
from ...topology.digits import significant
from ...topology.run import ScanPasses
from ...topology.se2 import between, wrap
from ...topology.topomap import RunNoise
from .step_errors import LONG, SHORT, SpanErrors

PRIOR = RunNoise(centre_m=0.12, branch_rad=0.07, miss_rate=0.06, phantom_rate=0.03)
"""Of passes from scans: the same place, passed again, moves by 0.08 to 0.18 m and turns by 2 to 4
degrees, and is not detected again in 6 of 100 (`benchmarks/laser.py`)."""
LEAST_HEADING = 1e-4
"""Lower bound of the heading noise [rad per root metre]."""
USUAL_HEADING = 1e-3
"""Prior heading noise [rad per root metre, or per root radian] with the weight of one long span:
scans in twelve buildings have 0.0005 to 0.0024. It decides for drives of a few metres."""
ALONE_ALONG, ALONE_HEADING = 0.15, 0.01
"""Lower bounds for scans without odometry, because of bare corridors [m, rad per root metre]."""


def matched_noise(
    spans: Sequence[SpanErrors], passes: ScanPasses, *, alone: bool = False
) -> RunNoise:
    """Noise of matched odometry: random walks fitted to the variances of the spans, those of
    headings by non-negative least squares; branch faults by the share of variants that disagree
    with their pass.

    alone: whether there was no odometry beside the scans.
    """
    doubt = float(np.mean(1 - passes.confidence)) if len(passes) else PRIOR.branch_fault_rate
    fault = float(np.clip(doubt, PRIOR.branch_fault_rate, 0.5))
    every = joined(spans) if spans else None
    if every is None or len(every.way) == 0:
        return replace(PRIOR, branch_fault_rate=fault)
    along = float(np.sqrt(np.median(every.along / np.maximum(every.way, 0.1))))
    walk = _heading_walk(every.far, every.turned, every.variance)
    heading = max(float(np.sqrt(walk[0])), ALONE_HEADING if alone else LEAST_HEADING)
    return replace(
        PRIOR,
        along_m_per_sqrt_m=significant(max(along, ALONE_ALONG) if alone else along),
        heading_rad_per_sqrt_m=significant(heading),
        heading_rad_per_sqrt_rad=significant(max(float(np.sqrt(walk[1])), LEAST_HEADING)),
        branch_fault_rate=significant(fault),
    )


def _heading_walk(way: FloatArray, turned: FloatArray, variance: FloatArray) -> FloatArray:
    """(2,) variance of headings per metre and per radian that matches the total over all spans."""
    terms = np.column_stack([way, turned])
    weight = 1 / np.maximum(way, 0.1)
    walk, _ = nnls(terms * weight[:, None], variance * weight)
    walk = walk * variance.sum() / max(float((terms @ walk).sum()), 1e-12)
    # Spans begin `SHORT` apart: so many stand beside each other.
    spans = len(variance) * SHORT / LONG
    return np.asarray((USUAL_HEADING**2 + spans * walk) / (1 + spans))


HALF = 0.6745
"""Median of the absolute value of a standard normal: position errors are mostly across the
track."""


def expected_drift(noise: RunNoise, pose: FloatArray, way: FloatArray, way_m: float) -> float:
    """Median position error [m] after `way_m`, by a run's noise, over all parts of the poses (n, 3)
    of that length; NaN if the run is shorter. O(n) by prefix sums."""
    first, last = _stretches(way, way_m)
    if len(first) == 0:
        return float("nan")
    turned = np.abs(wrap(np.diff(pose[:, 2])))
    q = noise.heading_rad_per_sqrt_m**2 * np.diff(way)
    q = q + noise.heading_rad_per_sqrt_rad**2 * turned
    xy = pose[:, :2] - pose[:, :2].mean(axis=0)
    terms = np.column_stack([q, q[:, None] * xy[:-1], q * np.sum(xy[:-1] ** 2, axis=1)])
    sums = np.concatenate([np.zeros((1, 4)), np.cumsum(terms, axis=0)])
    (s0, sx, sy, s2), end = (sums[last] - sums[first]).T, xy[last]
    across = s0 * np.sum(end**2, axis=1) - 2 * (sx * end[:, 0] + sy * end[:, 1]) + s2
    along = noise.along_m_per_sqrt_m**2 * (way[last] - way[first])
    return HALF * float(np.median(np.sqrt(np.maximum(across, 0.0) + along)))


def _stretches(way: FloatArray, way_m: float) -> tuple[IntArray, IntArray]:
    """First and last rows of all parts of the given length."""
    last = np.searchsorted(way, way + way_m)
    first = np.flatnonzero(last < len(way))
    return first, last[first]


def recorded_drift(
    recorded: FloatArray, corrected: FloatArray, way: FloatArray, way_m: float
) -> float:
    """Median distance [m] between recorded (n, 3) and corrected odometry after `way_m`; NaN if the
    run is shorter."""
    first, last = _stretches(way, way_m)
    if len(first) == 0:
        return float("nan")
    off = between(
        between(corrected[first], corrected[last]), between(recorded[first], recorded[last])
    )
    return float(np.median(np.hypot(off[:, 0], off[:, 1])))
