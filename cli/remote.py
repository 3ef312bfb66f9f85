"""The cost of reading remote logs, reported before it begins."""

from __future__ import annotations

from collections.abc import Sequence

from ..ingest.read_cost import read_cost
from ..ingest.remote.path import RemotePath
from ..ingest.remote.threads import side_by_side
from ..topology.errors import TopobatchError
from ..topology.wording import counted
from .ingest_worker import IngestJob, is_unchanged, job_size
from .output import Screen

KEPT_BYTES = 1 << 28
"""Limit on index bytes kept; those of further logs are requested again."""


def announce(jobs: Sequence[IngestJob], screen: Screen) -> None:
    """Read the indexes of all remote logs to be ingested, and print the bytes to fetch."""
    remote = [job for job in jobs if isinstance(job.log, RemotePath)]
    if not remote:
        return
    logs = fetched = whole = kept = 0
    with screen.progress("indexes", len(remote), "logs") as at:
        costs = side_by_side(_cost, remote)
        for done, (job, cost) in enumerate(zip(remote, costs, strict=True)):
            at(done + 1)
            if cost is None:
                continue
            assert isinstance(job.log, RemotePath)
            logs, fetched, whole = logs + 1, fetched + cost, whole + job_size(job)
            kept += job.log.kept_bytes
            if kept > KEPT_BYTES:
                job.log.forget()
    screen.line(
        f"to read: {fetched / 1e6:,.1f} of {whole / 1e6:,.1f} MB in {counted(logs, 'remote log')}"
    )


def _cost(job: IngestJob) -> int | None:
    """Bytes to fetch; None for a log that is finished or cannot be read."""
    assert isinstance(job.log, RemotePath)
    try:
        return None if is_unchanged(job) else read_cost(job.log, job.read)
    except (TopobatchError, OSError):
        return None  # reading it will say why
