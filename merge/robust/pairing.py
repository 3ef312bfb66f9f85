"""All pairs of a batch: matched here, or in blocks on an executor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed

from .alignment import Candidate, match
from .prepare import Prepared
from .settings import RobustSettings

Pair = tuple[int, int]
Candidates = dict[Pair, tuple[Candidate, ...]]

BLOCK = 12
"""Maps per side of a block: a block travels once and yields up to BLOCK² pairs."""


def match_all(
    prepared: Sequence[Prepared],
    settings: RobustSettings,
    on_pair: Callable[[int, int], None] | None,
    executor: Executor | None,
) -> Candidates:
    """Candidate alignments of every pair i < j."""
    n = len(prepared)
    total, done = n * (n - 1) // 2, 0
    found: Candidates = {}

    def keep(part: Candidates) -> None:
        nonlocal done
        for pair, candidates in part.items():
            found[pair] = candidates
            done += 1
            if on_pair is not None:
                on_pair(done, total)

    if executor is None:
        for i in range(n):
            for j in range(i + 1, n):
                keep({(i, j): match(prepared[i], prepared[j], settings)})
        return found
    starts = range(0, n, BLOCK)
    jobs = []
    for p in starts:
        for q in starts[p // BLOCK :]:
            rows = {i: prepared[i] for i in range(p, min(p + BLOCK, n))}
            columns = {j: prepared[j] for j in range(q, min(q + BLOCK, n))}
            jobs.append(executor.submit(_match_block, rows, columns, settings))
    for job in as_completed(jobs):
        keep(job.result())
    return found


def _match_block(
    rows: dict[int, Prepared],
    columns: dict[int, Prepared],
    settings: RobustSettings,
) -> Candidates:
    return {
        (i, j): match(a, b, settings) for i, a in rows.items() for j, b in columns.items() if i < j
    }
