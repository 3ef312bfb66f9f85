"""Decoding scans from the blocks of a container, with bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .clouds import Cloud, json_cloud, object_cloud, protobuf_cloud, wire_cloud
from .inflate import SLICE_BYTES, unpacked
from .laser_wire import LaserDecoder
from .messages import LATEST_NS, Block, Bytes, Channel, DamageError
from .scan_objects import ObjectScanDecoder, json_scan, object_scan, protobuf_scan
from .scan_rows import RawScans, ScanDecoder
from .schema import as_expected, object_decoder
from .topics import CLOUD_BYTES, CLOUD_KINDS, SCAN_KINDS

Slicer = Callable[[Cloud], RawScans]


def scan_decoder(channel: Channel, slicer: Slicer) -> ScanDecoder:
    """The decoder for a channel of scans or point clouds; raises DamageError if there is none.

    slicer: makes a scan of a cloud.
    """
    if channel.type_name in CLOUD_KINDS:
        return _cloud_decoder(channel, slicer)
    kind = SCAN_KINDS.get(channel.type_name)
    if channel.encoding in ("cdr", "ros1"):
        if kind is not None and as_expected(channel, kind):
            return LaserDecoder(kind, channel.encoding == "ros1")
        decode = object_decoder(channel)
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
    decode = object_decoder(channel)
    return ObjectScanDecoder(lambda raw: slicer(object_cloud(decode(raw))))


class CloudDecoder(ObjectScanDecoder):
    """Decodes clouds in CDR or ROS 1's encoding, without a copy of the message."""

    LONGEST = CLOUD_BYTES

    def _parsed(self, message: Bytes) -> RawScans:
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
        self.messages += len(block.start)
        # Cut where the bytes so far fill another slice.
        filled = (np.cumsum(block.size) - block.size) // SLICE_BYTES
        for rows in np.split(np.arange(len(filled)), np.flatnonzero(np.diff(filled)) + 1):
            for part, failed in (
                unpacked(block.rows(rows)) if self._cdr else ((block.rows(rows), 0),)
            ):
                self._unpacked += failed
                log_ns = np.clip(part.log_time_ns, 0, LATEST_NS - 1)
                for scans in self._decoder.decode(part.data, part.start, part.size):
                    yield TimedScans(scans, log_ns[scans.message])
