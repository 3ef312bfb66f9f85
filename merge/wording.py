"""Evidence in words."""

from __future__ import annotations

import math

from ..topology.digits import BITS
from ..topology.wording import counted
from .result import shown_bits

SAME_PLACE = "same place, not a copy"
"""The second question of robust merging."""

LEAST = 0.1
"""Metres and degrees of which one decimal tells something."""
AGREES_BITS = 1.0
"""Where the walls of a part of the overlap say more, they agree: odds of 2 to 1."""


def decimals(bits: float, need_bits: float) -> int:
    """Least number of decimals that distinguishes the two numbers, up to that of documents."""
    two = (bits, need_bits)
    return next((d for d in range(1, BITS) if len({shown_bits(b, d) for b in two}) > 1), BITS)


def describe_bits(bits: float, need_bits: float) -> str:
    """ "4.1 bits, 12.6 needed", with enough decimals to distinguish the two."""
    digits = decimals(bits, need_bits)
    return f"{shown_bits(bits, digits)} bits, {shown_bits(need_bits, digits)} needed"


def describe_agreement(junctions: int, corridors: int, views: int) -> str:
    """ "5 junctions and 3 corridors agree", and the walls, in how many parts of the overlap."""
    parts = [counted(junctions, "junction"), counted(corridors, "corridor")]
    if views:
        parts.append(f"the walls in {counted(views, 'part')} of the overlap")
    return f"{', '.join(parts[:-1])} and {parts[-1]} agree"


def describe_placement(sigma_m: float, sigma_rad: float) -> str:
    """ "0.2 m and 1.4°", or "4.9 cm and 0.03°": a decimal, and of less than 0.1 two digits."""
    degrees = math.degrees(sigma_rad)
    length = f"{sigma_m:.1f} m" if sigma_m >= LEAST else f"{100 * sigma_m:.2g} cm"
    angle = f"{degrees:.1f}°" if degrees >= LEAST else f"{degrees:.2g}°"
    return f"{length} and {angle}"
