"""Common parts of commands that match maps: reading maps, and the cache of results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from ..topology.errors import DataError, DocumentError
from ..topology.wording import counted
from .output import Screen
from .workspace import Workspace

if TYPE_CHECKING:
    from ..merge.kept import Kept
    from ..merge.robust import Means
    from ..merge.workers import Workers
    from ..topology.topomap import TopoMap


def read_maps(
    place: Workspace, names: list[str], screen: Screen
) -> tuple[list[TopoMap], list[str]]:
    """The readable maps, and the names of the others."""
    maps, broken = [], []
    for name in names:
        try:
            maps.append(place.read_map(name))
        except DocumentError as error:
            screen.complain(f"{error}; left out")
            broken.append(name)
    if not maps:
        raise DataError(f"{place.maps}: none of the {counted(len(names), 'map')} can be read")
    return maps, broken


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

    with screen.progress("matching", pairs, "pairs") as advance:
        means = Means(
            workers=workers(pairs),
            maps=replace(place, root=place.root.resolve()),
            kept=kept,
            on_pair=lambda done, _: advance(done, doing="" if done < pairs else "joining"),
            tell=screen.detail,
        )
        try:
            yield means
        except KeyboardInterrupt:
            screen.stopped("not merged; what was matched is kept: run again to go on")
            raise
        finally:
            kept.flush()
