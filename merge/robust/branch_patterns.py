"""Patterns of branches at the ends of corridors: sort keys for lookup, and self-information."""

from __future__ import annotations

import numpy as np

from ...topology.arrays import BoolArray, FloatArray, IntArray
from ...topology.matching.likelihood import LIKELIHOOD
from ...topology.passes import NO_BRANCH
from ...topology.se2 import wrap
from .settings import MATCH

SECTOR_RAD = np.pi / 2
"""Branches are classified into four sectors relative to the one by which a corridor leaves."""

LENGTH_SCALE = 2 * LIKELIHOOD.longest_m
"""Factor of the pattern in sort keys of pattern and length; larger than any corridor's length
[m]."""


def branch_offsets(
    heading: FloatArray, count: IntArray, tail: IntArray, leave: IntArray, angle: FloatArray
) -> FloatArray:
    """(k, d) angle [rad] from the branch by which each corridor leaves to the other branches
    there."""
    used = np.where(leave == NO_BRANCH, angle, heading[tail, np.maximum(leave, 0)])
    offset = np.asarray(wrap(heading[tail] - used[:, None]))
    column = np.arange(heading.shape[1])
    other = (column < count[tail][:, None]) & (column != leave[:, None])
    return np.where(other, offset, np.nan)


def sector_masks(offset: FloatArray) -> tuple[IntArray, IntArray]:
    """Occupied sectors: (k,) the mask itself; (k, v) variants for branches near a border, padded by
    -1.

    Strategy: every branch has a first sector and, near a border, a second; the variants are the
    choices for all subsets of the two branches nearest to a border.
    """
    there = np.isfinite(offset)
    offset = np.where(there, offset, 0.0)
    turn, sector = offset / SECTOR_RAD, _sector(offset)
    slack = np.where(there, 0.5 - np.abs(turn - np.round(turn)), np.inf) * SECTOR_RAD
    second = (np.where(turn > np.round(turn), sector + 1, sector - 1)) % 4
    mask = _mask_of(sector, there)
    if offset.shape[1] == 0 or len(offset) == 0:
        return mask, mask[:, None]
    worst = np.argsort(slack, axis=1, kind="stable")[:, :2]
    variants = [mask]
    rows = np.arange(len(offset))
    for choice in ((0,), (1,), (0, 1)):
        if max(choice) >= worst.shape[1]:
            continue
        moved, soft = sector.copy(), np.ones(len(offset), np.bool_)
        for c in choice:
            column = worst[:, c]
            soft &= slack[rows, column] < MATCH.soft_rad
            moved[rows, column] = second[rows, column]
        variants.append(np.where(soft, _mask_of(moved, there), -1))
    return mask, np.stack(variants, axis=1)


def _sector(angle: FloatArray) -> IntArray:
    """The sector of each angle [rad]."""
    return np.asarray(np.round(angle / SECTOR_RAD).astype(np.int64) % 4)


def _mask_of(sector: IntArray, there: BoolArray) -> IntArray:
    """(k,) the sectors (k, d) that are occupied, as the bits of a number."""
    return np.asarray(np.bitwise_or.reduce(np.where(there, 1 << sector, 0), axis=1))


def pattern_keys(
    variants: IntArray, reverse: IntArray, length: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Sorted keys pattern * LENGTH_SCALE + length of every variant of every directed corridor."""
    if len(length) == 0:
        return np.zeros(0), np.zeros(0, np.int64)
    here, there = variants[:, :, None], variants[reverse][:, None, :]
    pattern = np.where((here >= 0) & (there >= 0), here * 16 + there, -1).reshape(len(length), -1)
    row, column = np.nonzero(pattern >= 0)
    key = pattern[row, column] * LENGTH_SCALE + np.minimum(length[row], LENGTH_SCALE / 2)
    order = np.argsort(key, kind="stable")
    return key[order], row[order]


def pattern_bits(heading: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """Self-information [bits] of the branches of each junction (n,), and -ln density of the angles
    between them (n, d), both estimated from this map.

    Strategy: every branch in turn is the reference; the mask of the sectors of the others has a
    frequency, and so has the angle within a sector (24 smoothed bins, folded into a sector).
    """
    n, d = heading.shape
    there = np.isfinite(heading)
    offset = np.asarray(wrap(heading[:, None, :] - heading[:, :, None]))  # (n, reference, other)
    other = there[:, None, :] & there[:, :, None] & ~np.eye(d, dtype=np.bool_)
    offset = np.where(other, offset, 0.0)
    mask = _mask_of(_sector(offset).reshape(n * d, d), other.reshape(n * d, d))
    used = there.reshape(-1)
    seen = np.bincount(mask[used], minlength=16) + 0.5
    frequency = (seen / seen.sum())[mask].reshape(n, d)
    mean = (frequency * there).sum(axis=1) / np.maximum(count, 1)
    self_information = np.where(count > 0, -np.log2(np.where(count > 0, mean, 1.0)), 0.0)
    bins = 24
    fold = (offset / SECTOR_RAD - np.round(offset / SECTOR_RAD) + 0.5) * bins
    cell = np.clip(fold.astype(np.int64), 0, bins - 1)
    density = np.bincount(cell[other], minlength=bins) + 1.0
    density = (np.roll(density, 1) + 2 * density + np.roll(density, -1)) / 4
    density = density / density.sum() * bins / SECTOR_RAD
    gain = np.where(other, -np.log(density)[cell], 0.0)
    turn_rarity = gain.sum(axis=1) / np.maximum(other.sum(axis=1), 1)
    return self_information, turn_rarity
