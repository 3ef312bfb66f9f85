"""A merge that finds results of another one: the same bytes, whatever became of the cache."""

import json
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.cache import MOST_FILES, ResultCache
from topobatch.merge.document import merged_to_document, read_merged, write_merged
from topobatch.merge.merging import merge_maps
from topobatch.merge.packs import Kind, Pack, PackWriter
from topobatch.merge.robust import DEFAULT_ROBUST, Means, RobustSettings, tasks
from topobatch.merge.robust.tasks import era_of
from topobatch.merge.workers import Workers


@pytest.fixture(scope="module")
def fleet(maze, other_maze, see):
    """Five maps, of which some share places."""
    quarters = [(maze, 0.0, 0.5), (maze, 0.2, 0.7), (maze, 0.5, 1.0), (other_maze, 0.0, 0.6)]
    maps = []
    for k, (world, low, high) in enumerate(quarters):
        across = np.argsort(np.argsort(world.xy[:, 0])) / len(world.xy)
        rows = np.flatnonzero((across >= low) & (across <= high)).tolist()
        maps.append(see(world, rows, k + 1, f"r{k}"))
    return [*maps, see(other_maze, list(range(40)), 7, "r4")]


def text(maps, means=None):
    """The document as it is written, which takes entries from the cache; it is what it would be."""
    result = merge_maps(maps, means=means)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "merged.json"
        write_merged(path, result)
        written = path.read_text()
    assert json.loads(written) == json.loads(json.dumps(merged_to_document(result)))
    return written


class Counted(ResultCache):
    """A cache that knows what was matched anew."""

    def __init__(self, folder):
        super().__init__(folder, era_of(DEFAULT_ROBUST))
        self.fresh = []

    def keep(self, pack):
        rows = pack.rows
        self.fresh += [(pack.digests[r["a"]], pack.digests[r["b"]], Kind(r["kind"])) for r in rows]
        super().keep(pack)

    def of(self, kind) -> Sequence[tuple[bytes, bytes, Kind]]:
        return [key for key in self.fresh if key[2] is kind]


def merged_with(folder, maps, settle=True):
    store = Counted(folder)
    out = text(maps, Means(store=store))
    store.flush()
    if settle:
        store.settle()
    return out, store


def test_only_pairs_with_the_new_map_are_matched(fleet, tmp_path):
    _, before = merged_with(tmp_path, fleet[:4])
    assert len(before.of(Kind.PAIR)) == 6
    assert len(before.of(Kind.ITSELF)) == 4
    out, store = merged_with(tmp_path, fleet)
    assert out == text(fleet)
    assert len(store.of(Kind.PAIR)) == 4
    assert len(store.of(Kind.ITSELF)) == 1
    again, nothing = merged_with(tmp_path, fleet)
    assert again == out
    assert nothing.fresh == []


def test_a_folder_of_several_buildings_merges_anew_as_it_grew(mixed, tmp_path):
    for count in (2, 3, 4, 7, len(mixed)):
        out, _ = merged_with(tmp_path, mixed[:count])
    assert out == text(mixed)


def test_a_run_by_another_name_is_not_matched_again(fleet, tmp_path):
    from dataclasses import replace

    merged_with(tmp_path, fleet)
    maps = [*fleet[:4], replace(fleet[4], run="r9")]
    out, store = merged_with(tmp_path, maps)
    # Its name stands in the words.
    assert {kind for _, _, kind in store.fresh} == {Kind.VERDICT, Kind.TEXT}
    assert len(store.of(Kind.VERDICT)) <= 4
    assert len(store.of(Kind.TEXT)) == 1
    assert out == text(maps)


@pytest.mark.parametrize("forged", [b"", b"\n\n", b'"x":0}', b"a\nb\n\nc"])
def test_text_of_other_places_is_passed_over(fleet, tmp_path, monkeypatch, forged):
    right, _ = merged_with(tmp_path, fleet)
    find = ResultCache.find
    asked = []

    def spoilt(self, kind, key):
        asked.append(kind)
        return forged if kind is Kind.TEXT else find(self, kind, key)

    monkeypatch.setattr(ResultCache, "find", spoilt)
    assert merged_with(tmp_path, fleet)[0] == right
    assert Kind.TEXT in asked


@pytest.mark.parametrize("harm", ["flip", "cut", "empty", "junk", "gone"])
def test_damage_costs_time_only(fleet, tmp_path, harm):
    right, _ = merged_with(tmp_path, fleet)
    files = sorted(tmp_path.iterdir())
    for k, path in enumerate(files):
        data = bytearray(path.read_bytes())
        if harm == "flip":
            data[(len(data) * (k + 1)) // (len(files) + 1)] ^= 4
        path.write_bytes(
            {"cut": data[:-9], "empty": b"", "junk": b"TOPOPACK" * 99}.get(harm, bytes(data))
        )
        if harm == "gone":
            path.unlink()
    out, store = merged_with(tmp_path, fleet)
    assert out == right
    assert store.fresh
    assert merged_with(tmp_path, fleet)[1].fresh == []


def test_what_belongs_to_no_map_is_dropped(fleet, tmp_path):
    merged_with(tmp_path, fleet)
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    out, _ = merged_with(tmp_path, fleet[:2])
    left = list(tmp_path.iterdir())
    assert sum(path.stat().st_size for path in left) < size / 2
    assert merged_with(tmp_path, fleet[:2])[0] == out


def test_many_small_files_become_one(fleet, tmp_path):
    maps = fleet[:2]
    merged_with(tmp_path, maps, settle=False)
    (one, *_) = tmp_path.iterdir()
    for k in range(MOST_FILES + 1):
        out = PackWriter(era_of(DEFAULT_ROBUST))
        out.add((bytes([k]) * 16, b"x" * 16), 0)
        (tmp_path / f"{k:032x}.pack").write_bytes(out.pack().to_bytes())
    merged_with(tmp_path, maps)
    assert len(list(tmp_path.iterdir())) == 1
    assert not one.name.startswith(".")


def test_only_packs_are_touched(fleet, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    folder = tmp_path / "pairs"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / ("0" * 32 + ".pack")).symlink_to(victim)
    (folder / ("1" * 32 + ".pack")).mkdir()
    merged_with(folder, fleet[:2])
    assert victim.read_text() == "precious"
    assert (folder / "notes.txt").read_text() == "mine"
    assert (folder / ("1" * 32 + ".pack")).is_dir()


def test_settings_and_program_make_another_era(monkeypatch):
    plain = era_of(DEFAULT_ROBUST)
    assert era_of(RobustSettings(hypotheses=4)) != plain
    assert era_of(RobustSettings(false_merge_rate=0.01)) == plain
    monkeypatch.setattr(tasks, "_program", lambda: "other")
    assert era_of(DEFAULT_ROBUST) != plain


def test_a_cache_that_cannot_be_written_is_told(fleet, tmp_path):
    folder = tmp_path / "file"
    folder.write_text("no folder")
    heard = []
    store = ResultCache(folder, era_of(DEFAULT_ROBUST), heard.append)
    assert text(fleet[:2], Means(store=store)) == text(fleet[:2])
    store.flush()
    (told,) = heard
    assert "results are not kept" in told


@pytest.mark.parametrize("sent", [True, False])
def test_workers_give_the_same_bytes(fleet, tmp_path, sent):
    by_run = {m.run: m for m in fleet}

    class Maps:
        def read_map(self, run):
            return by_run[run]

    with ThreadPoolExecutor(2) as pool:
        store = Counted(tmp_path)
        means = Means(
            Workers(lambda: nullcontext(pool)), maps=None if sent else Maps(), store=store
        )
        assert text(fleet, means) == text(fleet)
    assert len(store.of(Kind.PAIR)) == 10


@pytest.mark.parametrize("seed", range(5))
def test_forged_records_do_no_harm(fleet, tmp_path, seed):
    """Payloads of somebody who knows how to make their checksums: cut off, or changed by a byte,
    they are passed over, or give a document that is one."""
    merged_with(tmp_path, fleet)
    rng, era = np.random.default_rng(seed), era_of(DEFAULT_ROBUST)
    forged = PackWriter(era)
    for path in list(tmp_path.iterdir()):
        pack = Pack.from_bytes(path.read_bytes())
        for k, row in enumerate(pack.rows):
            payload = bytearray(pack.payload(k))
            if payload and row["kind"] != Kind.TEXT:  # of which nothing but its lines is looked at
                payload[rng.integers(len(payload))] ^= int(rng.integers(1, 256))
                payload = payload[: len(payload) - 5] if rng.random() < 0.2 else payload
            key = pack.digests[row["a"]], pack.digests[row["b"]]
            numbers = {name: row[name].item() for name in ("junctions", "bits", "beyond")}
            forged.add(key, row["kind"].item(), payload=bytes(payload), **numbers)
        path.unlink()
    (tmp_path / ("0" * 32 + ".pack")).write_bytes(forged.pack().to_bytes())
    path = tmp_path / "merged.json"
    write_merged(path, merge_maps(fleet, means=Means(store=ResultCache(tmp_path, era))))
    document = read_merged(path)
    assert {run for c in document.graph.components for run in c.runs} == {m.run for m in fleet}
