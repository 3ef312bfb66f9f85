"""Decoding scans from the blocks of a container, with bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .clouds import Cloud, json_cloud, object_cloud, protobuf_cloud, wire_cloud
from .columns import words
from .inflate import ZSTD_MAGIC, inflate_message
from .laser_wire import LaserDecoder
from .limits import CLOUD_BYTES
from .messages import LATEST_NS, Block, Bytes, Channel, DamageError
from .scan_objects import ObjectScanDecoder, OneScan, json_scan, object_scan, protobuf_scan
from .scan_rows import RawScans, ScanDecoder
from .schema import UnreadableError, as_expected, object_decoder
from .topics import CLOUD_KINDS, SCAN_KINDS

SLICE_BYTES = 1 << 22
"""Bytes of a block decoded at once: blocks may be large, and decoding needs several copies."""

_MAGIC = int.from_bytes(ZSTD_MAGIC, "little")

Slicer = Callable[[Cloud], RawScans]


def scan_decoder(channel: Channel, slicer: Slicer) -> ScanDecoder:
    """The decoder for a channel of scans or point clouds; raises DamageError if there is none.

    slicer: makes a scan of a cloud.
    """
    if channel.type_name in CLOUD_KINDS:
        return _cloud_decoder(channel, slicer)
    kind = SCAN_KINDS.get(channel.type_name)
    ros1 = channel.encoding == "ros1"
    if channel.encoding in ("cdr", "ros1"):
        if kind is not None and as_expected(channel, kind):
            return LaserDecoder(kind, ros1)
        try:
            decode = object_decoder(channel)
        except UnreadableError:
            if kind is None:
                raise
            # The type's name is known and trusted, as in a log without definitions.
            return LaserDecoder(kind, ros1)
        return ObjectScanDecoder(lambda raw: object_scan(decode(raw)))
    if channel.encoding == "json":
        return ObjectScanDecoder(json_scan)
    if channel.encoding == "protobuf" and channel.type_name == "foxglove.LaserScan":
        return ObjectScanDecoder(protobuf_scan)
    raise DamageError(f"messages are encoded as {channel.encoding[:40]!r}, which is not known")


def _cloud_decoder(channel: Channel, slicer: Slicer) -> ScanDecoder:
    ros1 = channel.encoding == "ros1"
    foxglove = channel.type_name.startswith("foxglove")
    if channel.encoding == "json":
        return ObjectScanDecoder(lambda raw: slicer(json_cloud(raw)))
    if channel.encoding == "protobuf" and foxglove:
        return ObjectScanDecoder(lambda raw: slicer(protobuf_cloud(raw)))
    if channel.encoding not in ("cdr", "ros1"):
        raise DamageError(f"clouds encoded as {channel.encoding[:40]!r} are not read")
    if not foxglove and as_expected(channel, "cloud"):
        return CloudDecoder(lambda raw: slicer(wire_cloud(raw, ros1)))
    try:
        decode = object_decoder(channel)
    except UnreadableError:
        if foxglove:
            raise
        return CloudDecoder(lambda raw: slicer(wire_cloud(raw, ros1)))
    return ObjectScanDecoder(lambda raw: slicer(object_cloud(decode(raw))))


class CloudDecoder(ObjectScanDecoder):
    """Decodes clouds in CDR or ROS 1's encoding, without a copy of the message."""

    LONGEST = CLOUD_BYTES

    def _parsed(self, message: Bytes) -> RawScans | OneScan:
        return self._parse(message.data)


class TimedScans(NamedTuple):
    """Scans with their log times log_ns (n,)."""

    scans: RawScans
    log_ns: IntArray


class ScanIntake:
    """Decodes the blocks of one channel. messages: their number; failed: those that could not be
    decoded."""

    def __init__(self, channel: Channel, slicer: Slicer) -> None:
        self._decoder = scan_decoder(channel, slicer)
        self._cdr = channel.encoding == "cdr"
        self._unpacked = 0
        self.messages = 0

    @property
    def failed(self) -> int:
        """Number of messages that could not be decoded."""
        return self._decoder.failed + self._unpacked

    @property
    def reason(self) -> str:
        """Why the first of these could not be decoded."""
        return self._decoder.reason

    def take(self, block: Block) -> Iterator[TimedScans]:
        """The scans of a block, in order."""
        data, _, log_ns, start, size = block
        self.messages += len(start)
        log_ns = np.clip(log_ns, 0, LATEST_NS - 1)
        # Cut where the bytes so far fill another slice.
        filled = (np.cumsum(size) - size) // SLICE_BYTES
        for part in np.split(np.arange(len(start)), np.flatnonzero(np.diff(filled)) + 1):
            yield from self._decoded(data, log_ns[part], start[part], size[part])

    def _decoded(
        self, data: Bytes, log_ns: IntArray, start: IntArray, size: IntArray
    ) -> Iterator[TimedScans]:
        if self._cdr and (size >= 9).all() and (words(data, "<u4", start) == _MAGIC).any():
            for inflated in self._inflated(data, start, size):
                yield from self._of(*inflated[1:], log_ns[inflated[0]])
        else:
            yield from self._of(data, start, size, log_ns)

    def _of(
        self, data: Bytes, start: IntArray, size: IntArray, log_ns: IntArray
    ) -> Iterator[TimedScans]:
        for scans in self._decoder.decode(data, start, size):
            yield TimedScans(scans, log_ns[scans.message])

    def _inflated(
        self, data: Bytes, start: IntArray, size: IntArray
    ) -> Iterator[tuple[IntArray, Bytes, IntArray, IntArray]]:
        """Messages that are zstd streams, inflated: their indices, a buffer, offsets and sizes."""
        out: dict[int, bytes] = {}
        for k, (at, length) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
            payload = data[at : at + length].tobytes()
            try:
                out[k] = inflate_message(payload) if payload[:4] == ZSTD_MAGIC else payload
            except DamageError:
                self._unpacked += 1
            if sum(map(len, out.values())) > SLICE_BYTES:
                yield _buffer(out)
                out = {}
        if out:
            yield _buffer(out)


def _buffer(payloads: dict[int, bytes]) -> tuple[IntArray, Bytes, IntArray, IntArray]:
    sizes = np.array([len(payload) for payload in payloads.values()], np.int64)
    whole = np.frombuffer(b"".join(payloads.values()), np.uint8)
    return np.array(list(payloads), np.int64), whole, np.cumsum(sizes) - sizes, sizes
