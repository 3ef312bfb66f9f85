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

from ..topology.errors import DataError, UsageError
from ..topology.wording import counted
from .output import Screen
from .process import start_worker
from .workspace import Workspace

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..merge.kept import Kept
    from ..merge.merging import MergeSettings
    from ..merge.robust import Means, RobustSettings
    from ..merge.workers import Workers
    from ..topology.topomap import TopoMap


WORTH_PROCESSES = 4000
"""Pairs of maps without views to match from which on processes are started, each of which reads the
maps."""


@dataclass(frozen=True, slots=True)
class MatchOptions:
    """Where pairs are matched."""

    jobs: Annotated[
        int,
        typer.Option(
            "--jobs", "-j", metavar="N", min=0, help="Processes to match with; 0: one per core."
        ),
    ] = 0
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Match on a Dask cluster, tcp://host:port, whose workers see the workspace under "
            "the same path; needs topobatch[cluster].",
        ),
    ] = None
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="With --all: only match the I-th of N shares of the pairs, for the cache; a last "
            "merge --all collects what all shares found.",
        ),
    ] = None

    def check(self) -> None:
        """UsageError if there can be no such cluster."""
        if self.cluster is not None:
            require_cluster(self.cluster)

    def workers(self, pairs: int) -> Workers | None:
        """What so many pairs are matched by: None for this process, else processes or a cluster."""
        from ..merge.workers import Workers

        if self.cluster is not None:
            return Workers(partial(cluster, self.cluster))
        count = min(self.jobs or os.cpu_count() or 1, pairs)
        # An explicit number of processes is used as it is.
        worth = 0 if self.jobs else WORTH_PROCESSES
        return Workers(partial(_executor, count), worth) if count > 1 else None


def read_maps(
    place: Workspace, names: list[str], screen: Screen
) -> tuple[list[TopoMap], list[str]]:
    """The readable maps, and the names of the others."""
    maps, errors = place.read_maps(names)
    for error in errors.values():
        screen.complain(f"{error}; left out")
    if not maps:
        raise DataError(f"{place.maps}: none of the {counted(len(names), 'map')} can be read")
    return list(maps.values()), list(errors)


def kept_results(
    place: Workspace,
    settings: RobustSettings,
    say: Callable[[str], None],
    held: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> Kept:
    """The results of earlier merges of a workspace, as by these settings; parameters as `Kept`."""
    from ..merge.kept import Kept
    from ..merge.robust import era_of

    return Kept(place.kept, era_of(settings), say, held)


@contextmanager
def matching(
    place: Workspace,
    pairs: int,
    kept: Kept,
    workers: Callable[[int], Workers | None],
    screen: Screen,
) -> Iterator[Means]:
    """The means to match `pairs` pairs, with progress on the screen; results are kept, also if
    the command is interrupted."""
    from ..merge.robust import Means

    kept_before: int | None = None
    all_done = False
    with screen.progress("matching", pairs, "pairs") as advance:

        def on_pair(done: int, total: int) -> None:
            nonlocal kept_before, all_done
            kept_before = done if kept_before is None else kept_before
            all_done = done == total
            advance(done, doing="joining" if all_done else "", kept=kept_before)

        def tell(text: str) -> None:
            screen.detail(text)
            step, *_ = text.partition(", of which")
            if all_done:
                advance(pairs, doing=f"joining: {step}")
            elif kept_before is None:
                advance(0, doing=step)

        means = Means(
            workers=workers(pairs),
            read=replace(place, root=place.root.resolve()).read_map,
            kept=kept,
            on_pair=on_pair,
            tell=tell,
        )
        try:
            yield means
        except KeyboardInterrupt:
            screen.stopped("not merged; what was matched is kept: run again to go on")
            raise
        finally:
            kept.flush()


@contextmanager
def _executor(workers: int) -> Iterator[Executor]:
    """A pool of processes, started as needed."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(workers, initializer=start_worker) as pool:
        try:
            yield pool
        except BaseException:  # Ctrl-C: nobody waits for the pairs that are left
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def share_of(text: str) -> tuple[int, int]:
    """(i, n) of "i/n", i from 1 to n."""
    found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UsageError(f'--shard is {text!r}; "2/8" is the second of eight shares')
    return int(found[1]), int(found[2])


def match_share(
    place: Workspace,
    settings: MergeSettings,
    share: tuple[int, int],
    workers: Callable[[int], Workers | None],
    screen: Screen,
) -> None:
    """Match a share of all pairs and keep the results in the cache. Other shares may run at the
    same time: the workspace is locked only to write."""
    from ..merge.result import pairs_of
    from ..merge.robust import match_shard

    held = partial(place.held, lambda _: None, make=False)
    kept = kept_results(place, settings.robust, screen.warn, held)
    maps, broken = read_maps(place, place.chosen_runs([], True), screen)
    pairs = pairs_of(len(maps)) // share[1]
    with matching(place, pairs, kept, workers, screen) as means:
        done = match_shard(maps, settings.robust, share, means)
    screen.line(
        f"share {share[0]} of {share[1]}: {counted(done, 'pair')} in {place.kept}; "
        f"when all shares are done: {place.call('merge', '--all')}"
    )
    if broken:
        raise typer.Exit(1)


CONNECT_S = 20
"""Timeout of the connection to a scheduler."""


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
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
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


def require_cluster(address: str) -> None:
    """Raise as `cluster` if none is there, also where nothing would need it."""
    with cluster(address):
        pass
