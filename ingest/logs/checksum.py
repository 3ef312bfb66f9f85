"""CRC-32 as MCAP files use it (ISO 3309, as in zlib and PNG)."""

from __future__ import annotations

try:
    # Three times as fast as the standard library's, which takes as long as lz4 itself.
    from isal.isal_zlib import crc32
except ImportError:
    # There are no wheels for every platform; the checks are made all the same.
    from zlib import crc32

__all__ = ["crc32"]
