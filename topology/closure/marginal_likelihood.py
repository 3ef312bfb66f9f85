"""How well the places of a closed run, as a whole, explain what was measured.

Different identifications of one run are different models of the same measurements. Their marginal
likelihoods, with all positions integrated out, compare them (Kass, Raftery: Bayes Factors, 1995):
more places fit better, and each costs the density at which it might have been anywhere. The
integral is Laplace's approximation at the solved pose graph (MacKay: Information Theory, Inference,
and Learning Algorithms, 2003, chapter 27).
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..posegraph.marginals import Marginals
from .branches import ANYWHERE
from .estimate import Estimate
from .variance_components import ComponentSettings

_LN_2PI = float(np.log(2 * np.pi))

_ZERO = 1e-13
"""A factor measures nothing along eigenvectors of its information below this share of the largest
eigenvalue: rounding leaves less, and positions to 1 km beside headings to 1 mrad have 1e-12."""


def log_marginal_likelihood(estimate: Estimate, density: float) -> float:
    """Log density [nats] of the measurements given their places, up to a constant of the run.

    estimate: of the places, without a grid; density: of places per m². With n places of density ρ
    and any heading, factors of information Ω, and the normal matrix H of d unknowns:
    n ln(ρ / 2π) + ½ Σ ln |Ω / 2π| - ½ ln |H / 2π| - ½ f (ln s² + 1), f = Σ rank Ω - d. The level s²
    of the noise is the most likely one, χ² / f, as wrong identifications look like noise; its prior
    counts like `ComponentSettings.prior_freedom` more measurements that fit the stated noise.
    """
    solution = estimate.solution
    factor = Marginals.of(estimate.graph, solution).factor
    measured, numbers = _log_density_of_no_error(estimate.graph.information)
    unknowns = factor.pattern.size
    stated = ComponentSettings().prior_freedom
    freedom = numbers - unknowns + stated
    level = (solution.cost + stated) / freedom
    anywhere = len(estimate.xy) * (np.log(density) - ANYWHERE)
    integral = -0.5 * (factor.log_determinant() - unknowns * _LN_2PI)
    return float(anywhere + measured + integral - 0.5 * freedom * (np.log(level) + 1.0))


def _log_density_of_no_error(information: FloatArray) -> tuple[float, int]:
    """½ Σ ln |Ω / 2π| of information matrices Ω (m, 3, 3), and how many numbers they measure."""
    values = np.linalg.eigvalsh(information)
    told = values[values > _ZERO * values[:, -1:]]
    return 0.5 * float((np.log(told) - _LN_2PI).sum()), len(told)
