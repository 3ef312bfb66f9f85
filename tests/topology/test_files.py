"""Files of documents are written whole or not at all."""

from __future__ import annotations

import errno
import json
import os

import pytest

from topobatch.topology.files import encoded, write_atomically, write_together


def test_files_that_belong_together_are_written_all_or_none(tmp_path):
    def fail(temporary):
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    one, two = tmp_path / "one", tmp_path / "two"
    one.write_text("old")
    with pytest.raises(OSError, match=f"No space left on device: '{two}'"):
        write_together({one: lambda path: path.write_text("1"), two: fail})
    assert os.listdir(tmp_path) == ["one"]
    assert one.read_text() == "old"
    write_together({path: lambda temporary: temporary.write_text("x") for path in (one, two)})
    assert sorted(os.listdir(tmp_path)) == ["one", "two"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("old")

    def fail(temporary):
        temporary.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.json"]


def test_numbers_that_are_none_are_refused_and_words_like_them_are_not():
    for number in (float("nan"), float("inf"), -float("inf")):
        with pytest.raises(ValueError, match="not JSON compliant"):
            encoded({"x": [1.0, (number,)]})
    words = {"run": "NaN", "Infinity": "to -Infinity, and NaN"}
    assert json.loads(encoded(words)) == words
