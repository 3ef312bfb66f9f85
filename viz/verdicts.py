"""A merge's verdicts on all pairs of runs as a matrix."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..merge.result import MergeResult, PairVerdict, Standing
from .parts import in_order

DIAGONAL = 0
CLASS = {standing: k for k, standing in enumerate(Standing, start=DIAGONAL + 1)}
"""Class of each standing in the verdict matrix."""


def runs_in_order(result: MergeResult) -> list[str]:
    """All runs by component, components of most runs first."""
    return [run for component in in_order(result) for run in sorted(component.poses)]


def spans_of(result: MergeResult) -> list[tuple[str, int, int]]:
    """The name of every site, its first row by `runs_in_order`, and the row after its last."""
    order = in_order(result)
    stops = np.cumsum([0, *(len(c.poses) for c in order)]).tolist()
    return [(c.name, *ends) for c, ends in zip(order, pairwise(stops), strict=True)]


def verdict_matrix(result: MergeResult, runs: Sequence[str]) -> NDArray[np.uint8]:
    """(n, n) classes of all pairs, symmetric, rows and columns in the given order."""
    row = {run: i for i, run in enumerate(runs)}
    matrix = np.full((len(runs), len(runs)), CLASS[Standing.UNRELATED], np.uint8)
    if result.unlisted is not None:
        for component in result.components:  # pairs that are not listed
            rows = [row[run] for run in component.poses if run in row]
            matrix[np.ix_(rows, rows)] = CLASS[Standing.JOINED]
    np.fill_diagonal(matrix, DIAGONAL)
    for pair in result.verdicts:
        if pair.a in row and pair.b in row:
            i, j = row[pair.a], row[pair.b]
            matrix[i, j] = matrix[j, i] = CLASS[pair.standing]
    return matrix


def strongest(pairs: Iterable[PairVerdict]) -> list[PairVerdict]:
    """Pairs in descending order of evidence, then by name."""
    return sorted(pairs, key=lambda p: (-p.evidence_bits, p.a, p.b))
