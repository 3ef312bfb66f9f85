"""MCAP files (https://mcap.dev/spec), chunked or not, with or without index, whole or damaged."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...topology.arrays import IntArray
from .channels import NUMBERS, Channels
from .chunks import RECORD_BYTES, Chunk, ChunkedLog, ChunkIndex, Read, Scan
from .columns import column, gather, words
from .inflate import checksum
from .messages import (
    SCHEMA_BYTES,
    Block,
    Bytes,
    Channel,
    DamageError,
    Findings,
    Survey,
    Walking,
    normal_topic,
    normal_type,
    text,
)
from .source import SLAB_BYTES, FileSource, Source, open_source
from .walk import mcap_records

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 0x07, 0x08, 0x0B, 0x0F
PRIVATE = 0x80
"""Opcodes; from PRIVATE on they are anybody's."""

_IN_CHUNKS = frozenset({SCHEMA, CHANNEL, MESSAGE})
_NOT_IN_CHUNKS = frozenset(range(256)) - _IN_CHUNKS

_BEHIND = frozenset({CHUNK_INDEX, 0x0A, STATISTICS, 0x0D, 0x0E})
"""Records that stand behind the data."""

_FIXED = {FOOTER: 20, DATA_END: 4, 0x0E: 17}
"""Records of fixed length."""

RECORD_HEAD, MESSAGE_HEAD = 9, 22
"""Bytes of a record's opcode and length, and of a message before its payload."""

HEAD_BYTES = 64
"""Bytes of a record that are looked at first: they hold all lengths of chunks and messages."""

FOOTER_BYTES = RECORD_HEAD + 20 + len(MAGIC)

SUMMARY_BYTES = 1 << 26
"""Largest summary that is read; a chunk takes about 100 bytes in it."""

LARGEST_MESSAGE, LARGEST_RECORD = 1 << 32, 1 << 40
"""Larger ones are damage: lengths in ROS messages have 32 bits."""

DATA_END_HEAD = struct.pack("<BQ", DATA_END, 4)
"""Opcode and length of the record behind the data."""

CHAIN = 3
"""Records in a row that have to be plausible where reading goes on after damage."""

TRIES = 1 << 16
"""Places of one file that are looked at in search of such records, 10 µs each."""

_RECORD = struct.Struct("<BQ").unpack_from
_CHUNK = struct.Struct("<QQQII").unpack_from
_INDEX = struct.Struct("<HI").unpack_from
_U32, _U64 = (struct.Struct(f).unpack_from for f in ("<I", "<Q"))


_KNOWN = np.array([0 < op <= DATA_END or op >= PRIVATE for op in range(256)])
"""Which opcodes a record may have."""


class McapFile(ChunkedLog):
    """One MCAP file of any profile."""

    @cached_property
    def summary(self) -> Summary | None:
        """The summary section, None unless it is complete and its checksum right."""
        with open_source(self.path) as source:
            try:
                return _read_summary(source)
            except (DamageError, struct.error):
                return None

    def _chunks(self) -> ChunkIndex | str:
        if self.summary is None:
            return "it has no index, or a damaged one"
        return self.summary.chunks

    def _scan(
        self, source: Source, channels: Channels, findings: Findings, by_index: bool
    ) -> McapScan:
        return McapScan(source, channels, findings, self.summary, by_index)

    def survey(self, exact: bool = False) -> Survey | None:
        """Message counts from the statistics record of a valid summary."""
        found = self.summary
        if found is None or not found.counts or not found.counts.keys() <= found.channels.keys():
            return None
        counts: dict[Channel, int] = {}
        for number, channel in found.channels.items():
            counts[channel] = counts.get(channel, 0) + found.counts.get(number, 0)
        return Survey(counts, *found.span_ns, found.checked)


class McapScan(Scan):
    """One scan of a file."""

    def __init__(
        self,
        source: Source,
        channels: Channels,
        findings: Findings,
        summary: Summary | None,
        by_index: bool,
    ) -> None:
        super().__init__(source, channels, findings)
        self._summary = summary
        self._definitions = Definitions(channels)
        self._tries = TRIES
        self._ended = self._complete = False
        if summary is None:
            self._read_behind_data()
        else:
            channels.take_index(summary.channels, believed=by_index)

    def _read_behind_data(self) -> None:
        """Read what a damaged summary repeats: the chunk that describes a channel first may be
        damaged as well, as where bytes are missing."""
        tail = self._source.copy(self._source.size - SLAB_BYTES, SLAB_BYTES)
        behind = tail.rfind(DATA_END_HEAD) + len(DATA_END_HEAD) + 4
        if behind > len(DATA_END_HEAD) + 4:
            data = np.frombuffer(tail, np.uint8)[behind:]
            where, _ = mcap_records(data)
            self._definitions.read(data, where[np.isin(data[where], (SCHEMA, CHANNEL))])

    def all(self) -> Iterator[Block]:
        """All messages of the file, record by record."""
        if self._source.copy(0, len(MAGIC)) != MAGIC:
            self.findings.note("the file does not begin with the MCAP magic")
        yield from super().all()
        self.findings.truncated |= not self._complete

    def _declared(self) -> Mapping[int, int]:
        return self._summary.counts if self._summary is not None else {}

    def _walk(self, position: int, stop: int) -> Iterator[Block]:
        position = max(position, len(MAGIC))
        while position + RECORD_HEAD <= stop:
            head = self._source.view(position, HEAD_BYTES).tobytes()
            op, length = _RECORD(head)
            end = position + RECORD_HEAD + length
            chunk = _chunk(head, position) if op == CHUNK else None
            if chunk is not None and end > stop == self._source.size:
                yield from self._cut(chunk)
                return
            misplaced = position > len(MAGIC) if op == HEADER else op in _BEHIND and not self._ended
            if end > stop or misplaced or not _plausible(head):
                position = yield from self._around_damage(position, stop)
                continue
            if op in _IN_CHUNKS:
                position = yield from self._loose(position, end, stop)
                continue
            if chunk is not None:
                yield from self._take(chunk)
            elif op == MESSAGE_INDEX and self._last is not None:
                number, entries = _INDEX(head, RECORD_HEAD)
                self._last.listed[number] = entries // 16
            elif op == DATA_END:
                yield from self._caught_up()
                self._check_data(position, _U32(head, RECORD_HEAD)[0])
                self._ended = True
            elif op == FOOTER and end + len(MAGIC) == self._source.size:
                self._complete = True
                if self._summary is None and _U64(head, RECORD_HEAD)[0]:
                    self.findings.note("the summary is damaged")
                return
            position = end
            self._source.passed(position)

    def _loose(self, position: int, end: int, stop: int) -> Walking:
        """Messages outside chunks, up to the next other record; returns its position."""
        yield from self._caught_up()
        need = end - position
        if need > RECORD_BYTES:
            _, number = self._head(self._source.view(position, HEAD_BYTES))
            if not self._channels.large(number, need):
                return end
        data = self._source.view(position, min(max(SLAB_BYTES, need), stop - position))
        where, size = mcap_records(data, _NOT_IN_CHUNKS)
        yield from self._blocks(data[:size], where)
        self._source.passed(position + size)
        return position + size

    def _next_record(self, read: Read, position: int, stop: int) -> int | None:
        while position + RECORD_HEAD <= stop:
            raw = np.frombuffer(read(position, SLAB_BYTES + RECORD_HEAD), np.uint8)
            count = min(len(raw) - RECORD_HEAD + 1, stop - position)
            starts = _KNOWN[raw[:count]]
            for k in (6, 7, 8):  # the upper bytes of the length
                starts &= raw[k : k + count] == 0
            at = starts.nonzero()[0]
            behind = at + RECORD_HEAD + words(raw, "<i8", at + 1)
            follows = (behind >= len(raw)) | _KNOWN[raw[np.minimum(behind, len(raw) - 1)]]
            for start in at[follows & (behind <= stop - position)].tolist():
                self._tries -= 1
                if self._tries < 0:
                    return None
                if _leads_on(read, position + start, stop):
                    return int(position + start)
            position += count
        return None

    def _plausible(self, position: int) -> bool:
        return _plausible(self._source.copy(position, HEAD_BYTES))

    def _check_data(self, position: int, expected: int) -> None:
        """Compare the checksum of the data section, if there is one."""
        found = 0
        for at in range(0, position, SLAB_BYTES) if expected else ():
            found = checksum(self._source.view(at, min(SLAB_BYTES, position - at)).data, found)
        if found != expected:
            self.findings.note("the checksum (CRC) of the data section is wrong")

    def _records(self, data: Bytes) -> tuple[IntArray, int]:
        return mcap_records(data, _NOT_IN_CHUNKS)

    def _head(self, data: Bytes) -> tuple[int, int]:
        if len(data) < RECORD_HEAD + MESSAGE_HEAD or int(data[0]) not in _IN_CHUNKS:
            return 0, NUMBERS
        op, length = _RECORD(data.data)
        number = int(data[RECORD_HEAD]) | int(data[RECORD_HEAD + 1]) << 8
        return RECORD_HEAD + int(length), number if op == MESSAGE else NUMBERS

    def _blocks(self, data: Bytes, where: IntArray) -> Iterator[Block]:
        op = data[where]
        is_message = op == MESSAGE
        if not is_message.all():
            damaged = self._definitions.read(data, where[~is_message])
            self.findings.unreadable_bytes += damaged
            where = where[is_message]
        length = words(data, "<i8", where + 1)
        if len(where) and length.min() < MESSAGE_HEAD:
            self.findings.unreadable_bytes += int(length[length < MESSAGE_HEAD].sum())
            where = where[length >= MESSAGE_HEAD]
        if len(where) == 0:
            return
        heads = gather(data, where, RECORD_HEAD + 14)
        size = column(heads, "<i8", 1) - MESSAGE_HEAD
        number = column(heads, "<u2", RECORD_HEAD)
        log_time = column(heads, "<i8", RECORD_HEAD + 6)
        start = where + (RECORD_HEAD + MESSAGE_HEAD)
        for sink, rows in self._channels.met(number, log_time):
            yield Block(data, sink, log_time[rows], start[rows], size[rows])


def _plausible(head: bytes) -> bool:
    """Whether a record may begin with these bytes, up to HEAD_BYTES of them."""
    if len(head) < RECORD_HEAD:
        return False
    op, length = _RECORD(head)
    if (op == CHUNK) != (_chunk(head, 0) is not None):
        return False  # or a chunk whose opcode is damaged
    if op in _FIXED:
        return bool(length == _FIXED[op])
    if op == MESSAGE:
        return bool(MESSAGE_HEAD <= length < LARGEST_MESSAGE)
    if op == MESSAGE_INDEX:
        return len(head) >= RECORD_HEAD + 6 and bool(_INDEX(head, RECORD_HEAD)[1] + 6 == length)
    return bool(_KNOWN[op] and length < LARGEST_RECORD)


def _leads_on(read: Read, position: int, stop: int) -> bool:
    """Whether plausible records follow each other from a position on."""
    for _ in range(CHAIN):
        head = read(position, HEAD_BYTES)
        if not _plausible(head):
            return False
        position += RECORD_HEAD + int(_RECORD(head)[1])
        if position >= stop:
            return position == stop
    return True


def _chunk(head: bytes, position: int) -> Chunk | None:
    """The chunk whose record begins with `head`, None if its lengths contradict each other."""
    fixed = RECORD_HEAD + 32
    if len(head) < fixed:
        return None
    _, length = _RECORD(head)
    _, _, size, crc, named = _CHUNK(head, RECORD_HEAD)
    data_at = fixed + named + 8
    if data_at > len(head):
        return None
    (data_size,) = _U64(head, data_at - 8)
    if data_at + data_size != RECORD_HEAD + length or size >= LARGEST_RECORD:
        return None
    name = text(head[fixed : fixed + named])
    return Chunk(name, position + data_at, data_size, size, crc, {})


# Schemas and channels


class Definitions:
    """The schemas and channels of one file as they are read; writers repeat them in every chunk.

    Of every number the first description that can be read counts.
    """

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._schemas: dict[int, tuple[str, str, bytes]] = {0: ("", "", b"")}
        self._length = np.zeros(2 * NUMBERS, np.int64)

    def read(self, data: Bytes, where: IntArray) -> int:
        """Read the new ones among records at `where`; returns the bytes of those that are damaged:
        that cannot be read, or are of another length than before."""
        where = where[where + RECORD_HEAD + 2 <= len(data)]
        number = words(data, "<u2", where + RECORD_HEAD) + NUMBERS * (data[where] == SCHEMA)
        size = words(data, "<i8", where + 1)
        first = np.unique(number, return_index=True)[1]
        fresh = np.sort(first[self._length[number[first]] == 0])
        damaged = 0
        for place, key in zip(where[fresh].tolist(), number[fresh].tolist(), strict=True):
            op, length = _RECORD(data.data, place)
            body = data[place + RECORD_HEAD : place + RECORD_HEAD + length].tobytes()
            try:
                self._length[key] = length if self._add(op, body) else 0
            except (DamageError, struct.error):
                damaged += len(body)
        known = self._length[number]
        return damaged + int(size[(known > 0) & (size != known)].sum())

    def _add(self, op: int, body: bytes) -> bool:
        """Read a schema, or a channel if its schema is known."""
        if op == SCHEMA:
            (name, encoding, definition), _ = _strings(body, 2, 3)
            if len(definition) > SCHEMA_BYTES or not self._channels.has_room(len(definition)):
                definition = b""
            self._schemas[_number(body)] = normal_type(text(name)), text(encoding), definition
            return True
        (topic, encoding), _ = _strings(body, 4, 2)
        schema = self._schemas.get(_number(body[2:]))
        if schema is None:
            return False
        type_name, kind, text_of = schema
        channel = Channel(normal_topic(text(topic)), type_name, text(encoding), text_of, kind)
        self._channels.describe(_number(body), channel)
        return True


def _number(body: bytes) -> int:
    return int.from_bytes(body[:2], "little")


def _strings(body: bytes, at: int, count: int) -> tuple[list[bytes], int]:
    """Strings with their lengths in front of them, and where they end; raises DamageError."""
    out = []
    for _ in range(count):
        (size,) = _U32(body, at)
        if at + 4 + size > len(body):
            raise DamageError("a record ends too early")
        out.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    return out, at


# The summary


class Summary(NamedTuple):
    """The contents of a summary section.

    channels: those whose schema it repeats, or without one; counts: messages by channel, empty
    without statistics; checked: whether a checksum covers it; chunks: their index, or why there is
    none.
    """

    channels: Mapping[int, Channel]
    counts: dict[int, int]
    span_ns: tuple[int, int]
    checked: bool
    chunks: ChunkIndex | str


def _read_summary(source: Source) -> Summary | None:
    """The summary of a file, None if there is none; raises DamageError and struct.error."""
    tail = source.view(source.size - FOOTER_BYTES, FOOTER_BYTES).tobytes()
    if source.size < FOOTER_BYTES + len(MAGIC) or not tail.endswith(MAGIC):
        return None
    op, length, start, _, crc = struct.unpack_from("<BQQQI", tail)
    footer = source.size - FOOTER_BYTES
    if op != FOOTER or length != 20 or not 0 < start <= footer or footer - start > SUMMARY_BYTES:
        return None
    raw = source.copy(start, footer - start + RECORD_HEAD + 16)
    if crc and checksum(raw) != crc:
        return None
    data = np.frombuffer(raw, np.uint8)[: footer - start]
    where, stop = mcap_records(data)
    if stop != len(data):
        return None
    op = data[where]
    channels = Channels(lambda _: 0, Findings())
    Definitions(channels).read(data, where[(op == SCHEMA) | (op == CHANNEL)])
    counts, span = _statistics(data, where[op == STATISTICS])
    index = _chunk_index(data, where[op == CHUNK_INDEX], start, channels.described, counts)
    if not crc and isinstance(index, ChunkIndex) and isinstance(source, FileSource):
        index = "its index has no checksum"
    return Summary(channels.described, counts, span, bool(crc), index)


def _statistics(data: Bytes, where: IntArray) -> tuple[dict[int, int], tuple[int, int]]:
    """Messages per channel, empty if they contradict each other; first and last log time [ns]."""
    if len(where) == 0:
        return {}, (0, 0)
    at = int(where[-1]) + RECORD_HEAD
    total, first, last, size = struct.unpack_from("<Q18xQQI", data.data, at)
    if size % 10 or size > 10 * NUMBERS:
        raise DamageError("the statistics are cut, or count more channels than there can be")
    counts = dict(struct.iter_unpack("<HQ", data[at + 46 : at + 46 + size].tobytes()))
    return (counts if sum(counts.values()) == total else {}), (first, last)


CHUNK_INDEX_HEAD, CHUNK_INDEX_TAIL = RECORD_HEAD + 36, 28
"""Least bytes of a chunk index before its list of channels, with the positions of their message
indexes, and behind it."""


def _chunk_index(
    data: Bytes,
    where: IntArray,
    start: int,
    channels: Mapping[int, Channel],
    statistics: Mapping[int, int],
) -> ChunkIndex | str:
    """The chunks of a file with their message counts, or why they are not known.

    A chunk index lists the positions of the chunk's message indexes, one for each channel. These
    take 15 bytes and 16 for each message, so that their distances give the counts. They are
    believed if they fill the gaps between chunks and add up to the statistics for every channel:
    then nothing lies outside of chunks.
    """
    if len(where) == 0 or not statistics:
        return "its index lists no chunks or counts no messages"
    length = words(data, "<i8", where + 1)
    if length.min() < CHUNK_INDEX_HEAD - RECORD_HEAD + CHUNK_INDEX_TAIL:
        raise DamageError("a chunk index is cut")
    where = where[np.argsort(words(data, "<i8", where + RECORD_HEAD + 16), kind="stable")]
    first_ns, last_ns, begin, size = (
        words(data, "<i8", where + RECORD_HEAD + at) for at in (0, 8, 16, 24)
    )
    listed = words(data, "<u4", where + RECORD_HEAD + 32).astype(np.int64)
    if (listed % 10).any() or (where + CHUNK_INDEX_HEAD + listed + 8 > len(data)).any():
        raise DamageError("a chunk index contradicts itself")
    end = begin + size
    if begin.min() < 0 or (size <= 0).any() or end.max() > start or (begin[1:] < end[:-1]).any():
        return "its index contradicts itself"
    count = listed // 10
    chunk = np.repeat(np.arange(len(begin)), count)
    within = np.arange(len(chunk)) - np.repeat(np.cumsum(count) - count, count)
    at = where[chunk] + CHUNK_INDEX_HEAD + 10 * within
    channel = words(data, "<u2", at).astype(np.int64)
    # Behind the list stands how long all message indexes of the chunk are together.
    stop = end + words(data, "<i8", where + CHUNK_INDEX_HEAD + listed)
    messages = _distances(chunk, words(data, "<i8", at + 2), stop)
    index = ChunkIndex(begin, end, first_ns, last_ns, chunk, channel, messages)
    if not channels.keys() >= {*statistics, *np.unique(channel).tolist()}:
        return "its index does not describe all channels"
    held = index.counts(np.ones(len(begin), bool))
    if held != {number: count for number, count in statistics.items() if count}:
        return "its index does not say which chunk holds which messages"
    return index


def _distances(chunk: IntArray, at: IntArray, stop: IntArray) -> IntArray:
    """(k,) entries of the message indexes at some positions; stop: (c,) where those of a chunk
    end."""
    order = np.lexsort((at, chunk))
    behind = np.append(at[order][1:], 0)
    last = np.append(chunk[1:] != chunk[:-1], True)[: len(chunk)]
    behind = behind[: len(chunk)]
    behind[last] = stop[chunk[last]]
    length = np.empty_like(at)
    length[order] = behind - at[order] - (RECORD_HEAD + 6)
    return np.where((length >= 0) & (length % 16 == 0), length // 16, 0)
