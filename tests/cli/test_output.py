"""What reaches the terminal: printable characters, whatever the names and documents hold."""

from __future__ import annotations

import shutil
import sys

import pytest

from topobatch.cli.output import LONGEST_CELL, Screen, plain, table


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


def test_a_name_without_end_is_cut():
    shown = plain("x" * 10_000_000)
    assert len(shown) < 10_000
    assert "9,992,000 more characters" in shown
    rows = [("short", "1"), ("y" * 1_000_000, "2")]
    assert max(map(len, table(("name", "n"), rows))) < 2 * LONGEST_CELL


def test_names_of_files_and_runs_are_shown_escaped(topobatch, logs, tmp_path):
    evil = tmp_path / "\x1b[31mred\nerror: x.mcap"
    shutil.copy(logs["mcap"], evil)
    for call in (["info", evil], ["ingest", evil, tmp_path / "gone\x1b]0;x\x07", "-w", tmp_path]):
        done = topobatch(*call)
        assert "\x1b" not in done.out + done.err
        assert r"\x1b" in done.out + done.err
        assert not any(line.startswith("error: x") for line in done.err.splitlines())


def test_wrong_calls_are_shown_escaped(topobatch):
    done = topobatch("ingest", "--\x1b[31mred")
    assert done.code == 2
    assert r"no such option: --\x1b[31mred" in done.err
    assert "\x1b" not in done.err


def test_results_go_to_the_standard_output_beside_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    screen = Screen(quiet=False)
    with screen.progress("reading", 2, "logs") as advance:
        advance(1)
        screen.line("run1: done")
        screen.warn("run1: odd")
    out, err = capsys.readouterr()
    assert out == "run1: done\n"
    assert "run1: odd" in err
