"""`topobatch view`: recordings in the viewer, here or in a browser."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from urllib.error import URLError
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


def page_at(address: str) -> str:
    """The page, once it is served."""
    for _ in range(300):
        try:
            with urlopen(address) as page:
                return page.read().decode()
        except URLError:
            time.sleep(0.1)
    return ""


def test_the_viewer_is_served_to_this_machine_until_ctrl_c(topobatch, tmp_path) -> None:
    with rr.RecordingStream("topobatch") as recording:
        recording.save(tmp_path / "merged.rrd")
        recording.log("text", rr.TextLog("shown"))
    view = ("view", "-w", str(tmp_path))
    # Tests may run in the background, where processes are started deaf to Ctrl-C.
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heeding}; from topobatch.cli.main import main; main()"
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    call = [sys.executable, "-c", code, *view, "--web", "--port", str(port)]
    with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as served:
        try:
            address = served.stdout.readline().split()[0]
            assert "Rerun" in page_at(address)
            again = subprocess.run(call, capture_output=True, text=True, check=False)
            assert again.returncode == 2
            assert f"ports {port} and {port + 1} cannot be served on" in again.stderr
        finally:
            served.send_signal(signal.SIGINT)
    assert address.startswith(f"http://127.0.0.1:{port}/")
    assert served.returncode == 0
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
