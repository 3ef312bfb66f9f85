"""Logs that are whole and follow their format, but are written as few recorders write them."""

from __future__ import annotations

import struct
import zlib

import pytest

from topobatch.ingest.reading import ReadSettings, inspect_log, read_run

WHOLE = (300, 30)
NO_MESSAGE = ((1 << 64) - 1, 0)
"""First and last time that the C++ writer gives a chunk without messages."""


def said(run):
    return run.source["odometry"]["messages"], run.source["junctions"]["messages"]


def record(op, body):
    return bytes([op]) + struct.pack("<Q", len(body)) + body


def string(text):
    return struct.pack("<I", len(text)) + text.encode()


def chunk(records, span):
    head = struct.pack("<QQQI", *span, len(records), zlib.crc32(records))
    return record(6, head + string("") + struct.pack("<Q", len(records)) + records)


def test_chunks_that_only_describe_channels_are_no_damage(logs, tmp_path):
    """So the C++ writer closes a chunk where the first message of a channel would overflow it."""
    drive, store = logs.drive(), logs.store_of(False)
    data = b"\x89MCAP0\r\n" + record(1, string("ros2") + string("libmcap"))
    for number, topic in enumerate(("/odom", "/junctions"), 1):
        mine = [message for message in drive if message.topic == topic]
        type_name = mine[0].type_name
        text, _ = store.generate_msgdef(type_name, ros_version=2)
        numbers = struct.pack("<H", number), struct.pack("<HH", number, number)
        schema = record(3, numbers[0] + string(type_name) + string("ros2msg") + string(text))
        channel = record(4, numbers[1] + string(topic) + string("cdr") + string(""))
        heads = (struct.pack("<HIQQ", number, 0, m.log_ns, m.log_ns) for m in mine)
        payloads = (logs.payload(message, "cdr", store) for message in mine)
        messages = (record(5, a + b) for a, b in zip(heads, payloads, strict=True))
        data += chunk(schema + channel, NO_MESSAGE)
        data += chunk(b"".join(messages), (mine[0].log_ns, mine[-1].log_ns))
    data += chunk(b"", NO_MESSAGE)
    data += record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    path = tmp_path / "run.mcap"
    path.write_bytes(data + b"\x89MCAP0\r\n")
    run = read_run(path, ReadSettings(strict=True))
    assert (said(run), run.warnings) == (WHOLE, ())


@pytest.mark.parametrize("channels", [True, False])
@pytest.mark.parametrize("statistics", [True, False])
def test_a_summary_need_not_repeat_schemas(logs, tmp_path, channels, statistics):
    options = {"repeat_channels": channels, "use_statistics": statistics}
    path = logs.mcap(tmp_path / "run.mcap", logs.drive(), repeat_schemas=False, **options)
    run = read_run(path)
    assert (said(run), run.warnings) == (WHOLE, ())
    used = {topic.use: topic.messages for topic in inspect_log(path).topics}
    assert used == {"odometry": 300, "junctions": 30}


def test_a_chunk_of_images_may_describe_other_channels(logs, tmp_path):
    """Where the summary does not repeat them, such a chunk is not stepped over."""
    from mcap.writer import Writer

    drive, store = logs.drive(), logs.store_of(False)
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1000, repeat_channels=False, repeat_schemas=False)
        writer.start("ros2", "test")
        image = writer.register_channel("/image", "cdr", 0)
        for _ in range(100):
            writer.add_message(image, logs.START_NS, bytes(2000), logs.START_NS)
        channels = {}
        for message in drive:
            if message.topic not in channels:
                schema = logs._schema(writer, message, "cdr", store, True)
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
                writer.add_message(image, message.log_ns, bytes(2000), message.log_ns)
            raw = logs.payload(message, "cdr", store)
            writer.add_message(channels[message.topic], message.log_ns, raw, message.log_ns)
        writer.finish()
    run = read_run(path)
    assert (said(run), run.warnings) == (WHOLE, ())


def test_messages_of_a_second_channel_without_a_decoder_are_counted(logs, tmp_path):
    from mcap.writer import Writer

    drive, store = logs.drive(), logs.store_of(False)
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        channels = {}
        for number, message in enumerate(drive):
            encoding = "cbor" if message.topic == "/odom" and number % 3 == 0 else "cdr"
            key = message.topic, encoding
            if key not in channels:
                schema = logs._schema(writer, message, "cdr", store, True)
                channels[key] = writer.register_channel(message.topic, encoding, schema)
            raw = logs.payload(message, "cdr", store)
            writer.add_message(channels[key], message.log_ns, raw, message.log_ns)
        writer.finish()
    lost = sum(m.topic == "/odom" and k % 3 == 0 for k, m in enumerate(drive))
    run = read_run(path)
    assert (said(run), len(run.odometry)) == (WHOLE, 300 - lost)
    assert run.warnings == (f"/odom: {lost} messages could not be decoded; left out",)
