"""Matching maps: where pairs are matched, the maps, what is kept, and shares of the pairs.

The workers of a Dask cluster (`--cluster tcp://…`, of the extra `topobatch[cluster]`) need the same
topobatch, and the workspace under the same path.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from ..merge.kept import Kept
from ..merge.result import MergeResult, pairs_of
from ..topology.errors import DataError, UsageError
from ..topology.topomap import TopoMap
from ..topology.wording import counted
from .options import Extra
from .output import complain, detail, progress, say, tell, warn
from .process import processes
from .workspace import Workspace

if TYPE_CHECKING:  # what takes a second to load
    from concurrent.futures import Executor

    from ..merge.merging import MergeSettings
    from ..merge.robust import Means, RobustSettings
    from ..merge.workers import Workers

WORTH_PROCESSES = 4000
"""Pairs of maps without views to match from which on processes are started, each of which reads the
maps."""


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """Where pairs are matched."""

    jobs: Annotated[
        int, "--jobs -j N", "Processes to match with; 0: one per core.", Extra(min=0)
    ] = 0
    cluster: Annotated[
        str | None,
        "--cluster ADDRESS",
        "Match on a Dask cluster, tcp://host:port, whose workers see the workspace under the same "
        "path; needs topobatch[cluster].",
    ] = None
    shard: Annotated[
        str | None,
        "--shard I/N",
        "With --all: only match the I-th of N shares of the pairs, for the cache; a last merge "
        "--all collects what all shares found.",
    ] = None

    def workers(self, pairs: int) -> Workers | None:
        """What so many pairs are matched by: None for this process, else processes or a cluster."""
        from ..merge.workers import Workers

        if self.cluster is not None:
            return Workers(partial(cluster, self.cluster))
        count = min(self.jobs or os.cpu_count() or 1, pairs)
        # An explicit number of processes is used as it is.
        worth = 0 if self.jobs else WORTH_PROCESSES
        return Workers(partial(processes, count), worth) if count > 1 else None


def read_maps(place: Workspace, names: list[str]) -> tuple[list[TopoMap], list[str]]:
    """The readable maps, and the names of the others."""
    maps, errors = place.read_maps(names)
    for error in errors.values():
        complain(f"{error}; left out")
    if not maps:
        raise DataError(f"{place.maps}: none of the {counted(len(names), 'map')} can be read")
    return list(maps.values()), list(errors)


def settings_of(place: Workspace, result: MergeResult | None) -> MergeSettings:
    """The settings of a merge, by default the usual ones; those of the method that it is not by
    have its rate at most. DocumentError if they are invalid."""
    from ..merge.document import settings_from_document
    from ..merge.merging import MergeSettings
    from ..merge.paper.method import PaperSettings
    from ..merge.robust.settings import RobustSettings

    if result is None:
        return MergeSettings()
    values = result.info.get("settings") or {}
    rate = {name: value for name, value in values.items() if name == "false_merge_rate"}
    with place.document_at_fault("graph.settings: "):
        if result.info.get("method") == "paper":
            robust = settings_from_document(RobustSettings, rate)
            return MergeSettings("paper", robust, settings_from_document(PaperSettings, values))
        return MergeSettings(robust=settings_from_document(RobustSettings, values))


def kept_results(
    place: Workspace,
    settings: RobustSettings,
    held: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> Kept:
    """The results of earlier merges of a workspace, as by these settings; held: as of `Kept`."""
    from ..merge.robust import era_of

    return Kept(place.kept, era_of(settings), warn, held)


@contextmanager
def matching(place: Workspace, pairs: int, kept: Kept, where: MatchOptions) -> Iterator[Means]:
    """The means to match `pairs` pairs, with progress on the screen; results are kept, also if
    the command is interrupted."""
    from ..merge.robust import Means

    with progress("matching", pairs, "pairs") as advance:

        def on_pair(done: int, total: int) -> None:
            advance(done, doing="joining" if done == total else "")

        root = place.root.resolve()
        read = replace(place, root=root).read_map
        try:
            yield Means(where.workers(pairs), read, kept, on_pair, detail)
        finally:
            kept.flush()


@contextmanager
def resumable(again: str = "run again") -> Iterator[None]:
    """Say of a merge that is interrupted, by a signal as well, what is kept. again: what to do."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        tell(f"stopped; what was matched is kept: {again} to go on")
        raise


def match_share(place: Workspace, settings: RobustSettings, where: MatchOptions) -> None:
    """Match a share of all pairs and keep the results in the cache. Other shares may run at the
    same time: the workspace is locked only to write."""
    from ..merge.robust import match_shard

    found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", where.shard or "")
    number, of_all = map(int, found.groups()) if found is not None else (0, 0)
    if not 1 <= number <= of_all:
        raise UsageError(f'--shard is {where.shard!r}; "2/8" is the second of eight shares')
    kept = kept_results(place, settings, place.held)
    maps, broken = read_maps(place, place.chosen_runs([], True))
    with matching(place, pairs_of(len(maps)) // of_all, kept, where) as means:
        done = match_shard(maps, settings, (number, of_all), means)
    say(
        f"share {number} of {of_all}: {counted(done, 'pair')} in {place.kept}; "
        f"when all shares are done: {place.call('merge', '--all')}"
    )
    if broken:
        raise typer.Exit(1)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The executor of a running cluster. UsageError if Dask is not installed or the address is
    invalid, DataError if nobody answers or workers keep dying."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise UsageError(
            "--cluster needs Dask: python -m pip install 'topobatch[cluster]'"
        ) from error
    try:
        client = Client(address, set_as_default=False)
    except ValueError as error:
        raise UsageError(f"--cluster {address}: {error}") from error
    except OSError as error:
        raise DataError(f"--cluster {address}: no scheduler answers there") from error
    with client:
        try:
            # Tasks are identified by their order; hashing them is not needed.
            yield client.get_executor(pure=False)
        except KilledWorker as error:
            raise DataError(
                f"--cluster {address}: the workers that match die again and again (out of "
                "memory?); what they had done is kept: call again"
            ) from error
