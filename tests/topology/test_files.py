"""Documents are written whole or not at all, and only plain files are read."""

from __future__ import annotations

import json
import os

import pytest

from topobatch.topology.errors import DocumentError
from topobatch.topology.files import encoded, read_json, write_json, write_together


def test_lists_are_written_as_they_are_made(tmp_path):
    path = tmp_path / "a.json"
    entries = [{"k": k, "text": "ä"} for k in range(2500)]
    known = (encoded(e) if e["k"] % 3 else e for e in entries)
    write_json(path, {"one": 1, "many": known, "none": iter(())})
    assert read_json(path) == {"one": 1, "many": entries, "none": []}
    plain = json.dumps(
        {"one": 1, "many": entries, "none": []}, separators=(",", ":"), ensure_ascii=False
    )
    assert path.read_text(encoding="utf-8") == plain + "\n"


def test_of_files_that_belong_together_all_are_replaced_or_none(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_text("old")

    def full(path):
        path.write_text("half")
        raise OSError(28, "No space left on device", str(path))

    with pytest.raises(OSError, match="No space left") as caught:
        write_together({one: lambda path: path.write_text("new"), two: full})
    assert caught.value.filename == str(two)
    assert one.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    write_together({one: lambda p: p.write_text("new"), two: lambda p: p.write_text("new")})
    assert [path.read_text() for path in (one, two)] == ["new", "new"]
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    "text", ["[" * 300 + "]" * 300, '{"a": NaN}', '{"a": Infinity}', '"\\ud800"', "{", ""]
)
def test_what_is_no_document_is_refused_by_name(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DocumentError, match=r"a\.json: is not JSON"):
        read_json(path)


def test_links_and_fifos_are_not_opened(tmp_path):
    (tmp_path / "real").write_text("{}")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    os.mkfifo(tmp_path / "fifo")
    for name, kind in (("link", "link"), ("fifo", "FIFO"), (".", "folder")):
        with pytest.raises(DocumentError, match=f"is a {kind}"):
            read_json(tmp_path / name)
