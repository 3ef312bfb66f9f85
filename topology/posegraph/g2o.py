"""Pose graphs in g2o's text format: VERTEX_SE2, EDGE_SE2 and FIX lines.

    VERTEX_SE2 id x y theta
    EDGE_SE2 id_from id_to dx dy dtheta I11 I12 I13 I22 I23 I33

(Kümmerle, Grisetti, Strasdat, Konolige, Burgard: g2o, ICRA 2011; its wiki, "File format".)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DocumentError
from ..se2 import wrap
from .graph import PoseGraph
from .initialisation import chained_start

_FIELDS = {"VERTEX_SE2": 5, "EDGE_SE2": 12}
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, slots=True, eq=False)
class G2oGraph:
    """A pose graph and the ids its poses have in the file, (n,), ascending."""

    graph: PoseGraph
    ids: NDArray[np.int64]


def read_g2o(path: Path | str) -> G2oGraph:
    """Read a 2-D pose graph. FIX lines become held poses; empty lines and `#` comments are skipped.

    A file without vertices gets them from its edges, its poses by chaining the edges. Raises
    DocumentError, with file and line, on an unknown tag, a wrong number of fields, what is no
    finite number, a vertex named twice or missing, information that is not positive semidefinite;
    and on a file that holds no graph or cannot be read.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DocumentError(f"{path}: cannot be read as a g2o file ({error})") from error
    rows: dict[str, list[list[str]]] = {tag: [] for tag in _FIELDS}
    lines: dict[str, list[int]] = {tag: [] for tag in _FIELDS}
    fixed: list[int] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        tag = words[0]
        if tag == "FIX":
            fixed += [_identifier(path, number, word) for word in words[1:]]
            continue
        if tag not in _FIELDS:
            raise DocumentError(
                f"{path}:{number}: unknown line '{tag}'; a 2-D pose graph holds VERTEX_SE2, "
                "EDGE_SE2 and FIX"
            )
        if len(words) != _FIELDS[tag]:
            raise DocumentError(
                f"{path}:{number}: {tag} needs {_FIELDS[tag] - 1} numbers, found {len(words) - 1}"
            )
        rows[tag].append(words[1:])
        lines[tag].append(number)
    vertices = _numbers(path, rows["VERTEX_SE2"], lines["VERTEX_SE2"], 4, 1)
    edges = _numbers(path, rows["EDGE_SE2"], lines["EDGE_SE2"], 11, 2)
    return _assemble(path, vertices, edges, fixed)


def write_g2o(path: Path | str, graph: PoseGraph, ids: NDArray[np.int64] | None = None) -> None:
    """Write poses, edges and wholly held poses (FIX); what `read_g2o` reads back unchanged.

    Takes and raises what `g2o_text` does; OSError if the file cannot be written.
    """
    Path(path).write_text(g2o_text(graph, ids), encoding="utf-8")


def g2o_text(graph: PoseGraph, ids: NDArray[np.int64] | None = None) -> str:
    """A pose graph as the text of a file: poses, edges and wholly held poses (FIX).

    ids: (n,) names of the poses, 0, 1, … where left out. There are no comments: GTSAM (4.3) reads
    no edges from a file with any. Raises ValueError on a graph that the format cannot hold:
    kernels, priors, shared errors, poses held in part.
    """
    names = np.arange(len(graph)) if ids is None else np.asarray(ids, np.int64)
    partly = graph.held.any(axis=1) & ~graph.held.all(axis=1)
    if len(graph.priors) or len(graph.shared) or partly.any() or np.isfinite(graph.kernel).any():
        raise ValueError("g2o holds poses, edges and fixed poses only")
    lines = [
        f"VERTEX_SE2 {name} {_joined(pose)}"
        for name, pose in zip(names.tolist(), graph.pose.tolist(), strict=True)
    ]
    lines += [f"FIX {name}" for name in names[graph.held.all(axis=1)].tolist()]
    upper = graph.information[:, _UPPER[0], _UPPER[1]].tolist()
    ends = zip(names[graph.source].tolist(), names[graph.target].tolist(), strict=True)
    lines += [
        f"EDGE_SE2 {i} {j} {_joined(measured)} {_joined(row)}"
        for (i, j), measured, row in zip(ends, graph.measurement.tolist(), upper, strict=True)
    ]
    return "".join(f"{line}\n" for line in lines)


def _joined(values: list[float]) -> str:
    """Numbers in the shortest form that reads back to the same bits."""
    return " ".join(repr(value) for value in values)


def _identifier(path: Path, line: int, word: str) -> int:
    try:
        value = int(word)
    except ValueError as error:
        raise DocumentError(f"{path}:{line}: '{word}' is no vertex id (an integer)") from error
    if not 0 <= value < 2**62:
        raise DocumentError(f"{path}:{line}: vertex id {value} is out of range")
    return value


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Rows of one kind of line: `ids` (k, number of ids), `values` (k, rest)."""

    ids: NDArray[np.int64]
    values: NDArray[np.float64]
    lines: list[int]


def _numbers(path: Path, rows: list[list[str]], lines: list[int], width: int, ids: int) -> _Table:
    """Parse all rows in one conversion; only a failure looks at single lines."""
    if not rows:
        return _Table(np.zeros((0, ids), np.int64), np.zeros((0, width - ids)), lines)
    try:
        values = np.array([row[ids:] for row in rows], dtype=np.float64)
    except ValueError:
        values = np.full((len(rows), width - ids), np.nan)
        for k, row in enumerate(rows):
            for column, word in enumerate(row[ids:]):
                try:
                    values[k, column] = float(word)
                except ValueError:
                    raise DocumentError(f"{path}:{lines[k]}: '{word}' is no number") from None
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise DocumentError(f"{path}:{lines[bad[0]]}: a number is not finite")
    names = [
        [_identifier(path, line, word) for word in row[:ids]]
        for row, line in zip(rows, lines, strict=True)
    ]
    return _Table(np.array(names, np.int64), values, lines)


def _assemble(path: Path, vertices: _Table, edges: _Table, fixed: list[int]) -> G2oGraph:
    if not len(vertices.ids) and not len(edges.ids):
        raise DocumentError(f"{path}: holds no VERTEX_SE2 and no EDGE_SE2 line")
    named = vertices.ids[:, 0]
    ids, first, counts = np.unique(named, return_index=True, return_counts=True)
    if np.any(counts > 1):
        twice = ids[np.argmax(counts > 1)]
        line = vertices.lines[np.flatnonzero(named == twice)[1]]
        raise DocumentError(f"{path}:{line}: vertex {twice} is given twice")
    if len(named):
        pose = vertices.values[first]
    else:
        ids = np.unique(edges.ids)
        pose = np.zeros((len(ids), 3))
    _check_edges(path, ids, edges)
    held = np.zeros((len(ids), 3), bool)
    for name in fixed:
        if name not in ids:
            raise DocumentError(f"{path}: FIX names vertex {name}, which is not there")
        held[np.searchsorted(ids, name)] = True
    ends = np.searchsorted(ids, edges.ids)
    upper = edges.values[:, 3:]
    information = np.zeros((len(upper), 3, 3))
    information[:, _UPPER[0], _UPPER[1]] = upper
    information[:, _UPPER[1], _UPPER[0]] = upper
    graph = PoseGraph(
        np.column_stack([pose[:, :2], wrap(pose[:, 2])]),
        ends[:, 0],
        ends[:, 1],
        edges.values[:, :3],
        information,
        held=held,
    )
    if not len(named):
        graph = replace(graph, pose=chained_start(graph))
    return G2oGraph(graph, ids)


def _check_edges(path: Path, ids: NDArray[np.int64], edges: _Table) -> None:
    """Raise DocumentError on the first edge that cannot be used."""
    known = np.isin(edges.ids, ids)
    for bad, what in (
        (~known.all(axis=1), "an end of the edge is no vertex of the file"),
        (edges.ids[:, 0] == edges.ids[:, 1], "the edge joins a vertex to itself"),
        (~_positive(edges.values[:, 3:]), "the information is not positive semidefinite"),
    ):
        if bad.any():
            line = edges.lines[int(np.argmax(bad))]
            raise DocumentError(f"{path}:{line}: {what}")


def _positive(upper: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(k,) whether the matrices with these upper triangles have no negative eigenvalue."""
    full = np.zeros((len(upper), 3, 3))
    full[:, _UPPER[0], _UPPER[1]] = upper
    full[:, _UPPER[1], _UPPER[0]] = upper
    values = np.linalg.eigvalsh(full) if len(full) else np.zeros((0, 3))
    smallest, largest = values[:, 0], np.abs(values).max(axis=1, initial=0.0)
    return np.asarray(smallest >= -1e-6 * largest)
