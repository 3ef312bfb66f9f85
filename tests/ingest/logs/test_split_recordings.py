"""Which numbered files are parts of one recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from topobatch.ingest.logs.finding import with_parts_joined
from topobatch.ingest.logs.recording import recording_at, run_name
from topobatch.ingest.logs.split_recordings import split_recordings
from topobatch.ingest.reading import find_logs, log_fingerprint

S = 10**9


def groups(*named: tuple[str, int, int]) -> list[list[str]]:
    """Names of files by recording; each file with the seconds of its first and last message."""
    spans = {Path(name): (first * S, last * S) for name, first, last in named}
    found = split_recordings(sorted(spans), spans.get)
    return [[path.name for path in parts] for parts in found]


def test_parts_follow_each_other_in_numbers_and_time():
    assert groups(("a_0.bag", 0, 9), ("a_1.bag", 10, 19), ("b.bag", 0, 9), ("map.yaml", 0, 0)) == [
        ["a_0.bag", "a_1.bag"],
        ["b.bag"],
        ["map.yaml"],
    ]
    apart = groups(("a_0.bag", 0, 9), ("a_1.bag", 0, 9))
    assert apart == [["a_0.bag"], ["a_1.bag"]]
    late = groups(("a_0.bag", 0, 9), ("a_1.bag", 60, 69))
    assert late == [["a_0.bag"], ["a_1.bag"]]
    missing = groups(("a_0.bag", 0, 9), ("a_2.bag", 10, 19))
    assert missing == [["a_0.bag"], ["a_2.bag"]]
    formats = groups(("a_0.bag", 0, 9), ("a_1.mcap", 10, 19))
    assert formats == [["a_0.bag"], ["a_1.mcap"]]


@pytest.mark.parametrize("beside", [True, False])
def test_a_split_recording_has_a_path(logs, tmp_path, beside):
    drive = logs.drive()
    parts = [
        logs.bag(tmp_path / f"run_{k}.bag", some)
        for k, some in enumerate((drive[:200], drive[200:]))
    ]
    other = [logs.bag(tmp_path / "other.bag", drive)] if beside else []
    path = tmp_path / "run_*.bag" if beside else tmp_path
    assert find_logs([tmp_path]) == [*other, path]
    assert find_logs([tmp_path], separate=True) == [*other, *parts]
    assert [file.path for file in recording_at(path).files] == parts
    assert run_name(path) == ("run" if beside else tmp_path.name)
    assert with_parts_joined([*parts, *other]) == [path, *other]
    assert with_parts_joined(parts[:1]) == parts[:1]
    before = log_fingerprint(path)
    parts[1].write_bytes(parts[0].read_bytes())
    assert log_fingerprint(path) != before
