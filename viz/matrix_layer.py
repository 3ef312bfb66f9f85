"""The matrix of verdicts of a merge's recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from ..merge.result import MergeResult, Standing
from ..topology.arrays import FloatArray
from . import palette
from .parts import CLASS, DIAGONAL, spans_of, verdict_matrix
from .recording import HAIR, Recording
from .sheet import outline

MATRIX = "verdicts"
"""Its entity root."""

MOST_NAMES = 16
"""Above this many runs the matrix shows their names on hovering only."""

MOST_DOTS = 300
"""Above this many runs the matrix has no dots."""

FULL_DOT_BITS = 100.0
"""Evidence of the largest dot [bits]."""

_CLASSES = (
    (DIAGONAL, "same run", palette.DIAGONAL),
    (CLASS[Standing.UNRELATED], "unrelated", palette.UNRELATED),
    (CLASS[Standing.AMBIGUOUS], "ambiguous", palette.AMBIGUOUS),
    (CLASS[Standing.KEPT_OUT], "fits, but kept out by a later check", palette.KEPT_OUT),
    (CLASS[Standing.JOINED], "joined through other runs", palette.JOINED),
    (CLASS[Standing.MERGED], "merged", palette.MERGED),
)


def write_matrix(
    recording: Recording,
    result: MergeResult,
    runs: list[str],
    colours: Mapping[str, palette.Colour],
) -> None:
    """Write the verdicts of all pairs as an image and their evidence as dots, the runs of a site
    framed, and at the left a mark for each run with its name."""
    if not runs:
        return
    count = len(runs)
    recording.static((MATRIX,), rr.AnnotationContext(_CLASSES))
    matrix = verdict_matrix(result, runs)
    recording.static((MATRIX, "pairs"), rr.SegmentationImage(matrix, opacity=1.0))
    frames = [outline((k, k), (n, n)) for _, k, n in spans_of(result) if n - k > 1]
    lines = rr.LineStrips2D(frames, radii=HAIR, colors=palette.DIM, draw_order=palette.Order.RING)
    recording.static((MATRIX, "components"), lines)
    marks = rr.Points2D(
        np.stack([np.full(count, -0.5 * _names_width(runs)), np.arange(count) + 0.5], axis=-1),
        radii=0.012 * count,
        colors=[colours[run] for run in runs],
        labels=runs,
        show_labels=count <= MOST_NAMES,
        draw_order=palette.Order.CONTRADICTION,
    )
    recording.static((MATRIX, "runs"), marks, rr.AnyValues(run=runs))
    if count <= MOST_DOTS:
        _evidence(recording, result, runs)


def matrix_bounds(runs: list[str]) -> tuple[FloatArray, FloatArray]:
    """Low and high corner (2,) of the matrix with its names; a cell is one unit, y points down."""
    return np.array([-_names_width(runs), -0.2]), np.full(2, 1.01 * len(runs) + 0.2)


def _names_width(runs: list[str]) -> float:
    """Room for the names at the left [cells], from their share of a view of typical width."""
    longest = max(map(len, runs), default=0) if len(runs) <= MOST_NAMES else 0
    share = min(0.08 + 0.024 * longest, 0.6)
    return len(runs) * share / (1 - share)


def _evidence(recording: Recording, result: MergeResult, runs: list[str]) -> None:
    """Write the evidence as dots with the pair's attributes, below the diagonal."""
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
        draw_order=palette.Order.JUNCTION,
    )
    info = rr.AnyValues(
        pair=[f"{p.a} - {p.b}" for p in pairs],
        verdict=[str(p.standing) for p in pairs],
        accepted=[p.accepted for p in pairs],
        evidence_bits=bits,
        reason=[p.reason for p in pairs],
        advice=[p.advice or "" for p in pairs],
    )
    recording.static((MATRIX, "evidence"), dots, info)
