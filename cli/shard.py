"""`topobatch merge --shard I/N`: match a share of the pairs and keep the results in the cache."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import typer

from ..topology.errors import UsageError
from ..topology.wording import counted
from .matching import matching, read_maps
from .output import Screen
from .workspace import Workspace

if TYPE_CHECKING:
    from ..merge.merging import MergeSettings
    from ..merge.workers import Workers


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
    from ..merge.kept import Kept
    from ..merge.result import pairs_of
    from ..merge.robust import era_of, match_shard

    held = partial(place.held, lambda _: None, make=False)
    kept = Kept(place.kept, era_of(settings.robust), screen.warn, held)
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
