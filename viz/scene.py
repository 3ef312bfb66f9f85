"""What pictures of a merge show, on a page of `draw` and in a map of the report alike.

What is drawn later lies above.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np

from ..merge.change import Change, ChangeKind, numbered
from ..merge.drive import Drive
from ..merge.result import FusedMap
from ..topology.arrays import BoolArray, FloatArray
from ..topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from ..topology.se2 import apply
from ..topology.topomap import Graph
from ..topology.views import Views
from ..topology.wording import counted, listed
from .geometry import PENS, ROOM_MARKERS, TURNED, TURNED_MARKERS, branch_arrows, strands
from .pages import describe_corridor
from .palette import LARGE, MEDIUM, RING, THIN, Colour, Theme
from .parts import Part
from .sheet import Cell
from .surface import Look, Surface
from .walls import FINE_M, walls_of

MOST_RUNS = 8
"""Runs that a mark tells; of the others it gives the number."""

CHANGED = {
    ChangeKind.GONE: ("against", "gone, with its number in the list"),
    ChangeKind.NEW: ("agrees", "new, with its number in the list"),
    ChangeKind.DIFFERS: ("at times", "there at times, with its number in the list"),
}
"""Colours of changes, and what the key calls them."""


def draw_walls(
    surface: Surface,
    views: Sequence[Views],
    T: FloatArray,
    colour: str,
    *,
    alpha: float = 1.0,
    key: str = "wall",
) -> None:
    """Draw the walls that views show, moved by T, in cells that can be seen."""
    grid = walls_of([v.moved(T) for v in views], "", max(FINE_M, surface.pen_m / 2))
    if grid is not None:
        surface.cells(grid, Look(colour, key=key), alpha)


def view_layers(seen: Compared, theme: Theme) -> Iterator[tuple[BoolArray, Colour, int, int]]:
    """The walls of two views laid over each other, from the lowest layer to the highest, in which
    they contradict each other: which cells (k,), their colour, what they say, and of which of the
    two they are."""
    for kind in (SILENT, AGREES, CONTRADICTS):
        for run in (0, 1):
            ink = theme["against"] if kind == CONTRADICTS else theme.run(run)
            yield (seen.kind == kind) & (seen.of_second == run), ink, kind, run


def draw_unexplored(surface: Surface, m: Graph, T: FloatArray, free: BoolArray) -> None:
    """Draw the branches that were never driven, `free` (total branches,)."""
    arrows = branch_arrows(m, free, surface.pen_m)
    ends = [apply(T, np.stack([o, o + v])) for o, v in zip(*arrows, strict=True)]
    surface.lines(ends, Look(surface.theme["unexplored"], key="branch never driven"))


def draw_ends(surface: Surface, xy: FloatArray, kinds: Sequence[str], tips: Sequence[str]) -> None:
    """Draw where a robot turned round and where a log begins or ends, at xy (n, 2) [m]."""
    colour = surface.theme["degree 1"]
    for kind, marker in TURNED_MARKERS.items():
        rows = [k for k, own in enumerate(kinds) if own == kind]
        own_tips = [tips[k] for k in rows] if len(tips) else []
        surface.dots(xy[rows], Look(colour, MEDIUM, tips=own_tips, marker=marker, key=TURNED[kind]))


def draw_frame(surface: Surface, cell: Cell) -> None:
    """Draw the axes of a map's frame at its origin; where that lies outside of the cell, in the
    lower right corner, away from a scale bar."""
    T, length = cell.T_sheet_map, PENS * surface.pen_m
    key = "axes of the frame, at its origin"
    if not np.all((cell.low < T[:2]) & (T[:2] < cell.high)):
        corner = np.array([cell.high[0], cell.low[1]]) + 1.5 * length * np.array([-1, 1])
        T, key = np.array([*corner, T[2]]), "axes of the frame; its origin is out of sight"
    tips = length * np.eye(2)
    axes = [apply(T, np.stack([np.zeros(2), tip])) for tip in tips]
    surface.lines(axes, Look(surface.theme["ink"], THIN, key=key))
    surface.words(apply(T, 1.2 * tips), ["x", "y"])  # clear of the axes


def draw_component(
    surface: Surface,
    fused: FusedMap,
    part: Part,
    *,
    several: int,
    detailed: bool,
    numbers: Collection[int] | None,
    drives: Sequence[Drive],
    changes: Sequence[Change],
    undriven: BoolArray | None,
) -> None:
    """Draw a component's corridors as strands of its runs, its junctions and turning points.

    several: how many components of several runs are drawn; detailed: whether the frame is drawn,
    and tips say what strands and junctions are, not only whose; numbers: junctions to be numbered,
    all by default; undriven: branches to be drawn as never driven (total branches,).
    """
    T, theme = part.cell.T_sheet_map, surface.theme
    _bands(surface, fused, part, drives, changes)
    runs = sorted(part.component.poses)
    for (run, pens), own in strands(fused, part.edges, surface.pen_m).items():
        key = run if several == 1 else f"{part.component.name}: {run}"
        surface.lines(
            [apply(T, path) for path in own.values()],
            Look(
                theme["single"] if len(runs) == 1 else theme.run(runs.index(run)),
                pens,
                tips=[_describe_strand(fused, edge, run) for edge in own] if detailed else [run],
                key="run that is merged with none" if len(runs) == 1 else key,
            ),
        )
    if undriven is not None:
        inside = np.isin(fused.branches.owner, part.vertices)
        draw_unexplored(surface, fused, T, undriven & inside)
    kinds = [fused.kind[v] for v in part.vertices.tolist()]
    turned = np.array([kind in TURNED for kind in kinds], bool)
    ends = part.vertices[turned]
    tips = [
        f"Here {TURNED[fused.kind[v]]} ({listed(sorted(fused.members[v]), MOST_RUNS)})"
        for v in (ends.tolist() if detailed else [])
    ]
    draw_ends(surface, apply(T, fused.xy[ends]), [fused.kind[v] for v in ends.tolist()], tips)
    shared = np.array([len(fused.members[v]) > 1 for v in part.vertices.tolist()], bool)
    marker_of = [ROOM_MARKERS.get(kind, "circle") for kind in kinds]
    for what, marker in (("junction", "circle"), *ROOM_MARKERS.items()):
        own = ~turned & np.array([marker == mark for mark in marker_of], bool)
        for which, ink, pens, by in (
            (~shared, "single", MEDIUM, "one run"),
            (shared, "ink", LARGE, "several runs"),
        ):
            rows = part.vertices[which & own]
            tips = [_describe_junction(fused, v) for v in rows.tolist()] if detailed else []
            look = Look(theme[ink], pens, tips=tips, key=f"{what} seen by {by}", marker=marker)
            surface.dots(apply(T, fused.xy[rows]), look)
    _rings(surface, part, drives, changes)
    if detailed:
        draw_frame(surface, part.cell)
    named = [v for v in part.vertices[~turned].tolist() if numbers is None or v in numbers]
    surface.words(apply(T, fused.xy[named]), [*map(str, named)])


def _bands(
    surface: Surface,
    fused: FusedMap,
    part: Part,
    drives: Sequence[Drive],
    changes: Sequence[Change],
) -> None:
    """Draw drives and what changed as bands under the corridors."""
    T, theme = part.cell.T_sheet_map, surface.theme
    own = [(k, drive) for k, drive in enumerate(drives, 1) if drive.component == part.component.id]
    surface.lines(
        [apply(T, drive.path) for _, drive in own],
        Look(
            theme["planned"],
            RING,
            tips=[f"Drive {k}: {'; '.join(drive.words)}; {drive.way}" for k, drive in own],
            key="drive to record, from its number on",
        ),
    )
    for kind, (ink, key) in CHANGED.items():
        some = [
            (c, c.edge)
            for c in changes
            if c.component == part.component.id and c.kind is kind and c.edge is not None
        ]
        surface.lines(
            [apply(T, fused.paths[part.edges[edge]]) for _, edge in some],
            Look(
                theme.pale(theme[ink]),
                RING,
                tips=[describe_change(c, part.component.name) for c, _ in some],
                key=key,
            ),
        )


def _rings(
    surface: Surface, part: Part, drives: Sequence[Drive], changes: Sequence[Change]
) -> None:
    """Draw a ring where a drive begins and round a junction that changed, with their numbers, and
    the numbers that a drive's junctions in another site have there."""
    T, theme = part.cell.T_sheet_map, surface.theme
    begins: dict[tuple[float, float], list[str]] = {}
    others: dict[tuple[float, float], str] = {}
    for k, drive in enumerate(drives, 1):
        if drive.component == part.component.id:
            begins.setdefault(drive.stops[0].xy, []).append(str(k))
            beyond = [s for s in drive.stops if s.site != drive.site and s.junction is not None]
            others |= {stop.xy: str(stop.junction) for stop in beyond}
    at = apply(T, np.array([*begins]).reshape(-1, 2))
    surface.dots(at, Look(theme["unexplored"], RING, ring=True))
    surface.words(at, [f"drive {', '.join(own)}" for own in begins.values()], bold=True)
    for k, change in numbered(changes):
        if change.component == part.component.id:
            at = apply(T, np.array([change.xy]))
            if change.edge is None:
                ink, key = CHANGED[change.kind]
                tips = [describe_change(change, part.component.name)]
                surface.dots(at, Look(theme[ink], RING, ring=True, tips=tips, key=key))
            surface.words(at, [str(k)], bold=True)
    surface.words(apply(T, np.array([*others]).reshape(-1, 2)), [*others.values()])


def describe_change(change: Change, site: str) -> str:
    """What changed, when, for whom and how surely, as sentences on one line."""
    return " ".join(f"{words[0].upper()}{words[1:]}." for words in change.words(site))


def _describe_strand(fused: FusedMap, edge: int, run: str) -> str:
    """A run's line of a corridor: the corridor, and all runs that drove it, that one first."""
    what = describe_corridor(fused, edge)
    others = sorted({other for other, _ in fused.edge_members[edge]} - {run})
    return f"{what[0].upper()}{what[1:]} by {listed([run, *others], MOST_RUNS)}"


def _describe_junction(fused: FusedMap, v: int) -> str:
    """A fused junction in a line: branches, passes, runs, position."""
    sigma = fused.position_sigma
    sure = "" if sigma is None or np.isnan(sigma[v]) else f", ± {sigma[v]:.2f} m"
    x, y = fused.xy[v]
    kind = fused.kind[v].replace("_", " ")
    own = [f"{run} (its {', '.join(map(str, of))})" for run, of in sorted(fused.members[v].items())]
    return (
        f"Junction {v}{'' if kind == 'junction' else f' ({kind})'}: "
        f"{counted(len(fused.branches[v]), 'branch', 'branches')}, "
        f"{counted(len(fused.observations[v]), 'pass', 'passes')} by {listed(own, MOST_RUNS)}; at "
        f"({x:.2f}, {y:.2f}) m{sure}"
    )
