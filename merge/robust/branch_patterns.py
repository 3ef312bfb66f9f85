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
    """(k, d) angle [rad] from the branch by which each corridor leaves to the other branches of its
    tail; NaN for padding and for the branch itself."""
    reference = np.where(leave == NO_BRANCH, angle, heading[tail, np.maximum(leave, 0)])
    offset = np.asarray(wrap(heading[tail] - reference[:, None]))
    column = np.arange(heading.shape[1])
    other = (column < count[tail][:, None]) & (column != leave[:, None])
    return np.where(other, offset, np.nan)


def sector_masks(offset: FloatArray) -> tuple[IntArray, IntArray]:
    """Bit masks (k,) of the sectors that hold the branches at angles `offset` (k, d) [rad], NaN for
    none; and (k, v) the same followed by its variants, padded by -1.

    In a variant, branches near a border are in the sector beyond it: one or both of the two that
    are nearest to a border.
    """
    exists = np.isfinite(offset)
    offset = np.where(exists, offset, 0.0)
    quarters, sector = offset / SECTOR_RAD, _sector(offset)
    border_rad = np.where(exists, 0.5 - np.abs(quarters - np.round(quarters)), np.inf) * SECTOR_RAD
    alternative = (np.where(quarters > np.round(quarters), sector + 1, sector - 1)) % 4
    mask = _mask_of(sector, exists)
    if offset.shape[1] == 0 or len(offset) == 0:
        return mask, mask[:, None]
    nearest_border = np.argsort(border_rad, axis=1, kind="stable")[:, :2]
    variants = [mask]
    rows = np.arange(len(offset))
    for choice in ((0,), (1,), (0, 1)):
        if max(choice) >= nearest_border.shape[1]:
            continue
        changed, is_near = sector.copy(), np.ones(len(offset), np.bool_)
        for nth in choice:
            column = nearest_border[:, nth]
            is_near &= border_rad[rows, column] < MATCH.soft_rad
            changed[rows, column] = alternative[rows, column]
        variants.append(np.where(is_near, _mask_of(changed, exists), -1))
    return mask, np.stack(variants, axis=1)


def _sector(angle: FloatArray) -> IntArray:
    """The sector of each angle [rad]."""
    return np.asarray(np.round(angle / SECTOR_RAD).astype(np.int64) % 4)


def _mask_of(sector: IntArray, exists: BoolArray) -> IntArray:
    """(k,) masks of the sectors (k, d) of branches that exist (k, d): one bit a sector."""
    return np.asarray(np.bitwise_or.reduce(np.where(exists, 1 << sector, 0), axis=1))


def pattern_keys(
    variants: IntArray, reverse: IntArray, length: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Keys pattern * LENGTH_SCALE + length of directed corridors, ascending, and the corridor of
    each. Similar corridors of another map are found in them by bisection.

    A pattern is 16 * mask at the tail + mask at the head. variants: (k, v) masks at the tail, -1
    for none (`sector_masks`); reverse: (k,) row of the other direction; length: (k,) [m].
    """
    tail_mask, head_mask = variants[:, :, None], variants[reverse][:, None, :]
    pattern = tail_mask * 16 + head_mask
    row, tail, head = np.nonzero((tail_mask >= 0) & (head_mask >= 0))
    key = pattern[row, tail, head] * LENGTH_SCALE + np.minimum(length[row], LENGTH_SCALE / 2)
    order = np.argsort(key, kind="stable")
    return np.asarray(key[order]), np.asarray(row[order])


def pattern_bits(heading: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """Self-information [bits] of the branches of each junction (n,), and -ln density of the angles
    between them (n, d), both estimated from this map.

    Strategy: every branch in turn is the reference; the mask of the sectors of the others has a
    frequency, and so has the angle within a sector (24 smoothed bins, folded into a sector).
    """
    n, d = heading.shape
    exists = np.isfinite(heading)
    offset = np.asarray(wrap(heading[:, None, :] - heading[:, :, None]))  # (n, reference, other)
    other = exists[:, None, :] & exists[:, :, None] & ~np.eye(d, dtype=np.bool_)
    offset = np.where(other, offset, 0.0)
    mask = _mask_of(_sector(offset).reshape(n * d, d), other.reshape(n * d, d))
    exists_flat = exists.reshape(-1)
    count_of_mask = np.bincount(mask[exists_flat], minlength=16) + 0.5
    frequency = (count_of_mask / count_of_mask.sum())[mask].reshape(n, d)
    mean = (frequency * exists).sum(axis=1) / np.maximum(count, 1)
    self_information = np.where(count > 0, -np.log2(np.where(count > 0, mean, 1.0)), 0.0)
    bins = 24
    folded = (offset / SECTOR_RAD - np.round(offset / SECTOR_RAD) + 0.5) * bins
    bin_of = np.clip(folded.astype(np.int64), 0, bins - 1)
    density = np.bincount(bin_of[other], minlength=bins) + 1.0
    density = (np.roll(density, 1) + 2 * density + np.roll(density, -1)) / 4
    density = density / density.sum() * bins / SECTOR_RAD
    rarity = np.where(other, -np.log(density)[bin_of], 0.0)
    turn_rarity = rarity.sum(axis=1) / np.maximum(other.sum(axis=1), 1)
    return self_information, turn_rarity
