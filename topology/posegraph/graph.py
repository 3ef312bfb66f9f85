"""The pose graph as a value: planar poses, relative measurements and priors.

The error of an edge from pose i to pose j with measurement T_i_j, in g2o's metric, is

    e = T_i_j^-1 ∘ (T_i^-1 ∘ T_j),  χ² = eᵀ Ω e

Other kinds of measurement are expressed with the same parts:

* a *point landmark* is a pose whose edges carry no heading information;
* a *known heading* (Manhattan world) is a prior with heading information only;
* a *systematic error of the odometry* (heading bias per metre, scale, …) is a shared variable that
  enters the measurements of many edges linearly (`SharedErrors`).

If the heading error accumulates *along* an edge, the error distribution of its end is curved
("banana-shaped") around the start and no ellipse fits it. Turning the measurement by a share of the
edge's heading error (`swing`, 1/2 for a uniform accumulation) makes it Gaussian (Long, Wolfe,
Mashner, Chirikjian, The banana distribution is Gaussian, RSS 2012).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..frozen import freeze
from ..se2 import turned, wrap


def _symmetric(information: FloatArray, name: str) -> None:
    """Raise ValueError unless the (k, 3, 3) matrices are symmetric with a non-negative diagonal."""
    if not np.allclose(information, information.transpose(0, 2, 1), rtol=1e-6, atol=1e-9):
        raise ValueError(f"{name} must be symmetric")
    if np.any(np.einsum("kii->ki", information) < 0):
        raise ValueError(f"{name} has a negative diagonal")


def _nothing(*shape: int) -> FloatArray:
    """Placeholder for a field that was not given; `__post_init__` replaces it."""
    return np.zeros(shape)


def _kernel(width: FloatArray, count: int, name: str) -> FloatArray:
    """Read-only kernel widths (count,), infinite where none were given."""
    widths = np.array(width, np.float64) if len(width) else np.full(count, np.inf)
    if widths.shape != (count,) or not np.all(widths > 0):
        raise ValueError(f"{name} needs {count} positive widths (inf: none)")
    widths.flags.writeable = False
    return widths


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Relative poses between nodes of a pose graph.

    source, target: (k,); measurement: (k, 3) T_source_target; information: (k, 3, 3).
    """

    source: IntArray
    target: IntArray
    measurement: FloatArray
    information: FloatArray

    def __post_init__(self) -> None:
        k = len(self.source)
        freeze(self, np.int64, source=(k,), target=(k,))
        freeze(self, np.float64, measurement=(k, 3), information=(k, 3, 3))

    def __len__(self) -> int:
        return len(self.source)


NO_MEASUREMENTS = Measurements(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
)


@dataclass(frozen=True, slots=True, eq=False)
class Priors:
    """Absolute measurements of single poses, in the graph's own frame.

    node: (u,) vertex; value: (u, 3) x, y [m], theta [rad]; information: (u, 3, 3), zero in
    components that are not measured; kernel: (u,) width of a Cauchy kernel in sigmas, inf for least
    squares.
    """

    node: IntArray
    value: FloatArray
    information: FloatArray
    kernel: FloatArray = field(default_factory=lambda: _nothing(0))

    def __post_init__(self) -> None:
        u = len(self.node)
        freeze(self, np.int64, node=(u,))
        freeze(self, np.float64, value=(u, 3), information=(u, 3, 3))
        _symmetric(self.information, "information of the priors")
        object.__setattr__(self, "kernel", _kernel(self.kernel, u, "kernel of the priors"))

    def __len__(self) -> int:
        return len(self.node)

    @classmethod
    def empty(cls) -> Priors:
        """No priors."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)))

    @classmethod
    def headings(
        cls,
        node: IntArray,
        theta_rad: FloatArray,
        sigma_rad: FloatArray | float,
        kernel: FloatArray | None = None,
    ) -> Priors:
        """Priors of headings only: node, theta_rad: (u,); sigma_rad: (u,) or one number [rad]."""
        u = len(node)
        value, information = np.zeros((u, 3)), np.zeros((u, 3, 3))
        value[:, 2] = theta_rad
        information[:, 2, 2] = 1.0 / np.square(sigma_rad)
        return cls(node, value, information, _nothing(0) if kernel is None else kernel)


@dataclass(frozen=True, slots=True, eq=False)
class SharedErrors:
    """Systematic errors of the odometry: `k` unknowns b shared by many measurements.

    The measurement of edge e becomes `measurement[e] + sensitivity[e] @ b` (x, y, theta in the
    frame of the edge's source). sensitivity: (m, 3, k), zero for edges that are not odometry;
    sigma: (k,) 1 sigma of the zero-mean prior of b. Units are the caller's: for a heading bias β
    [rad/m] over an edge of length Δs, the heading row is Δs.
    """

    sensitivity: FloatArray
    sigma: FloatArray

    def __post_init__(self) -> None:
        k, m = len(self.sigma), len(self.sensitivity)
        freeze(self, np.float64, sensitivity=(m, 3, k), sigma=(k,))
        if np.any(self.sigma <= 0):
            raise ValueError("the sigma of a shared error must be positive")

    def __len__(self) -> int:
        return len(self.sigma)

    @classmethod
    def none(cls, edges: int = 0) -> SharedErrors:
        """No shared errors, for a graph with `edges` edges."""
        return cls(_nothing(edges, 3, 0), _nothing(0))


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """`n` poses and `m` relative measurements, the input of `posegraph.solve`.

    pose: (n, 3) initial guess; source, target: (m,) vertices of every edge; measurement: (m, 3)
    T_source_target; information: (m, 3, 3), symmetric, positive semidefinite, zero in components
    that are not measured; kernel: (m,) width of a Cauchy kernel in sigmas, inf for least squares;
    swing: (m,) share of an edge's heading error by which its measured translation is rotated before
    it is compared, 0 for g2o's metric; priors, shared: see `Priors` and `SharedErrors`. The frame
    is free (gauge) unless priors fix it. Raises ValueError on shapes that do not fit, NaN, indices
    out of range, and edges from a pose to itself.
    """

    pose: FloatArray
    source: IntArray
    target: IntArray
    measurement: FloatArray
    information: FloatArray
    kernel: FloatArray = field(default_factory=lambda: _nothing(0))
    priors: Priors = field(default_factory=Priors.empty)
    shared: SharedErrors = field(default_factory=SharedErrors.none)
    swing: FloatArray = field(default_factory=lambda: _nothing(0))

    def __post_init__(self) -> None:
        n, m = len(self.pose), len(self.source)
        if not len(self.swing):
            object.__setattr__(self, "swing", _nothing(m))
        freeze(self, np.int64, source=(m,), target=(m,))
        freeze(self, np.float64, pose=(n, 3), measurement=(m, 3), information=(m, 3, 3))
        freeze(self, np.float64, swing=(m,))
        object.__setattr__(self, "kernel", _kernel(self.kernel, m, "kernel of the edges"))
        if not len(self.shared):
            object.__setattr__(self, "shared", SharedErrors.none(m))
        _symmetric(self.information, "information of the edges")
        ends = np.concatenate([self.source, self.target, self.priors.node])
        if np.any(ends < 0) or np.any(ends >= n):
            raise ValueError("an edge or a prior names a pose that does not exist")
        if np.any(self.source == self.target):
            raise ValueError("an edge joins a pose to itself")
        if len(self.shared.sensitivity) != m:
            raise ValueError("shared errors need one sensitivity per edge")

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.pose)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The solved poses with their residuals.

    pose: (n, 3); shared: (k,) systematic errors; chi2: Σ eᵀΩe over all edges, without kernels,
    weights and priors (g2o's metric); cost: the minimised cost, with kernels, weights and priors;
    edge_chi2: (m,) eᵀΩe; edge_weight: (m,) in [0, 1], weights by the kernels; prior_weight: (u,)
    likewise; iterations: number of factorisations; converged: whether the gradient vanishes, i.e. a
    full step would lower the cost by no more than the tolerances of `SolverSettings`.
    """

    pose: FloatArray
    shared: FloatArray
    chi2: float
    cost: float
    edge_chi2: FloatArray
    edge_weight: FloatArray
    prior_weight: FloatArray
    iterations: int
    converged: bool

    def with_full_weights(self) -> Solution:
        """The solution with weights above 1/2 set to 1, for covariances.

        A Cauchy estimate is nearly as efficient as least squares (97 % at a width of three sigmas),
        although the weights of inliers at the solution are below 1.
        """
        edge, prior = (np.where(w > 0.5, 1.0, w) for w in (self.edge_weight, self.prior_weight))
        return replace(self, edge_weight=edge, prior_weight=prior)


def edge_errors(graph: PoseGraph, pose: FloatArray, shared: FloatArray) -> FloatArray:
    """(m, 3) errors e = T_ij^-1 ∘ (T_i^-1 ∘ T_j) of all edges at the given poses (n, 3) and shared
    errors (k,); T_i is first rotated by `swing` · e_θ."""
    T_i_j = corrected_measurement(graph, shared)
    step = pose[graph.target] - pose[graph.source]
    turn = wrap(step[:, 2] - T_i_j[:, 2])
    offset = turned(step, -pose[graph.source, 2] - graph.swing * turn) - T_i_j[:, :2]
    error_xy = turned(offset, -T_i_j[:, 2])
    return np.column_stack([error_xy, turn])


def corrected_measurement(graph: PoseGraph, shared: FloatArray) -> FloatArray:
    """(m, 3) measurements with the shared errors applied."""
    if len(graph.shared) == 0:
        return graph.measurement
    return np.asarray(graph.measurement + graph.shared.sensitivity @ shared)


def prior_errors(graph: PoseGraph, pose: FloatArray) -> FloatArray:
    """(u, 3) pose minus prior, in the frame of the graph."""
    error = pose[graph.priors.node] - graph.priors.value
    error[:, 2] = wrap(error[:, 2])
    return error


def squared(error: FloatArray, information: FloatArray) -> FloatArray:
    """(k,) eᵀ Ω e of every row."""
    weighted = np.matmul(information, error[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ki,ki->k", error, weighted))
