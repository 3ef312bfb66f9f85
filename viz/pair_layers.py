"""What a merge says of pairs of runs, as layers of a recording: matrix, placements, story."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ..merge.result import MergeResult, PairVerdict, shown_bits
from ..topology.se2 import apply, compose
from ..topology.topomap import TopoMap
from . import palette
from .drawing import pen_m
from .fused_layers import write_cards, write_own_map
from .parts import Part, pose_on_sheet
from .recording import JOIN, UP, PathParts, Recording, placed
from .sheet import ASPECT, Cell, arrange, sheet_margin_m, upright_rad
from .steps import Step
from .verdicts import (
    AMBIGUOUS,
    DIAGONAL,
    JOINED,
    MERGED,
    NOT_ACCEPTED,
    UNRELATED,
    joining_told,
    strongest,
    verdict_class,
    verdict_matrix,
)

MATRIX, UNDECIDED, STEPS, STORY = "verdicts", "undecided", "steps", "story"
"""Roots of the pictures of the pairs."""

MOST_PLACEMENTS = 24
"""Undecided pairs that are drawn, those of the strongest evidence."""

MOST_NAMES = 16
"""Above this many runs the matrix is drawn without their names."""

MOST_NUMBERS = 8
"""Above this many runs the evidence is not written into the matrix, only shown by dots."""

NAMES_ABOVE = 34
"""Names stand above the columns if all columns as wide as the longest take fewer letters."""

MOST_DOTS = 200
"""Above this many runs the matrix is drawn without dots."""

LABEL_RISE = 0.12
"""The viewer writes below a point: cells are labelled this much above their middle."""

FULL_DOT_BITS = 100.0
"""Evidence of this many bits gives the largest dot."""

_CLASSES = (
    (DIAGONAL, "same run", palette.DIAGONAL),
    (UNRELATED, "unrelated", palette.UNRELATED),
    (AMBIGUOUS, "ambiguous", palette.AMBIGUOUS),
    (NOT_ACCEPTED, "fits, but kept out by a later check", palette.NOT_ACCEPTED),
    (JOINED, "joined through other runs", palette.JOINED),
    (MERGED, "merged", palette.MERGED),
)


def write_matrix(recording: Recording, result: MergeResult, runs: list[str]) -> None:
    """The verdict of every pair as an image, its evidence as a dot, names on the diagonal."""
    if not runs:
        return
    recording.static((MATRIX,), rr.AnnotationContext(_CLASSES))
    matrix = verdict_matrix(result, runs)
    recording.static((MATRIX, "pairs"), rr.SegmentationImage(matrix, opacity=1.0))
    if len(runs) <= MOST_NAMES:
        _names(recording, runs)
    if len(runs) <= MOST_DOTS:
        _evidence(recording, result, runs)


def matrix_bounds(runs: list[str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high corner of the matrix and its names; a cell is one unit, y points down."""
    if len(runs) > MOST_NAMES:
        return np.array([-0.5, -0.5]), np.array([len(runs) + 0.5, len(runs) + 0.5])
    high = np.array([len(runs) + 0.2, len(runs) + 0.2])
    return np.array([-_names_width(runs), -0.09 * len(runs) - 0.1]), high


def _names_width(runs: list[str]) -> float:
    """Room for the names at the left, in cells: they take this share of a view of usual width."""
    share = min(0.06 + 0.024 * max(map(len, runs)), 0.6)
    return len(runs) * share / (1 - share)


def _names(recording: Recording, runs: list[str]) -> None:
    """Names at the left of the rows; above the columns names where they are short, else the
    numbers that stand before the names."""
    short = len(runs) * max(map(len, runs)) <= NAMES_ABOVE
    middle = np.arange(len(runs)) + 0.5
    left, above = np.full(len(runs), -_names_width(runs) / 2), np.full(len(runs), -0.09 * len(runs))
    rows = runs if short else [f"{i}  {run}" for i, run in enumerate(runs, start=1)]
    columns = runs if short else [str(i) for i in range(1, len(runs) + 1)]
    _labels(recording, "rows", np.stack([left, middle - LABEL_RISE], axis=-1), rows)
    _labels(recording, "columns", np.stack([middle, above], axis=-1), columns)


def _evidence(recording: Recording, result: MergeResult, runs: list[str]) -> None:
    """Numbers above the diagonal, dots with all that is known of a pair below it."""
    row = {run: i for i, run in enumerate(runs)}
    pairs = [p for p in result.verdicts if p.a in row and p.b in row]
    if not pairs:
        return
    ends = np.array([sorted((row[p.a], row[p.b])) for p in pairs])
    bits = np.array([p.evidence_bits for p in pairs])
    dots = rr.Points2D(
        ends + 0.5,
        radii=0.2 * np.sqrt(np.clip(bits / FULL_DOT_BITS, 0.01, 1.0)),
        colors=palette.BACKGROUND,
        draw_order=20.0,
    )
    info = rr.AnyValues(
        pair=[f"{p.a} - {p.b}" for p in pairs],
        verdict=[str(p.standing) for p in pairs],
        accepted=[p.accepted for p in pairs],
        evidence_bits=bits,
        reason=[p.reason for p in pairs],
    )
    recording.static((MATRIX, "evidence"), dots, info)
    if len(runs) <= MOST_NUMBERS:
        labels = [f"{b + 0.0:.1f}" for b in np.round(bits, 1).tolist()]
        _labels(recording, "bits", ends[:, ::-1] + [0.5, 0.5 - LABEL_RISE], labels)


def _labels(
    recording: Recording, name: str, places: NDArray[np.float64], labels: list[str]
) -> None:
    text = rr.Points2D(
        places,
        radii=0.0,
        colors=palette.TITLE,
        labels=labels,
        show_labels=True,
        draw_order=30.0,
    )
    recording.static((MATRIX, name), text)


def undecided(result: MergeResult) -> list[PairVerdict]:
    """Pairs whose placements are drawn: they fit somewhere and were not joined."""
    pairs = strongest(
        p
        for p in result.verdicts
        if verdict_class(p) in (AMBIGUOUS, NOT_ACCEPTED) and p.best is not None
    )
    return pairs[:MOST_PLACEMENTS]


def write_undecided(
    recording: Recording,
    pairs: list[PairVerdict],
    maps: Mapping[str, TopoMap],
    colours: Mapping[str, tuple[int, int, int]],
) -> list[Cell]:
    """Both placements of every given pair, side by side: map a stays, map b is laid over it.

    Returns the cells, two for each pair that has a runner-up.
    """
    laid = [
        (pair, name, alignment)
        for pair in pairs
        for name, alignment in (("best", pair.best), ("runner-up", pair.runner_up))
        if alignment is not None
    ]
    points = [np.concatenate([maps[p.a].xy, apply(a.transform, maps[p.b].xy)]) for p, _, a in laid]
    turns = [upright_rad(maps[p.a].paths) for p, _, _ in laid]
    together = [pairs.index(pair) for pair, _, _ in laid]
    cells = arrange(points, turns, sheet_margin_m(points), groups=together)
    recording.static((UNDECIDED,), UP)
    titles = [f"{p.a} - {p.b}, {name}: {shown_bits(a.evidence_bits)} bits" for p, name, a in laid]
    write_cards(recording, UNDECIDED, cells, titles)
    pen = pen_m([maps[run] for p in pairs for run in (p.a, p.b)])
    for (pair, name, alignment), cell in zip(laid, cells, strict=True):
        here = (UNDECIDED, "pairs", pair.a, pair.b, name)
        recording.static(here, placed(cell.T_sheet_map))
        write_own_map(recording, (*here, "a", pair.a), maps[pair.a], colours[pair.a], pen)
        recording.static((*here, "b"), placed(alignment.transform))
        write_own_map(recording, (*here, "b", pair.b), maps[pair.b], colours[pair.b], pen)
        matched = maps[pair.a].xy[alignment.matched[:, 0]]
        _matched(recording, (*here, "matched"), matched, pen)
    return cells


def _matched(recording: Recording, path: PathParts, xy: NDArray[np.float64], pen: float) -> None:
    if len(xy):
        rings = rr.Points2D(xy, radii=2.2 * pen, colors=palette.WHITE, draw_order=8.0)
        recording.static(path, rings)


def write_steps(
    recording: Recording,
    steps: list[Step],
    parts: list[Part],
    maps: Mapping[str, TopoMap],
    colours: Mapping[str, tuple[int, int, int]],
) -> list[Cell]:
    """Runs that come to their component one after the other, on the timeline JOIN.

    At step 0 every run that joins anything lies by itself, away from the components.
    Returns all cells.
    """
    parted = {run: part for part in parts for run in part.component.poses}
    moving = [run for step in steps for run in step.runs]
    waiting = _waiting_room(parts, [maps[run] for run in moving])
    recording.static((STEPS,), UP)
    titles = [part.short_title for part in parts] + moving
    cells = [part.cell for part in parts] + waiting
    write_cards(recording, STEPS, cells, titles)
    pen = pen_m(list(maps.values()))
    for run, part in parted.items():
        write_own_map(recording, (STEPS, "runs", run), maps[run], colours[run], pen)
        if run not in moving:
            recording.static((STEPS, "runs", run), placed(pose_on_sheet(part, run)))
    alone = {run: cell.T_sheet_map for run, cell in zip(moving, waiting, strict=True)}
    for number, step in enumerate(steps, start=1):
        for run in step.runs:
            _move(recording, run, number, alone[run], pose_on_sheet(parted[run], run))
    _story(recording, steps)
    return cells


def _waiting_room(parts: list[Part], maps: list[TopoMap]) -> list[Cell]:
    """A cell for each map by itself, beside the cells of the components or below them: where the
    whole can be drawn larger."""
    if not maps:
        return []
    points = [m.xy for m in maps]
    turns = [upright_rad(m.paths) for m in maps]
    low, high = _corners([part.cell for part in parts])
    choices = []
    for beside, share in product((True, False), (0.25, 0.4, 0.6, 0.9)):
        aspect = ASPECT * share if beside else ASPECT / share
        cells = arrange(points, turns, sheet_margin_m(points), aspect=aspect)
        its_low, its_high = _corners(cells)
        target = np.array([high[0], high[1]]) if beside else np.array([low[0], low[1]])
        shift = target - np.array([its_low[0], its_high[1]])
        width, height = np.maximum(high, its_high + shift) - np.minimum(low, its_low + shift)
        choices.append(
            (max(width / ASPECT, height), beside, share, [_moved(c, shift) for c in cells])
        )
    return min(choices, key=lambda choice: choice[:3])[3]


def _corners(cells: list[Cell]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high corner (2,) of all cells."""
    return np.min([c.low for c in cells], axis=0), np.max([c.high for c in cells], axis=0)


def _moved(cell: Cell, shift: NDArray[np.float64]) -> Cell:
    pose = compose(np.array([*shift, 0.0]), cell.T_sheet_map)
    return Cell(pose, cell.low + shift, cell.high + shift)


def _move(
    recording: Recording,
    run: str,
    number: int,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> None:
    poses = np.stack([before, after])
    columns = rr.Transform3D.columns(
        translation=np.column_stack([poses[:, :2], np.zeros(2)]),
        rotation_axis_angle=[
            rr.RotationAxisAngle([0, 0, 1], radians=float(t)) for t in poses[:, 2]
        ],
    )
    recording.over_steps((STEPS, "runs", run), JOIN, [0, number], columns)


def _story(recording: Recording, steps: list[Step]) -> None:
    pages = joining_told(steps)
    columns = rr.TextDocument.columns(text=pages, media_type=["text/markdown"] * len(pages))
    recording.over_steps((STORY,), JOIN, np.arange(len(pages)), columns)
