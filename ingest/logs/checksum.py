"""CRC-32 as MCAP files use it (ISO 3309, as in zlib and PNG)."""

from __future__ import annotations

try:
    # Three times as fast as the standard library's, which takes as long as lz4 itself.
    from isal.isal_zlib import crc32
except ImportError:
    # There are no wheels for every platform; the checks are made all the same.
    from zlib import crc32

__all__ = ["agrees", "crc32"]


def agrees(found: int, expected: int) -> bool:
    """Whether data with the checksum `found` are intact, where `expected` may itself have a wrong
    bit.

    No single wrong bit in less than 512 MiB of data changes just one bit of the checksum, because
    the polynomial is primitive. Any other damage does so once in 130 million times.
    """
    return (found ^ expected).bit_count() <= 1
