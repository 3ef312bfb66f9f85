"""`topobatch view`: recordings in the viewer, here or in a browser."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from urllib.parse import urlsplit
from urllib.request import urlopen

import rerun as rr


def test_a_pair_is_explained_in_words_and_drawn(topobatch, workspace, monkeypatch) -> None:
    ws = workspace
    said = topobatch("explain", "run1", "run2", "-w", ws)
    assert f"not merged yet (topobatch merge --all -w {ws})" in " ".join(said.out.split())
    drawn = f"topobatch draw run1:run2 why.svg -w {ws}"
    assert said.out.splitlines()[-1] == f"as a picture: {drawn}"
    assert topobatch("view", "run1:run2", "-w", ws).error(2).endswith(drawn)
    # The usual workspace is not named.
    monkeypatch.setenv("TOPOBATCH_WORKSPACE", str(ws))
    assert "next: topobatch merge --all\n" in topobatch("lock", "run1", "run2", "--never").out


def test_the_viewer_is_served_to_this_machine_until_ctrl_c(topobatch, tmp_path) -> None:
    with rr.RecordingStream("topobatch") as recording:
        recording.save(tmp_path / "merged.rrd")
        recording.log("text", rr.TextLog("shown"))
    view = ("view", "-w", str(tmp_path))
    # Tests may run in the background, where processes are started deaf to Ctrl-C.
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heeding}; from topobatch.cli.main import main; main()"
    call = [sys.executable, "-c", code, *view, "--web"]
    with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as served:
        try:
            address = served.stdout.readline().split()[0]
            with urlopen(address) as page:
                assert "Rerun" in page.read().decode()
            port = urlsplit(address).port
            error = topobatch(*view, "--web", "--port", port).error(2)
            assert f"port {port}: " in error
        finally:
            served.send_signal(signal.SIGINT)
    assert address.startswith("http://127.0.0.1:")
    assert served.returncode == 0
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
    assert "--port goes with --web" in topobatch(*view, "--port", 9).error(2)
