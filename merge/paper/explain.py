"""The results of the paper's method for two maps, in the form of its figures.

Fig. 1: tables of vertex pairs, one per number of branches, each cell with the hypotheses that the
pair belongs to under each correspondence, × if none survived. Fig. 2: the clusters of transform
space with their sizes and errors. As lines of text and as JSON values.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.digits import rounded
from ...topology.matching.correspondence import Nodes, candidate_nodes, node_codes, node_rotations
from ...topology.topomap import TopoMap
from ...topology.wording import counted
from ..document import pose_to_document
from ..result import shown_bits
from .method import DEFAULT_PAPER, Matching, PaperSettings, match, prepare_map

NONE = "×"  # noqa: RUF001 - the paper's sign


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """All results for two maps.

    found: the hypotheses and clusters (Fig. 2); candidates: the K compatible vertex pairs (Fig. 1),
    once per correspondence; turn_rad: (K,) rotation of b under it; hypothesis: (K,) number of the
    hypothesis, -1 if none survived; settings: of the matching.
    """

    a: TopoMap
    b: TopoMap
    found: Matching
    candidates: Nodes
    turn_rad: FloatArray
    hypothesis: IntArray
    settings: PaperSettings


def explain(a: TopoMap, b: TopoMap, settings: PaperSettings = DEFAULT_PAPER) -> Explanation:
    """Match two maps by the paper's method and keep all results."""
    pa, pb = prepare_map(a, settings), prepare_map(b, settings)
    found = match(pa, pb, settings)
    nodes = candidate_nodes(pa.structure, pb.structure, settings.growth)
    h = found.hypotheses
    turn = node_rotations(pa.structure, pb.structure, nodes, h.rectilinear)
    codes = [
        node_codes(pa.structure, pb.structure, n, h.rectilinear).tolist() for n in (h.nodes, nodes)
    ]
    of = dict(zip(codes[0], h.of.tolist(), strict=True))
    hypothesis = np.array([of.get(code, -1) for code in codes[1]], np.int64)
    return Explanation(a, b, found, nodes, turn, hypothesis, settings)


def lines(e: Explanation, most: int = 20) -> list[str]:
    """The explanation as text: the tables while they fit a screen, then the clusters.

    most: rows of a table, and clusters, at most.
    """
    return [*_table_lines(e, most), *_cluster_lines(e, most)]


def _table_lines(e: Explanation, most: int) -> Iterator[str]:
    """Counts, settings, and a table of vertex pairs for each number of branches (Fig. 1)."""
    one, two = e.candidates.vertex_a, e.candidates.vertex_b
    pairs = len(np.unique(one * len(e.b) + two))
    yield (
        f"{e.a.run} ({counted(len(e.a), 'junction')}) and "
        f"{e.b.run} ({counted(len(e.b), 'junction')}): {counted(pairs, 'compatible pair')}, "
        f"{len(e.candidates)} with their rotations; "
        f"{counted(len(e.found.hypotheses), 'hypothesis', 'hypotheses')} in "
        f"{counted(len(e.found.clusters), 'cluster')}"
    )
    yield _settings_line(e.settings)
    for degree in np.unique(e.a.degree[one]).tolist():
        rows, columns = (np.flatnonzero(m.degree == degree) for m in (e.a, e.b))
        branches = counted(degree, "branch", "branches")
        yield ""
        if len(rows) > most or len(columns) > most:
            yield f"{branches}: a table of {len(rows)} by {len(columns)}, left out"
            continue
        yield f"{branches}; rows {e.a.run}, columns {e.b.run}; H of each rotation, {NONE}: none"
        cells = [[_cell(e, int(u), int(v)) for v in columns] for u in rows]
        width = max((len(c) for row in cells for c in row), default=1)
        width = max(width, len(str(len(e.b))) + 1)
        yield " " * 6 + " ".join(f"{'b' + str(v):>{width}}" for v in columns)
        for u, row in zip(rows.tolist(), cells, strict=True):
            yield f"{'a' + str(u):>5} " + " ".join(f"{c:>{width}}" for c in row)


def _settings_line(settings: PaperSettings) -> str:
    """The settings, by the names of their options."""
    growth, clusters = settings.growth, settings.clusters
    met = f", {counted(len(settings.meetings), 'meeting')}" if settings.meetings else ""
    return (
        f"degree {growth.degree}, confidence {growth.confidence:g} of each {growth.confidence_of}, "
        f"weights {clusters.weights}, clusters {'iterative' if clusters.iterative else 'once'}{met}"
    )


def _cell(e: Explanation, u: int, v: int) -> str:
    """The hypotheses of a vertex pair, in the order of rotations: H3, × for none, · if
    incompatible."""
    k = np.flatnonzero((e.candidates.vertex_a == u) & (e.candidates.vertex_b == v))
    if len(k) == 0:
        return "·"
    order = k[np.argsort(np.round(e.turn_rad[k], 6), kind="stable")]
    alive = [f"H{h + 1}" for h in e.hypothesis[order].tolist() if h >= 0]
    return "/".join(alive) if alive else NONE


def _cluster_lines(e: Explanation, most: int) -> Iterator[str]:
    """A table of the clusters (Fig. 2)."""
    c, bits = e.found.clusters, e.found.bits
    if len(c) == 0:
        return
    yield ""
    yield "cluster      pairs  hypotheses  largest  rms m        x        y  turn°    bits"
    for k in range(min(len(c), most)):
        rms = np.sqrt(c.squared_error[k] / c.vertices[k])
        x, y, turn = c.transform[k].tolist()
        yield (
            f"{k + 1:>7}  {c.vertices[k]:>9}  {c.hypotheses[k]:>10}  {c.largest[k]:>7}  {rms:>5.2f}"
            f"  {x:>7.2f}  {y:>7.2f}  {np.rad2deg(turn):>5.1f}  {shown_bits(bits[k]):>6}"
        )
    if len(c) > most:
        yield f"… and {counted(len(c) - most, 'more cluster')}"


def to_document(e: Explanation) -> dict[str, Any]:
    """The explanation as JSON values."""
    h, c, bits = e.found.hypotheses, e.found.clusters, e.found.bits
    groups = [np.flatnonzero(h.of == k) for k in range(len(h))]
    return {
        "schema": "topobatch.explanation/1",
        "a": e.a.run,
        "b": e.b.run,
        "settings": asdict(e.settings),
        "candidates": [
            {"a": u, "b": v, "turn": t, "hypothesis": None if k < 0 else k}
            for u, v, t, k in zip(
                e.candidates.vertex_a.tolist(),
                e.candidates.vertex_b.tolist(),
                rounded(e.turn_rad),
                e.hypothesis.tolist(),
                strict=True,
            )
        ],
        "hypotheses": [
            {
                "id": k,
                "matched": np.column_stack([h.vertex_a[g], h.vertex_b[g]]).tolist(),
                "corridors": int(h.corridors[k]),
                "transform": pose_to_document(h.transform[k]),
                "mean_squared_error": rounded(h.error[k]),
                "cluster": None if c.of[k] < 0 else int(c.of[k]),
            }
            for k, g in enumerate(groups)
        ],
        "clusters": [
            {
                "id": k,
                "vertices": int(c.vertices[k]),
                "hypotheses": int(c.hypotheses[k]),
                "largest": int(c.largest[k]),
                "squared_error": rounded(c.squared_error[k]),
                "evidence_bits": rounded(bits[k], 2),
                "transform": pose_to_document(c.transform[k]),
            }
            for k in range(len(c))
        ],
        "threshold": rounded(c.threshold),
    }
