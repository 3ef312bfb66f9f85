"""Serialisation of the result of matching two maps.

Numbers are restored to the last bit. What is read is validated against the two maps, so that no
bytes can give a candidate with indices out of range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.ragged import parted
from ..packs import LARGEST
from .alignment import Candidate
from .conflicts import Conflicts
from .prepare import Extent
from .settings import MATCH, RobustSettings
from .support import Support
from .verdict import Faint, beyond_chance_bits, faint_of
from .view_evidence import ViewEvidence

SCALARS = len(("x", "y", "theta", "tested", "bits", "rmse", "support", "elsewhere", "rival"))
SCALARS += len(("by_views", "middle", "spread", "copies", "repeated"))
"""Scalars of a candidate: its transform, log2 of the hypotheses, bits, error, bits of its support
and of a corridor that leads elsewhere, whether it is a rival; whether views proposed it, the level
of copies, and what views say of them."""

SIZES = len(("matches", "corridors", "links", "extra_b", "extra_a", "elsewhere", "views", "cells"))
"""Arrays of different lengths."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Candidate alignments of two maps, best first; if none is better than chance, a summary of the
    best."""

    candidates: tuple[Candidate, ...] = ()
    faint: Faint | None = None

    def against_chance(self, settings: RobustSettings) -> float:
        """Largest evidence against chance of any alignment with enough junctions to be merged
        [bits]."""
        if self.faint is not None:
            return self.faint.against_chance
        return beyond_chance_bits(self.candidates, settings)


def in_short(candidates: tuple[Candidate, ...], settings: RobustSettings) -> Found:
    """What is kept of the candidates of a pair: those beyond chance, or a summary."""
    odd = tuple(c for c in candidates if c.bits > MATCH.lead_bits)
    return Found(odd) if odd else Found(faint=faint_of(candidates, settings))


def to_bytes(candidates: tuple[Candidate, ...]) -> bytes:
    """Serialised candidates of a pair."""
    return b"".join(_candidate_bytes(c) for c in candidates)


def _candidate_bytes(c: Candidate) -> bytes:
    s, x, v = c.support, c.conflicts, c.views
    sizes = (len(c), len(s.corridors), len(s.links), len(x.extra_b), len(x.extra_a))
    head = np.array([*sizes, len(x.elsewhere), len(v), len(v.bits)], "<u4")
    floats = np.concatenate(
        [
            c.transform,
            [c.tested_bits, c.bits, c.rmse_m, s.bits, x.elsewhere_bits, c.rival, c.by_views],
            v.null,
            [v.copies, v.repeated],
            np.ascontiguousarray(c.turn).view(np.float64),
            s.links,
            s.branches,
            x.extra_b_bits,
            x.extra_a_bits,
            v.z,
            v.bits,
        ]
    ).astype("<f8")
    whole = [
        *(c.a, c.b, s.corridors.T.ravel(), s.ends.ravel(), s.along + 1),
        *(x.extra_b, x.extra_b_in, x.extra_a, x.extra_a_in, x.elsewhere.T.ravel()),
        *(v.first, v.second, v.cell),
    ]
    return head.tobytes() + floats.tobytes() + np.concatenate(whole).astype("<i4").tobytes()


def from_bytes(data: bytes, a: Extent, b: Extent) -> tuple[Candidate, ...] | None:
    """The candidates of two maps; None if the bytes cannot be theirs."""
    out, at = [], 0
    while at < len(data):
        found = _candidate(data, at, a, b)
        if found is None:
            return None
        candidate, at = found
        out.append(candidate)
    return tuple(out)


def _candidate(data: bytes, at: int, a: Extent, b: Extent) -> tuple[Candidate, int] | None:
    """The candidate that begins at byte `at`, and the byte after it; None if it is invalid.

    a, b: the numbers of vertices and of directed edges of both maps. The record starts with six
    counts: k matched junctions, c corridors that agree, m links, eb and ea junctions of b and of a
    inside corridors of the other map, el pairs of corridors that lead elsewhere. Real numbers
    follow, then indices; both are checked before use.
    """
    if len(data) - at < 4 * SIZES:
        return None
    k, c, m, eb, ea, el, nv, nc = np.frombuffer(data, "<u4", SIZES, at).tolist()
    reals = SCALARS + 3 * k + m + eb + ea + nv + nc
    wholes = 2 * k + 2 * c + 3 * m + 2 * eb + 2 * ea + 2 * el + 3 * nv
    at += 4 * SIZES
    end = at + 8 * reals + 4 * wholes
    if end > len(data) or k < 1:
        return None
    f = np.frombuffer(data, "<f8", reals, at).copy()  # aligned, like those of a match
    i = np.frombuffer(data, "<i4", wholes, at + 8 * reals).astype(np.int64)
    if not (np.abs(f) <= LARGEST).all():
        return None
    (n_a, rows_a, views_a), (n_b, rows_b, views_b) = a, b
    sizes = (k, k, c, c, 2 * m, m, eb, eb, ea, ea, el, el, nv, nv, nv)
    limits = (
        *(n_a, n_b, rows_a, rows_b, k, c + 1, n_b, rows_a, n_a, rows_b, rows_a, rows_b),
        *(views_a, views_b, nc),
    )
    if wholes and not ((i >= 0) & (i < np.repeat(limits, sizes))).all():
        return None
    turn, links, branches, b_bits, a_bits, z, told = parted(
        f[SCALARS:], (2 * k, m, k, eb, ea, nv, nc)
    )
    va, vb, *rows, ends, along, extra_b, b_in, extra_a, a_in, far_a, far_b, first, second, cell = (
        parted(i, sizes)
    )
    corridors, elsewhere = (np.array(columns).T.copy() for columns in (rows, (far_a, far_b)))
    candidate = Candidate(
        transform=f[:3],
        a=va,
        b=vb,
        turn=turn.view(np.complex128),
        support=Support(corridors, ends.reshape(-1, 2), along - 1, links, branches, float(f[6])),
        conflicts=Conflicts(extra_b, b_in, b_bits, extra_a, a_in, a_bits, elsewhere, float(f[7])),
        tested_bits=float(f[3]),
        bits=float(f[4]),
        rmse_m=float(f[5]),
        rival=bool(f[8]),
        by_views=bool(f[9]),
        views=ViewEvidence(first, second, z, cell, told, float(f[12]), float(f[13]), f[10:12]),
    )
    return candidate, end
