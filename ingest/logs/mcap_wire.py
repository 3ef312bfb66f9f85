"""Parsing of MCAP records field by field: schemas, channels, small heads."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, IntArray
from .described import SHORT_NAMES, TOO_MANY, Described, contradicts, short
from .messages import SCHEMA_BYTES, Bytes, Channel, DamageError, normal_topic, normal_type, text
from .spelling import nearest, spelled
from .tally import NUMBERS

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, STATISTICS, DATA_END = 0x07, 0x08, 0x09, 0x0B, 0x0F
"""Opcodes (https://mcap.dev/spec)."""

RECORD_HEAD = 9
"""Bytes of a record's opcode and length."""

MESSAGE_HEAD = 22
"""Bytes of a message record before its payload."""

_U16, _U32, _U64 = (struct.Struct(f).unpack_from for f in ("<H", "<I", "<Q"))


class Cursor:
    """Reads consecutive fields; raises DamageError at the end of the bytes."""

    def __init__(self, data: Bytes) -> None:
        self._data = data.tobytes()
        self.position = 0

    def take(self, length: int) -> bytes:
        """The next `length` bytes."""
        if length > len(self._data) - self.position:
            raise DamageError("a record ends too early")
        self.position += length
        return self._data[self.position - length : self.position]

    def u16(self) -> int:
        """The next two bytes as a number."""
        return int(_U16(self.take(2))[0])

    def u32(self) -> int:
        """The next four bytes as a number."""
        return int(_U32(self.take(4))[0])

    def u64(self) -> int:
        """The next eight bytes as a number."""
        return int(_U64(self.take(8))[0])

    def string(self) -> str:
        """A length-prefixed string."""
        return text(self.take(self.u32()))

    def blob(self) -> bytes:
        """Length-prefixed bytes."""
        return self.take(self.u32())


class Schema(NamedTuple):
    """A message definition in the file."""

    name: str
    encoding: str
    data: bytes


def schema_of(cursor: Cursor) -> tuple[int, Schema]:
    """Number and content of a schema record."""
    number = cursor.u16()
    name, encoding, data = cursor.string(), cursor.string(), cursor.blob()
    return number, Schema(name, encoding, data if len(data) <= SCHEMA_BYTES else b"")


def channel_of(cursor: Cursor, schemas: Mapping[int, Schema]) -> tuple[int, Channel]:
    """Number and content of a channel record, whose schema must be known."""
    number, schema_number = cursor.u16(), cursor.u16()
    topic, encoding = cursor.string(), cursor.string()
    # Of the two numbers, one may have a wrong bit; 0 stands for no schema.
    known = schema_number in schemas or schema_number == 0
    named = schema_number if known else nearest(schema_number, schemas)
    schema = schemas.get(named, Schema("", "", b""))
    name = normal_type(schema.name)
    return number, spelled(
        Channel(normal_topic(topic), name, encoding, schema.data, schema.encoding)
    )


class Definitions:
    """The schemas and channels of one file as they are read; writers repeat them in every chunk."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._bodies: dict[int, bytes] = {}
        self._described = Described()
        self._told: dict[tuple[int, int], bytes] = {}
        self._overruled: set[int] = set()

    def tell(self, op: int, body: bytes) -> tuple[int, Channel] | None:
        """As `take`, for a record of the summary.

        Raises DamageError for contradicting descriptions of a number, or for more than any log has.
        """
        if self._told.setdefault((op, _number(body)), body) != body:
            raise DamageError("the summary contradicts itself")
        found = self.take(op, body)
        if not self.met(op, body):
            raise DamageError(TOO_MANY)
        return found

    def overrule(self, op: int, body: bytes) -> bool:
        """Whether a description in the data differs from the summary's."""
        if op == CHANNEL and _number(body[2:]) in self._overruled:
            return True
        other = contradicts(body, self._told.get((op, _number(body))))
        if other and op == SCHEMA:
            self._overruled.add(_number(body))
        return other

    def met(self, op: int, body: bytes) -> bool:
        """Whether the same record was processed before."""
        if op == SCHEMA:
            return self._bodies.get(_number(body)) == body
        return body in self._described

    @property
    def left(self) -> int:
        """Number of descriptions that are still accepted."""
        return self._described.left

    def worth(self, op: Bytes, number: IntArray) -> BoolArray:
        """(n,) which schemas and channels of these numbers to parse."""
        return self._described.worth(number + NUMBERS * (op == SCHEMA))

    def take(self, op: int, body: bytes) -> tuple[int, Channel] | None:
        """Number and content of a new channel; None for a schema or a known record.

        Raises DamageError.
        """
        if self.met(op, body):
            return None
        self._described.look(_number(body) + NUMBERS * (op == SCHEMA))
        cursor = Cursor(np.frombuffer(body, np.uint8))
        if op == CHANNEL:
            number, channel = channel_of(cursor, self._schemas)
            return number, channel if self._described.add(body) else short(channel)
        number, schema = schema_of(cursor)
        # A channel that names this number means another type from here on.
        self._described.forget()
        if self._described.has_room(body):
            self._bodies[number] = body
        else:
            self._bodies.pop(number, None)
            schema = Schema(schema.name[:SHORT_NAMES], "", b"")
        self._schemas[number] = schema
        return None

    def has_schema(self, number: int) -> bool:
        """Whether a schema is known; number 0 means none."""
        return number == 0 or number in self._schemas


def _number(body: bytes) -> int:
    """The number at the front of a description, 0 if truncated."""
    return int(_U16(body)[0]) if len(body) >= 2 else 0
