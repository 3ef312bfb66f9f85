"""Binary copies of maps, restored to the last bit without parsing their documents.

A map is kept by the digest of its document. What is read is validated like every map.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import from_json

from ..topology.arrays import IntArray
from ..topology.document import map_from_document
from ..topology.files import document_bytes, encoded, parsed
from ..topology.ragged import Ragged, parted
from ..topology.topomap import Closure, RunNoise, TopoMap
from ..topology.turning_points import ROWS, TurningPoints
from ..topology.view_file import with_views
from .digests import digested
from .packs import Kind, PackWriter, Store, arrays_from_bytes, arrays_to_bytes

FLAT = (
    *("source", "target", "source_branch", "target_branch", "traversals"),
    *("observation_vertex", "observation_time_ns", "length", "length_sigma", "confidence"),
)
WORDS = ("run", "frame", "kind", "shows_bends", "info")
SIZE = 8
"""Bytes of the size of the JSON part, in front of it."""

ARRAYS = "iiiiiiiffffififiiffff"
"""Types of the arrays: those named in `FLAT`; positions; branches, points of paths and times of
traversals, each as row lengths and concatenated rows; noise, fitted noise, sigmas of positions and
branches. Unknown ones are empty, and named in the JSON part."""

TURNED = tuple(TurningPoints.__dataclass_fields__)
"""Fields of turning points; a map has few, so they are kept as JSON."""

NOT_ALWAYS = ("fitted_noise", "position_sigma", "branch_sigma", "traversal_ns")


@dataclass(slots=True, eq=False)
class KeptMaps:
    """Maps of documents, some of which were read before."""

    store: Store
    _new: PackWriter = field(init=False)

    def __post_init__(self) -> None:
        self._new = PackWriter(self.store.era)

    def read(self, path: Path) -> TopoMap:
        """The map of a document, as by `read_map`. Its views are read from the file beside it."""
        data = document_bytes(path)
        digest = digested(data)
        kept = self.store.find(Kind.MAP, (digest, digest))
        found = None if kept is None else from_bytes(kept)
        if found is None:
            found = map_from_document(parsed(data, path), str(path))
            self._new.add((digest, digest), Kind.MAP, payload=to_bytes(found))
        return with_views(found, path)

    def keep(self) -> None:
        """Keep what was read for later merges."""
        if len(self._new):
            self.store.keep(self._new.pack())


def to_bytes(topomap: TopoMap) -> bytes:
    """A serialised map."""
    words: dict[str, Any] = {name: getattr(topomap, name) for name in WORDS}
    words["closures"] = [astuple(closure) for closure in topomap.closures]
    words["turning_points"] = {
        name: [one if isinstance(one, str) else one.tolist() for one in value]
        for name, value in ((name, getattr(topomap.turning_points, name)) for name in TURNED)
    }
    words["unknown"] = [name for name in NOT_ALWAYS if getattr(topomap, name) is None]
    text = encoded(words)
    nothing, turn, fitted = np.zeros(0), topomap.branch_sigma, topomap.fitted_noise
    arrays = [
        *(getattr(topomap, name) for name in FLAT),
        topomap.xy,
        topomap.branches.counts,
        topomap.branches.values,
        *_end_to_end(topomap.paths, np.float64),
        *_end_to_end(topomap.traversal_ns or (), np.int64),
        np.array(astuple(topomap.noise)),
        nothing if fitted is None else np.array(astuple(fitted)),
        nothing if topomap.position_sigma is None else topomap.position_sigma,
        nothing if turn is None else turn.values,
    ]
    return len(text).to_bytes(SIZE, "little") + text + arrays_to_bytes(arrays)


def from_bytes(data: bytes) -> TopoMap | None:
    """Inverse of `to_bytes`; None if the bytes are invalid."""
    stop = SIZE + int.from_bytes(data[:SIZE], "little")
    try:
        words = from_json(data[SIZE:stop], allow_inf_nan=False)
        arrays = arrays_from_bytes(data[stop:], ARRAYS)
        return None if arrays is None else _map(words, arrays)
    except (ValueError, TypeError, KeyError, OverflowError):
        return None


def _map(words: Any, arrays: list[NDArray[Any]]) -> TopoMap:
    flat: dict[str, Any] = dict(zip(FLAT, arrays, strict=False))
    xy, degree, branches, steps, points, visits, times, noise, *sure = arrays[len(FLAT) :]
    fitted, sigma, turn = sure
    unknown, stops = words["unknown"], np.cumsum([0, *degree])
    return TopoMap(
        run=str(words["run"]),
        frame=str(words["frame"]),
        kind=tuple(map(str, words["kind"])),
        shows_bends=bool(words["shows_bends"]),
        info=dict(words["info"]),
        closures=tuple(Closure(*closure) for closure in words["closures"]),
        xy=xy.reshape(-1, 2),
        branches=Ragged(stops, branches),
        paths=_rows(steps, points),
        noise=RunNoise(*noise.tolist()),
        fitted_noise=None if "fitted_noise" in unknown else RunNoise(*fitted.tolist()),
        position_sigma=None if "position_sigma" in unknown else sigma,
        branch_sigma=None if "branch_sigma" in unknown else Ragged(stops, turn),
        traversal_ns=None if "traversal_ns" in unknown else _rows(visits, times),
        turning_points=_turning_points(words["turning_points"]),
        **flat,
    )


def _turning_points(words: Any) -> TurningPoints:
    def rows(name: str, dtype: type, columns: int) -> tuple[NDArray[Any], ...]:
        return tuple(np.array(row, dtype).reshape(-1, columns) for row in words[name])

    kept: dict[str, Any] = {name: words[name] for name in TURNED}
    kept |= {name: rows(name, *kind) for name, kind in ROWS.items()}
    return TurningPoints(**kept | {"kind": tuple(map(str, words["kind"]))})


def _end_to_end(rows: Sequence[NDArray[Any]], dtype: type) -> Iterator[NDArray[Any]]:
    """The length of each row, and all rows concatenated."""
    yield np.array([len(row) for row in rows], np.int64)
    yield np.concatenate([np.zeros((0, 2), dtype), *rows])


def _rows(sizes: IntArray, flat: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Inverse of `_end_to_end`; ValueError if the sizes do not fit."""
    points = flat.reshape(-1, 2)
    if (sizes < 0).any() or sizes.sum() != len(points):
        raise ValueError("rows do not fit")
    return parted(points, sizes.tolist())
