"""Maps as bytes, and documents that are parsed once."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge import kept_maps
from topobatch.merge.digests import digest_of
from topobatch.merge.kept_maps import KeptMaps, from_bytes, to_bytes
from topobatch.topology.document import map_to_document, read_map, write_map
from topobatch.topology.errors import DocumentError
from topobatch.topology.files import encoded
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import Closure, RunNoise
from topobatch.topology.turning_points import TurningPoints


@pytest.fixture
def plain(maze, see):
    """Of a run of which little is known."""
    return see(maze, list(range(30)), 3, "plain")


@pytest.fixture
def full(plain):
    """Of one of which everything is."""
    n, m = len(plain), len(plain.source)
    closures = (
        Closure(1, 2**62, True, 1 / 3, "same branches", round=2),
        Closure(1, 3, False, -1.5, "»weak«", round=5, accepted_round=3, revised=True),
    )
    times = tuple(np.arange(2 * (k % 3), dtype=np.int64).reshape(-1, 2) - 2**62 for k in range(m))
    return replace(
        plain,
        run="full",
        noise=RunNoise(scale=1 / 7),
        fitted_noise=RunNoise(centre_m=1e-7),
        closures=closures,
        position_sigma=np.linspace(0.1, 0.2, n),
        branch_sigma=Ragged(plain.branches.offsets, np.sqrt(np.arange(plain.branches.offsets[-1]))),
        traversal_ns=times,
        confidence=np.linspace(0.5, 1.0, n),
        shows_bends=False,
        turning_points=TurningPoints(
            kind=("turning_point", "track_end"),
            vertex=np.array([0, 3]),
            branch=np.array([0, -1]),
            heading=np.array([1 / 3, -3.0]),
            length=np.array([2.0, 1 / 7]),
            length_sigma=np.array([0.1, 0.2]),
            position_sigma=np.array([0.1, 1e-7]),
            branch_sigma=np.array([0.0, 0.3]),
            traversals=np.array([2, 5]),
            paths=(np.array([[0, 1 / 3], [2.0, 0]]), np.zeros((3, 2))),
            traversal_ns=(np.array([[1, 2], [4, 2**62]]), np.zeros((0, 2), np.int64)),
            time_ns=(np.array([[2]]), np.array([[5], [7]])),
        ),
        info={"source": {"log": "a\\b", "more": ["x", None, 1e-300, 2**70]}, "warnings": ["x"]},
    )


@pytest.fixture
def empty(plain):
    """A junction of no branches, of which the sigmas are known: none."""
    return replace(
        plain,
        run="empty",
        xy=np.zeros((1, 2)),
        kind=("junction",),
        branches=Ragged.from_rows([[]]),
        **{
            name: getattr(plain, name)[:0]
            for name in (
                *("source", "target", "source_branch", "target_branch", "length", "length_sigma"),
                *("traversals", "paths", "observation_vertex", "observation_time_ns"),
            )
        },
        branch_sigma=Ragged.from_rows([[]]),
        position_sigma=np.zeros(1),
        traversal_ns=(),
        confidence=np.ones(1),
    )


@pytest.mark.parametrize("which", ["plain", "full", "empty"])
def test_maps_are_the_same_to_the_last_bit(which, request):
    topomap = request.getfixturevalue(which)
    again = from_bytes(to_bytes(topomap))
    assert digest_of(again) == digest_of(topomap)
    assert encoded(map_to_document(again)) == encoded(map_to_document(topomap))
    assert (again.run, again.closures, again.info) == (topomap.run, topomap.closures, topomap.info)
    assert to_bytes(again) == to_bytes(topomap)


def test_bytes_that_are_no_map_are_refused(full):
    whole = to_bytes(full)
    rng = np.random.default_rng(5)
    for at in rng.integers(len(whole), size=300).tolist():
        assert from_bytes(whole[:at]) is None
        spoilt = bytearray(whole)
        spoilt[at] ^= 1 << int(rng.integers(8))
        from_bytes(bytes(spoilt))  # a map or none: what was flipped may be a position
    for data in (b"", b"\0" * 8, b"\xff" * 40, whole + b"\0" * 8):
        assert from_bytes(data) is None


def test_a_document_is_parsed_once(full, tmp_path, new_store, monkeypatch):
    path, store = tmp_path / "full.json", new_store()
    write_map(path, full)
    for _ in range(2):
        maps = KeptMaps(store)
        found = maps.read(path)
        maps.keep()
        assert digest_of(found) == digest_of(read_map(path))
        assert encoded(map_to_document(found)) == path.read_bytes().rstrip()
        monkeypatch.delattr(kept_maps, "map_from_document", raising=False)
    monkeypatch.undo()
    write_map(path, replace(full, frame="another"))
    assert KeptMaps(store).read(path).frame == "another"
    path.write_text("{")
    with pytest.raises(DocumentError, match=r"full\.json: is not JSON"):
        KeptMaps(store).read(path)
    path.unlink()
    with pytest.raises(DocumentError, match=r"full\.json: cannot be read"):
        KeptMaps(store).read(path)
