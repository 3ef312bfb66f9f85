"""The noise of a walk from its own layout: variance components of the closed pose graph.

Before closure little tells how much an odometry drifts (`ingest.noise`). Loops do: what their
edges are off, and how far each kind of noise was free to show it, gives every variance by itself
(Förstner's estimate, Bestimmung der Varianzkomponenten, 1979; REML with as many iterations).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..odometry import Odometry
from ..posegraph.graph import edge_errors
from ..posegraph.samples import SampledMarginals
from ..topomap import RunNoise
from .dead_reckoning import RANDOM_SUMS, Walk, make_walk, relative_covariance
from .estimate import Layout, lay_out
from .manhattan import GridHeadings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

COMPONENTS = (
    "along_m_per_sqrt_m",
    "heading_rad_per_sqrt_m",
    "heading_rad_per_sqrt_rad",
    "centre_m",
    "branch_rad",
)
"""Fields of RunNoise that a layout tells, in this order."""


@dataclass(frozen=True, slots=True)
class ComponentSettings:
    """How far the estimates before closure hold."""

    prior_freedom: tuple[float, float, float, float, float] = (2.0, 2.0, 2.0, 4.0, 4.0)
    """Degrees of freedom that told each before: its variance to √(2 / freedom) of itself."""
    rounds: int = 3
    """Each estimates the components again, with the weights that the one before gave."""
    samples: int = 64
    """They tell a variance to √(2 / 64), 18 %: less than the prior's freedom leaves open."""


def fitted_noise(
    walk: Walk,
    odometry: Odometry,
    place: IntArray,
    layout: Layout,
    *,
    grid: GridHeadings | None = None,
    settings: ComponentSettings = ComponentSettings(),
) -> tuple[Walk, Layout]:
    """The walk with its most likely noise, and its layout by that.

    walk: with the noise that the run showed before closure, which stays the prior; odometry: that
    of the walk; layout: one of the places, to begin with; grid: headings that hold it. Each round:
    one layout, and the trace of every component's share in the posterior from samples.
    """
    prior = np.array([getattr(walk.noise, name) for name in COMPONENTS]) ** 2
    worth = np.array(settings.prior_freedom)
    units = _unit_walks(walk, odometry)
    legs = _leg_covariances(walk, units)
    variance = prior
    layout = lay_out(walk, place, layout.pose, grid=grid)
    for _ in range(settings.rounds):
        energy, freedom = _told(layout, legs, variance, settings.samples)
        variance = (worth * prior + energy * variance) / (worth + freedom)
        walk = _with_variances(walk, units, variance)
        layout = lay_out(walk, place, layout.pose, grid=grid)
    return walk, layout


def _unit_walks(walk: Walk, odometry: Odometry) -> list[Walk]:
    """The walk as if there were one random walk of the odometry only, of 1 sigma of 1."""
    none = RunNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    noises = [replace(none, **{name: 1.0}) for name in COMPONENTS[:3]]
    units = (make_walk(odometry, walk.passes, noise, walk.systematic) for noise in noises)
    # What a jump adds is no noise: it would be counted once for every component.
    return [replace(unit, jumps=np.zeros_like(unit.jumps)) for unit in units]


def _leg_covariances(walk: Walk, units: list[Walk]) -> FloatArray:
    """(3, k, 3, 3) covariance of every leg by each random walk of 1 sigma of 1."""
    row = np.flatnonzero(np.diff(walk.chain) == 0)
    return np.stack([relative_covariance(unit, row, row + 1) for unit in units])


def _with_variances(walk: Walk, units: list[Walk], variance: FloatArray) -> Walk:
    """The walk with other variances of its components; its sums are linear in them."""
    sigma = dict(zip(COMPONENTS, np.sqrt(variance).tolist(), strict=True))
    sums = walk.sums.copy()
    sums[:, :RANDOM_SUMS] = sum(
        float(v) * unit.sums[:, :RANDOM_SUMS] for v, unit in zip(variance[:3], units, strict=True)
    )
    return replace(walk, noise=replace(walk.noise, **sigma), sums=sums)


def _told(
    layout: Layout, units: FloatArray, variance: FloatArray, samples: int
) -> tuple[FloatArray, FloatArray]:
    """Of each component (5,): squared errors in units of its variance, degrees of freedom.

    With e the error of an edge, Ω its information, V the covariance by one component and C that of
    e left by the solution: eᵀ Ω V Ω e, and tr(Ω V) - tr(Ω V Ω C).
    """
    graph, solution = layout.graph, layout.solution
    error = edge_errors(graph, solution.pose, solution.shared)
    left = SampledMarginals.of(graph, solution, samples).edge
    omega, weight = graph.information, solution.edge_weight
    legs = units.shape[1]
    energy, freedom = np.zeros(5), np.zeros(5)
    for k in range(5):
        rows = slice(0, legs) if k < 3 else slice(legs, len(omega))
        if k < 3:
            part = variance[k] * units[k]
        else:
            part = np.zeros((len(omega) - legs, 3, 3))
            axes = (0, 1) if k == 3 else (2,)
            for axis in axes:
                part[:, axis, axis] = 1.0 / omega[rows, axis, axis]
        share = omega[rows] @ part @ omega[rows]
        e, c, w = error[rows], left[rows], weight[rows]
        energy[k] = w @ np.einsum("ki,kij,kj->k", e, share, e)
        taken = np.einsum("kis,kij,kjs->k", c, share, c) / samples
        whole = np.einsum("kij,kji->k", omega[rows], part)
        freedom[k] = max(float(w @ (whole - taken)), 0.0)
    return energy, freedom
