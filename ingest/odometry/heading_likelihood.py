"""The likelihood of systematic heading errors, with outliers.

    ℓ(x) = Σ_passes w · log t₃(r / σ_p) + Σ_grid log[(1 − g) / (π/2) + g Σ_r w_r N(r; σ)]

with r = y + a·x, in the grid its distance from the next quarter turn. Scales σ and the share g of
inliers are estimated along with x by expectation maximisation, in which every step is one weighted
linear least-squares problem in x.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.arrays import BoolArray, FloatArray
from .heading_evidence import TERMS, HeadingEvidence, Rows

_QUARTER = np.pi / 2
_DEGREES_OF_FREEDOM = 3.0
_USUAL_RAD = 0.1
"""Usual scatter of parallel corridors [rad]; that of the readings of one branch is half of it."""
_FINEST, _WIDEST = 0.025, 0.15
"""Bounds of the scatter of parallel corridors [rad]: at 0 the likelihood is singular, and beyond
the upper one angles of any kind seem to be right ones."""


def _residual(rows: Rows, x: FloatArray) -> FloatArray:
    """(r,) y + a·x, without a matrix product, which would start threads for so little work."""
    out: FloatArray = rows.y + rows.a[:, 0] * x[0] + rows.a[:, 1] * x[1] + rows.a[:, 2] * x[2]
    return out


@dataclass(frozen=True, slots=True)
class _Grid:
    """Rows that are near a quarter turn with probability `share` (1 sigma `sigma`), else anywhere
    between two."""

    rows: Rows
    sigma: float = _USUAL_RAD
    share: float = 0.5

    def expect(self, x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Log-likelihood, residuals, and the probability that each row is the inlier of its
        group."""
        r = _residual(self.rows, x)
        if len(r) == 0:
            return 0.0, r, r
        r -= _QUARTER * np.round(r / _QUARTER)
        density = np.exp(-0.5 * (r / self.sigma) ** 2) / (self.sigma * np.sqrt(2 * np.pi))
        inlier = self.share * self.rows.share * density
        whole = (1 - self.share) / _QUARTER + np.bincount(self.rows.owner, inlier)
        gain = float(np.log(whole * _QUARTER).sum())
        return gain, r, inlier / whole[self.rows.owner]

    def refit(self, r: FloatArray, holds: FloatArray) -> _Grid:
        """Maximum-a-posteriori scale and share, with a prior worth one inlier and one outlier of
        `_USUAL_RAD`."""
        total = float(holds.sum())
        sigma = float(np.sqrt((float((holds * r**2).sum()) + 2 * _USUAL_RAD**2) / (total + 2)))
        share = (total + 1) / (self.rows.owners + 2)
        sigma = min(max(sigma, _FINEST), _WIDEST)
        return _Grid(self.rows, sigma, share)


@dataclass(frozen=True, slots=True)
class _Scatter:
    """Readings relative to the mean of their branch: Student's t with three degrees of freedom."""

    rows: Rows
    worth: float
    sigma: float = 0.5 * _USUAL_RAD

    def expect(self, x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Log-likelihood, residuals, and weights of the equivalent least-squares problem."""
        r = _residual(self.rows, x)
        nu, ratio = _DEGREES_OF_FREEDOM, (r / self.sigma) ** 2
        weight = self.worth * self.rows.share
        value = weight * (np.log(self.sigma) + 0.5 * (nu + 1) * np.log1p(ratio / nu))
        return -float(value.sum()), r, weight * (nu + 1) / (nu + ratio)

    def refit(self, r: FloatArray, weight: FloatArray) -> _Scatter:
        """Maximum-a-posteriori scale, with a prior worth two readings of half of `_USUAL_RAD`."""
        total = self.worth * float(self.rows.share.sum())
        sigma = np.sqrt((float((weight * r**2).sum()) + 2 * (0.5 * _USUAL_RAD) ** 2) / (total + 2))
        return _Scatter(self.rows, self.worth, float(max(sigma, 0.005)))


@dataclass(frozen=True, slots=True, eq=False)
class HeadingLikelihood:
    """ℓ(x) of one run, with a normal prior on x with the sigmas `prior_sigma` (3,) about `centre`
    (3,)."""

    parts: tuple[_Scatter | _Grid, ...]
    prior_sigma: FloatArray
    centre: FloatArray

    @classmethod
    def of(
        cls, evidence: HeadingEvidence, *, prior_sigma: FloatArray, centre: FloatArray, worth: float
    ) -> HeadingLikelihood:
        """The likelihood of corrections x, in addition to those already applied to the evidence."""
        parts = _Scatter(evidence.passes, worth), _Grid(evidence.grid)
        return cls(parts, prior_sigma, centre)

    def value(self, x: FloatArray) -> float:
        """Log-likelihood plus log-prior, in nats, up to a constant."""
        deviation = (x - self.centre) / self.prior_sigma
        return sum(part.expect(x)[0] for part in self.parts) - 0.5 * float(deviation @ deviation)

    def scores(self, x: FloatArray) -> FloatArray:
        """(visits, 3) contribution of each visit of a junction to the gradient of ℓ at x."""
        count = max(part.rows.visits for part in self.parts)
        out = np.zeros((count, TERMS))
        for part in self.parts:
            _, r, weight = part.expect(x)
            pull = part.rows.a * (-r * weight / part.sigma**2)[:, None]
            for k in range(TERMS):
                out[:, k] += np.bincount(part.rows.visit, pull[:, k], count)
        return out

    def slope(self, x: FloatArray) -> FloatArray:
        """(3,) gradient of ℓ at x, including the prior."""
        belief = (x - self.centre) / np.square(self.prior_sigma)
        return np.asarray(self.scores(x).sum(axis=0) - belief)

    def improve(self, x: FloatArray, free: BoolArray) -> tuple[HeadingLikelihood, FloatArray]:
        """One step of expectation maximisation: the likelihood with new scales and shares, and x
        (3,) with its `free` components moved."""
        precision = 1.0 / np.square(self.prior_sigma)
        gradient, curvature = -precision * (x - self.centre), np.diag(precision)
        expected = [part.expect(x)[1:] for part in self.parts]
        parts = tuple(part.refit(*each) for part, each in zip(self.parts, expected, strict=True))
        for part, (r, weight) in zip(parts, expected, strict=True):
            a = part.rows.a * (weight / part.sigma**2)[:, None]
            gradient = gradient - (a * r[:, None]).sum(axis=0)
            curvature = curvature + np.einsum("rk,rl->kl", a, part.rows.a)
        move, index = np.zeros(TERMS), np.flatnonzero(free)
        if len(index):
            move[index] = np.linalg.solve(curvature[np.ix_(index, index)], gradient[index])
        return replace(self, parts=parts), x + move

    def climb(
        self, x: FloatArray, free: BoolArray, most: int = 60
    ) -> tuple[HeadingLikelihood, FloatArray]:
        """Expectation maximisation from x until it changes by less than 10⁻⁴ of the prior's
        sigmas."""
        here = self
        for _ in range(most):
            here, there = here.improve(x, free)
            settled = np.all(np.abs(there - x) <= 1e-4 * self.prior_sigma)
            x = there
            if settled:
                break
        return here, x

    def sigma(self, x: FloatArray) -> FloatArray:
        """(3,) 1 sigma of x: from the curvature of ℓ, or the robust one from the scores, the larger
        of both.

        The curvature is taken from differences of the gradient, because the least-squares problem
        of expectation maximisation treats every inlier as certain. Rows of one visit share errors
        (a skewed view, a slipping wheel) that the likelihood ignores: the scores are summed by
        visit in the sandwich estimate A⁻¹BA⁻¹. If the curvature is singular, the sigmas are those
        of the prior.
        """
        # Steps of a third of a sigma, if all inliers were certain.
        curvature = 1.0 / np.square(self.prior_sigma)
        for part in self.parts:
            _, _, weight = part.expect(x)
            curvature = curvature + np.einsum("r,rk->k", weight / part.sigma**2, part.rows.a**2)
        step, observed = 0.3 / np.sqrt(curvature), np.empty((TERMS, TERMS))
        for k in range(TERMS):
            move = np.zeros(TERMS)
            move[k] = step[k]
            observed[:, k] = (self.slope(x - move) - self.slope(x + move)) / (2 * step[k])
        observed = 0.5 * (observed + observed.T)
        if np.linalg.eigvalsh(observed)[0] <= 0:
            return self.prior_sigma
        inverse = np.linalg.inv(observed)
        scores = self.scores(x)
        belief = np.diag(1.0 / np.square(self.prior_sigma))
        count = len(scores)
        between = scores.T @ scores * count / max(count - TERMS, 1) + belief
        variance = np.maximum(np.diag(inverse), np.diag(inverse @ between @ inverse))
        return np.asarray(np.sqrt(variance))
