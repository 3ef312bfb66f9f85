"""Evidence in words."""

from __future__ import annotations

from ..topology.digits import BITS
from .result import shown_bits


def decimals(bits: float, need_bits: float) -> int:
    """Least number of decimals that distinguishes the two numbers, up to that of documents."""
    two = (bits, need_bits)
    return next((d for d in range(1, BITS) if len({shown_bits(b, d) for b in two}) > 1), BITS)


def told_bits(bits: float, need_bits: float) -> str:
    """ "4.1 bits, 12.6 needed", with enough decimals to distinguish the two."""
    digits = decimals(bits, need_bits)
    return f"{shown_bits(bits, digits)} bits, {shown_bits(need_bits, digits)} needed"
