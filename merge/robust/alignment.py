"""One pair of maps: candidate alignments with their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...topology.se2 import apply, fit_rigid, wrap
from .conflicts import NO_CONFLICTS, Conflicts, conflicts
from .growth import Match, grow_all, ungrown
from .links import Links, Seed, candidate_links, seeds
from .prepare import ComplexArray, FloatArray, IntArray, Prepared
from .settings import MATCH, RobustSettings
from .support import Support, support


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way to lay b over a.

    transform: (3,) T_a_b; a, b: (k,) matched vertices; turn: (k,) local rotation b → a of each as
    unit numbers; support, conflicts: what speaks for it and what against; tested_bits: log2 of the
    hypotheses tested; bits: log2 odds against chance, the first less the other two.
    """

    transform: FloatArray
    a: IntArray
    b: IntArray
    turn: ComplexArray
    support: Support
    conflicts: Conflicts
    tested_bits: float
    bits: float
    rmse_m: float

    def __len__(self) -> int:
        return len(self.a)

    @property
    def corridors(self) -> IntArray:
        """(c, 2) directed rows of the corridors that agree."""
        return self.support.corridors

    @cached_property
    def contradicting_bits(self) -> float:
        """All that speaks against it, positive: contradictions, corridors whose lengths do not fit
        and matched junctions whose branches differ."""
        links, branches = self.support.links, self.support.branches
        misfit = float(links[links < 0].sum() + branches[branches < 0].sum())
        return self.conflicts.bits - misfit

    def move(self, z: complex) -> complex:
        """Where a point x + iy of b lands in a."""
        x, y, theta = self.transform.tolist()
        return complex(x + 1j * y + np.exp(1j * theta) * z)


def match(a: Prepared, b: Prepared, settings: RobustSettings) -> tuple[Candidate, ...]:
    """Candidate alignments of two maps, best first; versions of one placement appear once. Pure.

    The steps of the paper with its certainties replaced by odds: compatible corridors (§2.1),
    connected hypotheses (§2.3), transforms (§3.1), clusters grown again geometrically (§5).
    """
    links = candidate_links(a, b)
    found = seeds(a, b, links, settings.hypotheses)
    return best_of(a, b, found, tested=len(links), settings=settings)


def best_of(
    a: Prepared,
    b: Prepared,
    hypotheses: Sequence[Seed],
    *,
    tested: int,
    settings: RobustSettings,
) -> tuple[Candidate, ...]:
    """Grow and judge hypotheses; `tested` is the number of links they were chosen from."""
    tested_bits = float(np.log2(tested + 1.0))
    matches = grow_all(a, b, hypotheses, settings)
    found = [_judge(a, b, grown, tested_bits) for grown in matches if len(grown) > 1]
    found.sort(key=lambda c: (-c.bits, c.transform.tolist()))
    kept: list[Candidate] = []
    for candidate in found:
        if not any(same_placement(candidate, other, b) for other in kept):
            kept.append(candidate)
    return tuple(kept)


def best_seed(
    a: Prepared, b: Prepared, settings: RobustSettings
) -> tuple[Seed, Candidate, int] | None:
    """The strongest hypothesis of two maps as it is before growth: itself, what speaks for it and
    against it, and of how many it is the best; None where no two corridors are alike."""
    links = candidate_links(a, b)
    found = seeds(a, b, links, settings.hypotheses)
    if not found:
        return None
    tested_bits = float(np.log2(len(links) + 1.0))
    return found[0], _judge(a, b, ungrown(a, b, found[0]), tested_bits), len(found)


def _judge(a: Prepared, b: Prepared, grown: Match, tested_bits: float) -> Candidate:
    """The evidence of a grown match."""
    agree = support(a, b, grown)
    bits = agree.bits - tested_bits
    against = conflicts(a, b, grown) if bits > MATCH.chance_bits else NO_CONFLICTS
    transform, rmse_m = laid_over(_points(a.z[grown.a]), _points(b.z[grown.b]))
    return Candidate(
        transform=transform,
        a=grown.a,
        b=grown.b,
        turn=grown.turn[grown.b],
        support=agree,
        conflicts=against,
        tested_bits=tested_bits,
        bits=float(bits - against.bits),
        rmse_m=rmse_m,
    )


def laid_over(xy_a: FloatArray, xy_b: FloatArray) -> tuple[FloatArray, float]:
    """T_a_b that lays matched junctions over each other (§3.1), and their root mean square
    distance [m]. xy_a, xy_b: (k, 2)."""
    transform = fit_rigid(xy_a, xy_b)
    off = xy_a - apply(transform, xy_b)
    return transform, float(np.sqrt((off * off).sum() / len(off)))


def _points(z: ComplexArray) -> FloatArray:
    return z.view(np.float64).reshape(-1, 2)


def same_placement(x: Candidate, y: Candidate, b: Prepared) -> bool:
    """Are two candidates versions of one placement of b, seen from where each matches?"""
    if abs(float(wrap(x.transform[2] - y.transform[2]))) > MATCH.turn_rad:
        return False
    partner = np.full(len(b), -1)
    partner[x.b] = x.a
    mine = partner[y.b]
    both = np.count_nonzero(mine >= 0)
    if both:
        return bool(np.count_nonzero(mine == y.a) >= 0.5 * both)
    one, two = complex(b.z[x.b].mean()), complex(b.z[y.b].mean())
    slack = MATCH.place_m + MATCH.drift_per_m * abs(one - two)
    return abs(x.move(one) - y.move(one)) < slack and abs(x.move(two) - y.move(two)) < slack


def self_matches(m: Prepared, settings: RobustSettings) -> tuple[Candidate, ...]:
    """Alignments of a map with itself, elsewhere: how much the building repeats itself."""
    links = candidate_links(m, m)
    one, two = m.middle[links.a_row], m.middle[links.b_row]
    here = (np.abs(links.theta) < MATCH.turn_rad) & (np.abs(one - two) < MATCH.place_m)
    away = Links(links.a_row[~here], links.b_row[~here], links.theta[~here], links.bits[~here])
    away_seeds = seeds(m, m, away, settings.hypotheses)
    found = best_of(m, m, away_seeds, tested=len(away), settings=settings)
    return tuple(c for c in found if np.count_nonzero(c.a == c.b) < 0.5 * len(c))
