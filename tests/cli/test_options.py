"""`settings.toml` and `topobatch init`: what a workspace remembers."""

from __future__ import annotations

import json

import pytest

from topobatch.cli.options import settings_of
from topobatch.cli.workspace import Workspace


def made(tmp_path, text: str) -> Workspace:
    (tmp_path / "settings.toml").write_text(text, encoding="utf-8")
    return Workspace(tmp_path)


def test_calls_need_not_repeat_what_was_said_once(topobatch, logs, tmp_path) -> None:
    ws = tmp_path / "ws"
    done = topobatch("init", "--odometry-topic", "/none", "--false-merge-rate", "0.01", "-w", ws)
    assert done.code == 0
    assert done.out.splitlines()[-1] == str(ws / "settings.toml")
    file = ws / "settings.toml"
    error = topobatch("ingest", logs["mcap"], "-w", ws).error(1)
    assert "/none" in error
    assert error.endswith(f"; --odometry-topic is set in {file}")
    wrong = ("ingest", logs["mcap"], "--odometry-topic", "/wrong", "-w", ws)
    assert "settings.toml" not in topobatch(*wrong).error(1)
    assert "/none" in topobatch("info", logs["mcap"], "-w", ws).out
    # A call's own option comes first.
    call = ("ingest", logs["mcap"], logs["other"], "--odometry-topic", "/odom", "-w", ws)
    assert topobatch(*call).code == 0
    assert topobatch("merge", "--all", "-w", ws).code == 0
    merged = json.loads((ws / "merged.json").read_text())
    assert merged["graph"]["settings"]["false_merge_rate"] == 0.01
    assert topobatch("info", "-w", ws).out == (
        f"{ws / 'settings.toml'}: odometry-topic = /none, false-merge-rate = 0.01\n"
    )
    texts = [e["text"] for e in json.loads(topobatch("history", "--json", "-w", ws).out)]
    assert texts[0] == "odometry-topic = /none, false-merge-rate = 0.01"
    # What was used.
    assert texts[1].endswith("; odometry-topic = /odom")
    assert texts[2].endswith("; settings.toml: false-merge-rate = 0.01")
    assert topobatch("merge", "--all", "--false-merge-rate", "0.1", "-w", ws).code == 0
    assert "; false-merge-rate = 0.1\n" in topobatch("history", "-n", 1, "-w", ws).out
    file.write_text("laser-pose = 'a'")
    error = topobatch("ingest", logs["mcap"], "-w", ws).error(2)
    assert error.endswith(f"--laser-pose is set in {file}")


def test_init_adds_to_what_is_remembered_or_forgets_it(topobatch, tmp_path) -> None:
    topobatch("init", "--laser-pose", "0.2,0,1.5", "-w", tmp_path)
    topobatch("init", "--time", "log", "-w", tmp_path)
    place = Workspace(tmp_path)
    assert settings_of(place) == {"laser_pose": "0.2,0,1.5", "time": "log"}
    topobatch("init", "--scan-stamp", "end", "--forget", "-w", tmp_path)
    assert settings_of(place) == {"scan_stamp": "end"}
    assert "--laser-pose" in topobatch("init", "--laser-pose", "1,2", "-w", tmp_path).error(2)
    assert settings_of(place) == {"scan_stamp": "end"}
    assert "no name" in topobatch("init", "--base-frame", "a\nb", "-w", tmp_path).error(2)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("laser-pos = 1", "knows no 'laser-pos'; there are: "),
        ("x = 1", "knows no 'x'; there are: odometry-topic,"),
        ("time =", "is no TOML: "),
        ("time = 2020-01-01", "time: text, number, true, false or a list"),
        ("[time]\na = 1", "time: text, number, true, false or a list"),
        ("time = [['log']]", "time: text, number, true, false or a list"),
        ("a = " + "[" * 5000, "is no TOML: "),
        ("time = 'now'", "time: Invalid value for '--time'"),
        ("robot-radius = 'wide'", "robot-radius: Invalid value for '--robot-radius'"),
    ],
)
def test_what_cannot_be_used_is_told(topobatch, logs, tmp_path, text, why) -> None:
    made(tmp_path, text)
    error = topobatch("ingest", logs["mcap"], "-w", tmp_path).error(1)
    assert f"{tmp_path / 'settings.toml'}: {why}" in error


def test_a_log_or_settings_are_to_be_named(topobatch, tmp_path) -> None:
    assert "topobatch info LOG" in topobatch("info", "-w", tmp_path).error(2)
