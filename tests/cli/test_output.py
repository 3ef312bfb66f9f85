"""What reaches the terminal: printable characters, whatever the names and documents hold."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import pytest

from topobatch.cli.output import (
    NARROWEST,
    painted,
    plain,
    progress,
    say,
    say_row,
    show,
    warn,
    width,
    write_files,
)
from topobatch.topology.errors import DataError


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain ü 漢", "plain ü 漢"),
        ("\x1b[2J\x07", r"\x1b[2J\x07"),
        ("two\nlines\r", r"two\nlines\r"),
        ("\x9b31m", r"\x9b31m"),
        ("abc\u202edcba", r"abc\u202edcba"),
        ("\u2028", r"\u2028"),
        ("\ud800", r"\ud800"),
        ("\0", r"\x00"),
    ],
)
def test_what_would_steer_a_terminal_is_escaped(text, shown):
    assert plain(text) == shown
    assert plain(shown) == shown


def test_results_go_to_the_standard_output_beside_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    show()
    with progress("reading", 2, "logs") as advance:
        advance(1)
        say("run1: done")
        warn("run1: odd")
    out, err = capsys.readouterr()
    assert out == "run1: done\n"
    assert "run1: odd" in err


def test_verdicts_are_coloured_on_a_terminal_unless_that_is_unwanted(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    green = "\x1b[32mmerged\x1b[0m"
    assert painted("a + b: merged: 7 bits, in merged.json") == (
        f"a + b: {green}: 7 bits, in merged.json"
    )
    assert painted("not merged") == "not merged"
    assert painted("remerged, ws/merged, nothing") == "remerged, ws/merged, nothing"
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("a + b: merged") == "a + b: merged"


def test_lines_of_a_very_narrow_terminal_have_room_for_a_table(monkeypatch, capsys):
    row = "  run1" + " " * 40 + "a long text"
    say_row(row)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    for columns, wide in ((8, NARROWEST), (100, 99)):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert width() == wide
    monkeypatch.setenv("COLUMNS", "40")
    say_row(row)
    assert capsys.readouterr().out == f"{row}\n  run1\n      a long text\n"


def test_where_nothing_can_be_written_another_file_is_asked_for(monkeypatch):
    def refuse(writes):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(next(iter(writes))))

    monkeypatch.setattr("topobatch.topology.files.write_together", refuse)
    with pytest.raises(DataError, match="Read-only file system; name another file"):
        write_files({Path("ro/page.html"): "text"})


@pytest.mark.parametrize(
    ("columns", "amount"), [(120, "4/30 logs left: "), (40, "━\x1b[0m left: ")]
)
def test_a_bar_tells_the_speed_of_fresh_work(monkeypatch, capsys, columns, amount):
    now = [0.0]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("rich.console.monotonic", lambda: now[0])
    monkeypatch.setenv("COLUMNS", f"{columns}")
    show()
    with progress("ingesting", 190) as advance:
        for seconds in range(5):
            now[0] = seconds
            advance(96 + seconds, f"{seconds}/30 logs", kept=96)
    shown = capsys.readouterr().err
    assert amount in shown
    assert "0:01:30" in shown
    with progress("writing", 0):
        now[0] += 20
    assert "0:00:20" in capsys.readouterr().err
