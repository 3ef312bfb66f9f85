"""The raw log as a recording: its topics below /log, in the recording of the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from topobatch.simulation import ScenarioSettings, simulate_scenario, write_run
from topobatch.topology.errors import LogError
from topobatch.viz.raw_log import write
from topobatch.viz.recording import APPLICATION_ID


@pytest.mark.parametrize("container", ["mcap", "ros2-mcap"])
def test_topics_lie_below_one_name_on_the_clocks_of_the_log(tmp_path: Path, container: str) -> None:
    settings = ScenarioSettings(runs=1, junctions_per_run=5, odometry_hz=5)
    log = write_run(tmp_path, simulate_scenario(settings).simulated[0], container)
    write(tmp_path / "raw.rrd", log, "monday")
    reader = RrdReader(tmp_path / "raw.rrd")
    (recording,) = reader.recordings()
    assert (recording.application_id, recording.recording_id) == (APPLICATION_ID, "monday")
    chunks = reader.stream().to_chunks()
    assert {"/log/odom", "/log/junctions"} <= {chunk.entity_path for chunk in chunks}
    assert all(chunk.entity_path.startswith("/log/") for chunk in chunks)
    assert any("message_log_time" in chunk.timeline_names for chunk in chunks)


def test_logs_that_the_viewer_does_not_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(LogError, match="in MCAP only"):
        write(tmp_path / "raw.rrd", tmp_path / "a.bag", "monday")
    assert not (tmp_path / "raw.rrd").exists()
