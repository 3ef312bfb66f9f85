"""What reaches the terminal: printable characters, whatever the names and documents hold."""

from __future__ import annotations

import re
import shutil
import sys

import pytest

from topobatch.cli.output import LONGEST_CELL, Screen, _left, folded, painted, plain, table


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


def test_verdicts_are_coloured_on_a_terminal_unless_that_is_unwanted(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    green = "\x1b[32mmerged\x1b[0m"
    assert painted("a + b: merged: 7 bits, in merged.json") == (
        f"a + b: {green}: 7 bits, in merged.json"
    )
    assert painted("remerged, ws/merged, nothing") == "remerged, ws/merged, nothing"
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("a + b: merged") == "a + b: merged"


def test_no_colour_leaves_the_terminal(topobatch, logs, tmp_path):
    done = topobatch("ingest", logs["mcap"], "-w", tmp_path)
    assert "\x1b" not in done.out + done.err


def test_sentences_are_as_wide_as_the_terminal(monkeypatch):
    text = "word " * 60
    assert max(map(len, folded(text))) <= 79
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    for columns, most in ((60, 59), (500, 120), (10, 40)):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert most - 5 < max(map(len, folded(text))) <= most


def test_a_bar_tells_how_much_is_done_and_how_long_it_takes(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    now = iter(range(0, 10_000, 30))
    monkeypatch.setattr("topobatch.cli.output.time.monotonic", lambda: next(now))
    monkeypatch.setenv("COLUMNS", "120")
    with Screen(quiet=False).progress("ingesting", 100) as advance:
        advance(20, "3/30 logs, 41 of 380 MB")
    err = capsys.readouterr().err
    assert "3/30 logs, 41 of 380 MB" in err
    assert re.search(r"about \d+ min", err)  # the bar looks at the clock when it likes


def test_a_bar_tells_the_speed_of_fresh_work_and_the_time_of_a_phase(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("topobatch.cli.output.time.monotonic", lambda: now[0])
    monkeypatch.setenv("COLUMNS", "120")
    with Screen(quiet=False).progress("matching", 190, "pairs") as advance:
        advance(96, kept=96)
        now[0] = 60.0
        advance(100, kept=96)
    assert "100 of 190 pairs, 96 of them kept about 22 min" in capsys.readouterr().err
    with Screen(quiet=False).progress("matching", 190, "pairs") as advance:
        advance(190, doing="joining")
        now[0] += 75
    assert re.search("joining .* 75 s", capsys.readouterr().err)
    with Screen(quiet=False).progress("writing", 0):
        now[0] += 20
    assert re.search("writing .* 20 s", capsys.readouterr().err)


def test_the_time_left_is_told_once_it_can_be_known():
    assert _left(1.0, 0.5) == ""
    assert _left(10.0, 0.01) == ""
    assert _left(10.0, 0.5) == "about 10 s"
    assert _left(60.0, 0.25) == "about 3 min"
    assert _left(60.0, 1.0) == ""
