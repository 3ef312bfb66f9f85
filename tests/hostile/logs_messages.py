"""Messages and schemas of other encodings: protobuf and JSON, recursive, huge, foreign, absurd."""

from __future__ import annotations

import random
import struct
from pathlib import Path
from typing import Any

from case import Case, Generator, writers

MIB = 1 << 20
GOOD = 200

POSE, POSES = "foxglove.PoseInFrame", "foxglove.PosesInFrame"


def _write(
    path: Path, encoding: str, schemas: dict[str, tuple[str, str, bytes]], bad: list[bytes]
) -> tuple[Path, int]:
    """A log of sound messages, between them bad ones; schemas: name, encoding, text by topic.

    Returns how many sound messages there are.
    """
    from mcap.writer import CompressionType, Writer

    logs = writers()
    messages = logs.drive(GOOD)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("", "attack")
        channel = {}
        for topic, (name, kind, text) in schemas.items():
            schema = writer.register_schema(name, kind, text)
            channel[topic] = writer.register_channel(topic, encoding, schema)
        for k, message in enumerate(messages):
            raw = logs.payload(message, encoding, None)
            writer.add_message(channel[message.topic], message.log_ns, raw, message.log_ns)
            if bad and k % 10 == 0:
                raw = bad[k // 10 % len(bad)]
                writer.add_message(channel["/odom"], message.log_ns, raw, message.log_ns)
        writer.finish()
    return path, len(messages)


def _usual(encoding: str) -> dict[str, tuple[str, str, bytes]]:
    kind = {"json": "jsonschema", "protobuf": "protobuf"}[encoding]
    return {"/odom": (POSE, kind, b""), "/junctions": (POSES, kind, b"")}


# Protobuf


def _part(number: int, raw: bytes) -> bytes:
    return bytes(writers().field(number, raw))


def _protobuf_bytes(rng: random.Random, folder: Path) -> Case:
    """Messages that nest, repeat, end early or never."""
    tags = (writers().varint(n << 3 | 1) for n in (1, 2, 3))
    point = b"".join(tag + struct.pack("<d", 1e308) for tag in tags)
    pose = _part(1, point) + _part(2, point)
    deep = b""
    for _ in range(2000):
        deep = _part(3, deep)
    every = (
        _part(3, pose) * rng.choice((10, 60_000, 100_000)),
        deep,
        b"\x1a\xff\xff\xff\xff\xff\xff\xff\xff\x7f",
        b"\x80" * 10_000,
        b"\x0b" * 100,
        b"\x08\1" * 100_000,
        _part(2, b"f" * MIB) + _part(3, pose),
        rng.randbytes(500),
        b"",
    )
    log, count = _write(folder / "run.mcap", "protobuf", _usual("protobuf"), rng.sample(every, 4))
    return Case(log, count, None, "protobuf of absurd bytes")


# JSON


def _numbers(rng: random.Random) -> str:
    return rng.choice(
        ("1e400", "-1e400", "9" * 4000, "9" * 6000, "1" + "0" * 400, "NaN", "Infinity", "1e-400")
    )


def _pose(rng: random.Random) -> str:
    values = [
        rng.choice((_numbers(rng), "1", '"1"', "null", "true", "[]", "{}")) for _ in "xyzxyzw"
    ]
    at = ", ".join(f'"{n}": {v}' for n, v in zip("xyz", values, strict=False))
    turn = ", ".join(f'"{n}": {v}' for n, v in zip("xyzw", values[3:], strict=False))
    return f'{{"position": {{{at}}}, "orientation": {{{turn}}}}}'


def _json_bad(rng: random.Random) -> list[bytes]:
    levels = rng.choice((500, 900, 5000, 100_000))
    stamp = f'{{"sec": {_numbers(rng)}, "nsec": {_numbers(rng)}}}'
    many = ", ".join([_pose(random.Random(1))] * rng.choice((10, 30_000)))
    texts = (
        "[" * levels,
        "[" * levels + "]" * levels,
        '{"pose":' * levels + "1" + "}" * levels,
        '{"pose": ' + _pose(rng) + "}",
        f'{{"timestamp": {stamp}, "frame_id": "odom", "pose": {_pose(rng)}}}',
        f'{{"poses": [{many}]}}',
        '{"timestamp": ' + _numbers(rng) + ', "pose": ' + _pose(random.Random(1)) + "}",
        '{"frame_id": "' + "\\ud800" * rng.choice((1, 100_000)) + '", "pose": {}}',
        '{"frame_id": "' + "x" * MIB + '", "pose": {}}',
        "{" + ", ".join(f'"k{k}": {k}' for k in range(100_000)) + "}",
        '{"pose": 1, ' * 1000,
        "null",
        "1",
        '"text"',
        "",
        "\ufeff{}",
        " " * MIB,
        '{"transforms": [' + "{}, " * 1000 + "{}]}",
    )
    return [text.encode() for text in rng.sample(texts, 4)]


def _json_messages(rng: random.Random, folder: Path) -> Case:
    bad = _json_bad(rng)
    if rng.random() < 0.3:
        bad.append(rng.choice((b"\xff\xfe{\0}\0", b"\xff" * 100, b'{"pose": "\xed\xa0\x80"}')))
    log, count = _write(folder / "run.mcap", "json", _usual("json"), bad)
    return Case(log, count, None, "JSON nested, huge or absurd")


# Definitions of ROS


def _definitions(rng: random.Random, folder: Path) -> Case:
    """Definitions of odometry that are huge, or that no grammar takes."""
    from mcap.writer import CompressionType, Writer

    logs = writers()
    kind = rng.choice(("ros2msg", "ros2idl", "ros1msg", "omgidl", "flatbuffer", "x" * 1000))
    text = rng.choice(
        (
            "uint8 a\n" * 100_000,
            "uint8 " + "a" * MIB,
            "uint8[<=" + "9" * 5000 + "] a",
            "string a " + '"' * 10_000,
            "module a { " * 3000,
            "struct A { sequence<" * 2000,
            "# " + "comment " * 100_000,
            "(" * 5000,
            "int32 X=" + "9" * 10_000,
            "\u2028" * 1000,
            "\0" * 1000,
            "=" * 80 + "\nMSG: a/B\n" * 1000,
        )
    )
    messages, store = logs.drive(GOOD), logs.store_of(False)
    path = folder / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", "attack")
        channel: dict[str, Any] = {}
        for message in messages:
            if message.topic not in channel:
                schema = writer.register_schema(message.type_name, kind, text.encode())
                channel[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            raw = logs.payload(message, "cdr", store)
            writer.add_message(channel[message.topic], message.log_ns, raw, message.log_ns)
        writer.finish()
    return Case(path, None, None, f"a definition in {kind[:10]}")


CASES: dict[str, Generator] = {
    "protobuf-bytes": _protobuf_bytes,
    "json-messages": _json_messages,
    "ros-definitions": _definitions,
}
