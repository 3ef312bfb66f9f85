"""Scans, clouds, grids, saved maps, transforms and poses with false sizes and absurd numbers.

None of it makes a map that could be compared: what counts is how the call ends and what it takes.
"""

from __future__ import annotations

import math
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from case import Case, Generator, writers

SECOND = 10**9
START_NS = 1_700_000_000 * SECOND

ABSURD = (0.0, -0.0, 1e-45, -1e-30, 1e-9, -1.0, 1e9, 1e30, math.nan, math.inf, -math.inf)
"""Numbers that fit into a float32 and into nothing that was measured."""


class Cdr:
    """A message in little-endian CDR."""

    def __init__(self) -> None:
        self.raw = bytearray()

    def put(self, kind: str, *values: float) -> Cdr:
        """Numbers of one kind, aligned."""
        width = struct.calcsize(kind)
        self.raw += bytes(-len(self.raw) % width)
        self.raw += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def text(self, text: str) -> Cdr:
        """A string."""
        data = text.encode() + b"\0"
        self.put("I", len(data)).raw.extend(data)
        return self

    def header(self, time_ns: int, frame: str) -> Cdr:
        """A std_msgs/Header."""
        return self.put("i", time_ns // SECOND).put("I", time_ns % SECOND).text(frame)

    def done(self, data: bytes = b"") -> bytes:
        """The message, with bytes behind it."""
        return b"\0\1\0\0" + bytes(self.raw) + data


Message = tuple[int, bytes]
"""Log time and payload."""


def _odometry(count: int = 300, numbers: Callable[[int], float] | None = None) -> Iterator[Message]:
    """A drive around a square; numbers: of a pose, in place of the true ones."""
    for k in range(count):
        time_ns, turn = START_NS + k * SECOND // 20, 0.02 * k
        pose = [8 * math.cos(turn), 8 * math.sin(turn), 0, 0, 0]
        pose += [math.sin(turn / 2 + 0.8), math.cos(turn / 2 + 0.8)]
        if numbers is not None:
            pose = [numbers(k) for _ in pose]
        body = Cdr().header(time_ns, "odom").text("base_link").put("d", *pose)
        yield time_ns, body.put("d", *bytes(36), *bytes(6), *bytes(36)).done()


def _log(
    path: Path, topics: dict[str, tuple[str, str, list[Message]]], compression: str = "ZSTD"
) -> Path:
    """An MCAP file; topics: type, encoding and messages by name. Schemas are left out."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression])
        writer.start("", "attack")
        every = []
        for topic, (kind, encoding, messages) in topics.items():
            schema = writer.register_schema(kind, "", b"")
            channel = writer.register_channel(topic, encoding, schema)
            every += [(time_ns, channel, payload) for time_ns, payload in messages]
        for time_ns, channel, payload in sorted(every, key=lambda message: message[0]):
            writer.add_message(channel, max(time_ns, 0), payload, max(time_ns, 0))
        writer.finish()
    return path


def _sensor(kind: str, make: Callable[[random.Random], list[Message]], note: str) -> Generator:
    """A log of good odometry and hostile messages of a sensor."""

    def write(rng: random.Random, folder: Path) -> Case:
        topics = {
            "/odom": ("nav_msgs/msg/Odometry", "cdr", list(_odometry())),
            "/sensor": (kind, "json" if "foxglove" in kind else "cdr", make(rng)),
        }
        like = "grid" if kind == GRID else "detections"
        return Case(_log(folder / "run.mcap", topics), None, None, note, like)

    return write


def sound(cells: int, folder: Path) -> Path:
    """What hostile grids are held against: a crossing in a grid so many cells wide."""
    way = range(cells // 2 - 20, cells // 2 + 20)
    free = bytes(0 if x in way or y in way else 100 for y in range(cells) for x in range(cells))
    topics = {"/sensor": (GRID, "cdr", [(START_NS, _grid(free, (cells, cells)))])}
    return _log(folder / "grid.mcap", topics, "NONE")


def _times(count: int) -> list[int]:
    return [START_NS + k * SECOND // 10 for k in range(count)]


# Scans


def _scan(
    time_ns: int,
    ranges: bytes,
    *,
    count: int | None = None,
    frame: str = "base_link",
    about: tuple[float, ...] = (-3.1, 3.1, 0.01, 0.0, 0.1, 0.1, 30.0),
) -> bytes:
    body = Cdr().header(time_ns, frame).put("f", *about)
    return body.put("I", len(ranges) // 4 if count is None else count).done(ranges + bytes(4))


def _floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def _false_counts(rng: random.Random) -> list[Message]:
    counts = (0, 1, 2, 619, 622, 65_536, 1 << 24, (1 << 32) - 1)
    return [(t, _scan(t, _floats(2.0) * 620, count=rng.choice(counts))) for t in _times(200)]


def _absurd_angles(rng: random.Random) -> list[Message]:
    about = [-3.1, 3.1, 0.01, 0.0, 0.1, 0.1, 30.0]
    for k in rng.sample(range(7), rng.randint(1, 3)):
        about[k] = rng.choice(ABSURD)
    return [(t, _scan(t, _floats(2.0) * 620, about=tuple(about))) for t in _times(300)]


def _absurd_ranges(rng: random.Random) -> list[Message]:
    some = rng.sample(ABSURD, rng.randint(1, 4))
    share = rng.choice((0.01, 0.5, 1.0))
    return [
        (t, _scan(t, _floats(*(rng.choice(some) if rng.random() < share else 2.0 for _ in r))))
        for t, r in ((t, range(620)) for t in _times(200))
    ]


# Clouds


def _cloud(
    time_ns: int,
    data: bytes,
    *,
    height: int,
    width: int,
    step: int,
    row: int,
    fields: tuple[tuple[str, int, int], ...] = (("x", 0, 7), ("y", 4, 7), ("z", 8, 7)),
    size: int | None = None,
) -> bytes:
    body = Cdr().header(time_ns, "base_link").put("I", height, width, len(fields))
    for name, offset, datatype in fields:
        body.text(name).put("I", offset).put("B", datatype).put("I", 1)
    body.put("B", 0).put("I", step, row, len(data) if size is None else size)
    return body.done(data + b"\1")


def _cloud_sizes(rng: random.Random) -> list[Message]:
    numbers = (0, 1, 11, 12, 100, 4096, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
    return [
        (
            t,
            _cloud(
                t,
                bytes(1200),
                height=rng.choice(numbers),
                width=rng.choice(numbers),
                step=rng.choice((0, 0, 1, 12, *numbers)),
                row=rng.choice((0, *numbers)),
                size=rng.choice((1200, 1200, *numbers)),
            ),
        )
        for t in _times(100)
    ]


def _cloud_fields(rng: random.Random) -> list[Message]:
    numbers = (0, 1, 4, 8, 9, 11, 12, 1 << 31, (1 << 32) - 1)
    out = []
    for t in _times(100):
        names = rng.sample(("x", "y", "z", "", "\x1b[31m", "x", "y", "z"), rng.randint(0, 8))
        fields = tuple((n, rng.choice(numbers), rng.randint(0, 255)) for n in names)
        fields *= rng.choice((1, 1, 40, 400))
        out.append(
            (t, _cloud(t, bytes(1200), height=1, width=100, step=12, row=1200, fields=fields))
        )
    return out


# Grids


def _grid(data: bytes, size: tuple[int, int], resolution: float = 0.05) -> bytes:
    body = Cdr().header(START_NS, "map").put("I", 0, 0).put("f", resolution)
    body.put("I", *size).put("d", 0, 0, 0, 0, 0, 0, 1)
    return body.put("I", len(data)).done(data)


def _cells(rng: random.Random, width: int, height: int) -> bytes:
    """Free, unknown or occupied cells as thinning and tracing like them least."""
    kind = rng.choice(("free", "noise", "teeth", "board", "holes", "unknown", "rooms"))
    if kind == "rooms":
        return _rooms(width, height)
    if kind == "noise":
        return bytes(100 * (b & 1) for b in rng.randbytes(width * height))
    row = {
        "free": bytes(width),
        "unknown": b"\xff" * width,
        "teeth": (bytes(10) + b"\x64" * 2) * (width // 12 + 1),
        "board": b"\x00\x64" * (width // 2 + 1),
        "holes": (bytes(20) + b"\x64") * (width // 21 + 1),
    }[kind][:width]
    other = {"board": row[1:] + row[:1], "holes": bytes(width)}.get(kind, row)
    every = {"teeth": height // 2 + 1, "holes": 21, "board": 2}.get(kind, height + 1)
    lines = [bytes(width) if kind == "teeth" and k % every == 0 else row for k in range(height)]
    if kind in ("board", "holes"):
        lines = [row if k % every == 0 else other for k in range(height)]
    return b"".join(lines)


def _rooms(width: int, height: int, room: int = 90, way: int = 32) -> bytes:
    """A building of rooms on both sides of corridors, which is no noise, however large it is."""
    free, wall, lane = bytes(width), b"\x64" * width, bytes(way)
    inside = (b"\x64" * 2 + bytes(room - 2)) * (width // room + 1)
    doors = (b"\x64" * (room // 2 - 8) + bytes(16) + b"\x64" * (room - room // 2 - 8)) * (
        width // room + 1
    )
    rows = [
        *[lane + wall] * 2,
        *[lane + inside[: width - way]] * (room - 4),
        *[lane + doors[: width - way]] * 2,
        *[free] * way,
        *[lane + doors[: width - way]] * 2,
        *[lane + inside[: width - way]] * (room - 4),
    ]
    return b"".join(row[:width] for row in (rows * (height // len(rows) + 1))[:height])


def _grid_large(rng: random.Random) -> list[Message]:
    width, height = rng.choice(((4000, 4000), (1000, 1000), (16_000_000, 1), (2000, 8000)))
    cells = _cells(rng, width, height)
    return [(START_NS, _grid(cells, (width, height), rng.choice((0.001, 0.05, 1.0))))]


# Maps


YAML = "image: map.{kind}\nresolution: {resolution}\norigin: {origin}\nnegate: 0\n"


def _png(width: int, height: int, rows: bytes) -> bytes:
    def part(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = part(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + packed + part(b"IEND", b"")


def _saved_map(rng: random.Random, folder: Path) -> Case:
    """map.yaml with a picture that claims more than it holds, or unpacks to more than it is."""
    resolution = rng.choice(("0.05", "0", "-1", "1e-9", "nan", "inf", "1e400", "0x1", "five"))
    origin = rng.choice(("[0, 0, 0]", "[nan, 0, 0]", "[1e300, 0, 0]", "[]", "[0]", "[[[0]]]", "x"))
    if rng.random() < 0.5:
        resolution, origin = "0.05", "[0, 0, 0]"
    bomb = rng.choice(("pgm-head", "pgm-text", "png-head", "png-bomb", "png-noise", "yaml", "link"))
    kind = bomb[:3] if bomb[:3] in ("pgm", "png") else "pgm"
    text, image = (
        YAML.format(kind=kind, resolution=resolution, origin=origin),
        b"P5 2 2 255\n\0\0\0\0",
    )
    if bomb == "pgm-head":
        size = rng.choice(((10**9, 10**9), (4096, 4096), (1 << 31, 1), (0, 0), (-1, 5)))
        image = b"P5\n%d %d\n255\n" % size + bytes(1000)
    elif bomb == "pgm-text":
        image = b"P2 4000 4000 65535\n" + b"0 " * rng.choice((10, 10**6))
    elif bomb == "png-head":
        image = _png(rng.choice((10**9, 65_000, 4000)), rng.choice((10**9, 4000)), bytes(1000))
    elif bomb == "png-bomb":
        image = _png(4000, 4000, rng.choice((b"\0", b"\xff")) * 4001 * rng.choice((4000, 100_000)))
    elif bomb == "png-noise":
        cells = _cells(rng, 4000, 1000)
        shades = bytes(254 if cell == 0 else 0 for cell in cells)
        image = _png(
            4000, 1000, b"".join(b"\0" + shades[k : k + 4000] for k in range(0, len(shades), 4000))
        )
    elif bomb == "yaml":
        text = rng.choice(
            (text * 400, "image: " + "../" * 2000 + "dev/zero\n" + text[16:], text + "\0")
        )
    else:
        text = text.replace(
            "map.pgm", rng.choice(("/dev/zero", "fifo", "loop.pgm", ".", "/proc/self/mem"))
        )
        (folder / "loop.pgm").symlink_to("loop.pgm")
    (folder / f"map.{kind}").write_bytes(image)
    (folder / "map.yaml").write_text(text)
    return Case(folder / "map.yaml", None, None, f"a saved map: {bomb}", "grid")


# Transforms and poses


def _transforms(rng: random.Random, folder: Path) -> Case:
    """Frames in circles, frames of themselves, long chains, and floods of frames."""
    how, count = rng.choice(("circle", "self", "chain", "flood")), rng.choice((10, 1000, 30_000))
    pairs = [("odom", "base_link"), ("base_link", "laser")]
    pairs += {
        "circle": [
            ("a", "b"),
            ("b", "c"),
            ("c", "a"),
            ("laser", "base_link"),
            ("base_link", "odom"),
        ],
        "self": [("odom", "odom"), ("base_link", "base_link"), ("laser", "laser"), ("", "")],
        "chain": [(f"f{k}", f"f{k + 1}") for k in range(count)] + [("laser", "f0")],
        "flood": [(rng.choice(("base_link", f"f{k}")), f"g{k}") for k in range(count)],
    }[how]
    body = Cdr().put("I", len(pairs))
    for parent, child in pairs:
        body.header(START_NS, parent).text(child).put("d", 0.1, 0, 0, 0, 0, 0, 1)
    frame = rng.choice(("laser", "a", f"f{count}", "g1"))
    scans = [(t, _scan(t, _floats(2.0) * 300, frame=frame)) for t in _times(150)]
    topics = {
        "/odom": ("nav_msgs/msg/Odometry", "cdr", list(_odometry())),
        "/scan": ("sensor_msgs/msg/LaserScan", "cdr", scans),
        "/tf_static": ("tf2_msgs/msg/TFMessage", "cdr", [(START_NS, body.done())]),
    }
    return Case(_log(folder / "run.mcap", topics), None, None, f"transforms: {how} of {len(pairs)}")


def _poses(rng: random.Random, folder: Path) -> Case:
    """Odometry of absurd numbers, whole or now and then, and detections that are no better."""
    some = rng.sample((*ABSURD, 1e300, 5e-324, 1.0), rng.randint(1, 5))
    share = rng.choice((0.01, 0.5, 1.0))
    good = list(_odometry(2000))
    bad = list(_odometry(2000, lambda _: rng.choice(some)))
    odometry = [b if rng.random() < share else g for g, b in zip(good, bad, strict=True)]
    if rng.random() < 0.3:
        count, drive = rng.choice((1, 2, 3)), odometry
        odometry = (
            [drive[rng.randrange(len(drive))] for _ in drive] if count == 1 else drive[:count]
        )
    seen = []
    for t, _ in good[::50]:
        poses = [rng.choice(some) if rng.random() < share else 0.5 for _ in range(21)]
        body = Cdr().header(t, rng.choice(("base_link", "odom", "", "x" * 5000))).put("I", 3)
        seen.append((t, body.put("d", *poses).done()))
    topics = {
        "/odom": ("nav_msgs/msg/Odometry", "cdr", odometry),
        "/junctions": ("geometry_msgs/msg/PoseArray", "cdr", seen),
    }
    return Case(_log(folder / "run.mcap", topics), None, None, "poses of absurd numbers")


def _wild_clock(rng: random.Random, folder: Path) -> Case:
    """Messages of a sound run under times that run backwards, jump by years, or stand."""
    logs, out = writers(), []
    step = rng.choice((-SECOND, 0, 365 * 86400 * SECOND, -(10**17), 10**18))
    for k, message in enumerate(logs.drive()):
        shift = step * (k // rng.choice((1, 10, 100)))
        time_ns = min(max(message.log_ns + shift, 0), (1 << 63) - 1)
        out.append(replace(message, log_ns=time_ns))
    return Case(logs.mcap(folder / "run.mcap", out), None, None, "clocks that jump")


LASER = "sensor_msgs/msg/LaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
GRID = "nav_msgs/msg/OccupancyGrid"

CASES: dict[str, Generator] = {
    "scan-counts": _sensor(LASER, _false_counts, "scans that declare other numbers of ranges"),
    "scan-angles": _sensor(LASER, _absurd_angles, "scans of absurd geometries"),
    "scan-ranges": _sensor(LASER, _absurd_ranges, "scans of absurd ranges"),
    "cloud-sizes": _sensor(CLOUD, _cloud_sizes, "clouds of false sizes and strides"),
    "cloud-fields": _sensor(CLOUD, _cloud_fields, "clouds of false fields"),
    "grid-large": _sensor(GRID, _grid_large, "grids of up to 16 million cells"),
    "map-saved": _saved_map,
    "tf-frames": _transforms,
    "odometry-absurd": _poses,
    "clock-wild": _wild_clock,
}
