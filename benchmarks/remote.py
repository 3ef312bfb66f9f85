"""Logs in a bucket beside the same logs on disk: time per log, requests, bytes.

python benchmarks/remote.py [--logs 1000] [--latency 0.03]

The bucket is moto's S3 server on this machine, behind a proxy that counts, and waits as long as a
server far away would before each answer. First many small logs, then one with a camera, whose
wanted topics have chunks of their own.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from topobatch.simulation.scenario import simulate_scenario
from topobatch.simulation.settings import ScenarioSettings
from topobatch.simulation.writing import write_run

SERVERS = Path(__file__).parents[1] / "tests" / "ingest" / "servers.py"
WANTED = {"/odom", "/junctions"}
IMAGES = 400
IMAGE_BYTES = 1 << 18
CHUNK_BYTES = 1 << 17


def servers_module() -> Any:
    spec = importlib.util.spec_from_file_location("remote_servers", SERVERS)
    assert spec is not None
    assert spec.loader is not None
    sys.modules["remote_servers"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["remote_servers"])
    return sys.modules["remote_servers"]


@dataclass
class Bucket:
    """A bucket that is empty, and the proxy in front of it."""

    port: int
    proxy: Any

    def put(self, key: str, data: bytes) -> None:
        import obstore
        from obstore.store import S3Store

        obstore.put(S3Store("logs", endpoint=f"http://127.0.0.1:{self.port}"), key, data)


@contextmanager
def bucket(latency_s: float) -> Iterator[Bucket]:
    servers = servers_module()
    with servers.s3_server() as port:
        upstream = servers.forwarding(port)

        def far_away(request: Any, body: bytes) -> Any:
            time.sleep(latency_s)
            return upstream(request, body)

        with servers.running(servers.Recorder(far_away)) as proxy:
            os.environ |= {
                "AWS_ACCESS_KEY_ID": "key",
                "AWS_SECRET_ACCESS_KEY": "secret",
                "AWS_REGION": "us-east-1",
                "AWS_ALLOW_HTTP": "true",
                "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}",
            }
            upstream(servers.Request("PUT", "/logs", {}), b"")
            yield Bucket(port, proxy)


def ingested(what: str, folder: Path, jobs: int) -> tuple[float, float, str]:
    """Wall and CPU time [s] of ingesting, and what was said; maps go to a folder of the name."""
    spare = folder / "tmp"
    spare.mkdir(exist_ok=True)
    call = [sys.executable, "-m", "topobatch.cli", "ingest", what, "-j", str(jobs)]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [*call, "-w", str(folder / ("remote" if "://" in what else "local"))],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"TMPDIR": str(spare)},
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode or any(spare.iterdir()):
        raise SystemExit(f"remote.py: {what}: {done.stderr or 'left temporary files'}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, cpu, done.stdout


def same_maps(folder: Path) -> int:
    """How many maps there are; all of them must be the same from both places."""
    local = {file.name: file.read_bytes() for file in (folder / "local" / "maps").glob("*.json")}
    remote = {file.name: file.read_bytes() for file in (folder / "remote" / "maps").glob("*.json")}
    if local != remote:
        raise SystemExit("remote.py: the maps of a bucket are not those of the folder")
    return len(local)


def mcap_bound(path: Path) -> int:
    """Bytes of the summary, and of the chunks that hold wanted topics, by mcap's own reader."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        file.seek(-37, 2)
        (start,) = struct.unpack_from("<9xQ", file.read())
    numbers = {number for number, c in summary.channels.items() if c.topic in WANTED}
    chunks = [c for c in summary.chunk_indexes if numbers & set(c.message_index_offsets)]
    return path.stat().st_size - start + sum(chunk.chunk_length for chunk in chunks)


def with_camera(source: Path, target: Path) -> Path:
    """The messages of a log, then images, in chunks that one image fills."""
    random = np.random.default_rng(0)
    with source.open("rb") as read, target.open("wb") as written:
        writer = Writer(written, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start("ros2")
        channels: dict[str, int] = {}
        times = []
        for schema, channel, message in make_reader(read).iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            times.append(message.log_time)
            writer.add_message(channels[channel.topic], times[-1], message.data, times[-1])
        image = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        camera = writer.register_channel("/camera", "cdr", image)
        for k in range(IMAGES):
            raw = random.integers(0, 256, IMAGE_BYTES, np.uint8).tobytes()
            writer.add_message(camera, times[k % len(times)], raw, times[k % len(times)])
        writer.finish()
    return target


def small_logs(folder: Path, count: int, place: Bucket) -> None:
    settings = ScenarioSettings(runs=1, junctions_per_run=6, drift="low", odometry_hz=5, seed=5)
    simulated = simulate_scenario(settings).simulated[0]
    made = [write_run(folder / kind, simulated, kind) for kind in ("mcap", "bag")]
    logs = folder / "logs"
    logs.mkdir()
    for number in range(count):
        source = made[number % len(made)]
        name = f"run{number:05d}{source.suffix}"
        (logs / name).write_bytes(source.read_bytes())
        place.put(f"small/{name}", source.read_bytes())
    whole = sum(file.stat().st_size for file in logs.iterdir())
    rows = []
    place.proxy.clear()
    for where, what in (("bucket", "s3://logs/small/"), ("disk", str(logs))):
        wall, cpu, _ = ingested(what, folder, 1)
        rows.append((where, 1000 * wall / count, 1000 * cpu / count))
    print(f"{same_maps(folder)} logs of {whole / count / 1e3:.0f} kB, the same maps from both\n")
    print("| | wall ms per log | CPU ms per log |\n| --- | ---: | ---: |")
    for where, wall_ms, cpu_ms in rows:
        print(f"| {where} | {wall_ms:.0f} | {cpu_ms:.0f} |")
    gets, listings = len(place.proxy.gets), len(place.proxy.requests) - len(place.proxy.gets)
    # Every chunk of these bags holds odometry.
    bounds = [mcap_bound(log) if log.suffix == ".mcap" else log.stat().st_size for log in made]
    bound = sum(bounds[number % len(made)] for number in range(count))
    print(
        f"\n{gets / count:.2f} requests per log and {listings} for the list; read "
        f"{place.proxy.sent / bound:.3f} of the indexes' lower bound, "
        f"{place.proxy.sent / whole:.3f} of all bytes"
    )


def camera_log(folder: Path, place: Bucket) -> None:
    settings = ScenarioSettings(runs=1, junctions_per_run=40, drift="low", seed=3)
    simulated = simulate_scenario(settings).simulated[0]
    logs = folder / "logs"
    logs.mkdir()
    plain = write_run(folder / "plain", simulated, "mcap")
    log = with_camera(plain, logs / "camera.mcap")
    place.put("camera/camera.mcap", log.read_bytes())
    place.proxy.clear()
    remote = ingested("s3://logs/camera/", folder, 1)
    local = ingested(str(logs), folder, 1)
    same_maps(folder)
    size, sent, bound = log.stat().st_size, place.proxy.sent, mcap_bound(log)
    print(
        "\n| camera log MB | read kB | index's lower bound kB | read / bound | read / file "
        "| requests | wall s | wall s from disk |"
    )
    print("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    print(
        f"| {size / 1e6:.0f} | {sent / 1e3:.0f} | {bound / 1e3:.0f} | {sent / bound:.3f} "
        f"| {sent / size:.4f} | {len(place.proxy.gets)} | {remote[0]:.2f} | {local[0]:.2f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--latency", type=float, default=0.03, help="seconds before each answer")
    asked = parser.parse_args()
    for measure in (lambda f, b: small_logs(f, asked.logs, b), camera_log):
        with tempfile.TemporaryDirectory() as temporary, bucket(asked.latency) as place:
            measure(Path(temporary), place)
    return 0


if __name__ == "__main__":
    sys.exit(main())
