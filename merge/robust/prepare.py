"""Per-map preparation: all that matching needs of a map and that does not depend on other maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.digits import METRES
from ...topology.matching.branches import unit_headings
from ...topology.matching.likelihood import BIT, density_of_equals, length_log_density, rarity
from ...topology.matching.structure import padded_branches
from ...topology.passes import NO_BRANCH
from ...topology.ragged import numbered
from ...topology.se2 import wrap
from ...topology.topomap import RunNoise, TopoMap
from ..result import FusedMap
from .halves import halves
from .nearest_neighbours import NearestNeighbours
from .settings import MATCH

LEAST_M = 10.0**-METRES
"""Lower bound of 1 sigma of a length: the precision of documents."""

SECTOR_RAD = np.pi / 2
"""Branches are classified into four sectors relative to the one by which a corridor leaves."""

LENGTH_SCALE = 2.0**10
"""Factor of the pattern in sort keys of pattern and length; larger than any corridor's length
[m]."""


class Extent(NamedTuple):
    """Size of a map: junctions, and directed corridors (both directions of each)."""

    junctions: int
    corridors: int

    @classmethod
    def of(cls, topomap: TopoMap | FusedMap) -> Extent:
        """The extent of a map once it is prepared."""
        return cls(
            len(topomap), 2 * len(_corridors(topomap, topomap.xy[:, 0] + 1j * topomap.xy[:, 1]))
        )


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A map of n junctions and k directed corridors (both directions of each, loops left out).

    z: (n,) positions x + iy [m]. heading: (n, d) branch headings, NaN behind the last; count: (n,)
    branches; observations: (n,) passes that saw the junction; turn_rarity: (n, d) -ln density
    [1/rad] of finding a branch at its angle to the others. branch_unit: (n, d) headings as unit
    numbers, 0 behind the last; fault_rate: (n,) chance of a branch too many or too few. descriptor:
    (n, 5) count, variance of one heading [rad²], fault_rate, bits that the branches tell by how
    common such a pattern is in this map, and ln confidence, side by side. confidence: (n,) chance
    that a look at the junction shows just these branches. neighbour: (n, q) the nearest junctions,
    itself first; near_m: (n, q) their distances, infinite where there are no more; near_rarity: (n,
    q) -log2 density [1/m] of neighbours this far; near_weight: (n, q) what their matches weigh in
    predicting this one. tail, head: (k,); length: (k,) chord [m]; angle: (k,) chord direction
    [rad]; leave: (k,) row-local branch used at the tail, NO_BRANCH where unknown; by_branch: (n, d)
    row of a corridor that leaves by this branch, -1 where none is known; sagitta: (k,) [m] signed
    offset of the mid of the path from the chord; reverse: (k,) row of the reverse; variance: (k,)
    [m²] of the length; traversals: (k,); rarity: (k,) -log2 density [1/m] of corridors this long.
    pair_key, pair_row: directed corridors sorted by tail * n + head. probe_*: for every directed
    corridor its sort keys (pattern, length), sorted. middle: (k,) half way between the ends (x +
    iy); end_information: (k,) bits of the branches at both ends; worst_variance: the largest of
    `variance`. alike, alike_pairs: how often two different corridors are equally long
    (`density_of_equals`). road: points inside the corridors (x + iy), road_dir: unit tangents,
    road_edge: row of the directed corridor (one of the first k / 2), road_tail, road_head: its
    ends, road_share: 0 at its tail … 1 at its head, road_end: distance [m] to the nearer end. half,
    crossing_unit, crossing_rarity: as in `Halves`. nearest_junction, nearest_road: `z` and `road`,
    to be asked for the nearest.
    """

    run: str
    noise: RunNoise
    shows_bends: bool
    z: ComplexArray
    heading: FloatArray
    count: IntArray
    observations: IntArray
    turn_rarity: FloatArray
    branch_unit: ComplexArray
    fault_rate: FloatArray
    descriptor: FloatArray
    confidence: FloatArray
    neighbour: IntArray
    near_m: FloatArray
    near_rarity: FloatArray
    near_weight: FloatArray
    tail: IntArray
    head: IntArray
    length: FloatArray
    angle: FloatArray
    leave: IntArray
    by_branch: IntArray
    sagitta: FloatArray
    reverse: IntArray
    variance: FloatArray
    traversals: IntArray
    rarity: FloatArray
    pair_key: IntArray
    pair_row: IntArray
    pattern: IntArray
    probe_key: FloatArray
    probe_row: IntArray
    middle: ComplexArray
    end_information: FloatArray
    worst_variance: float
    alike: float
    alike_pairs: float
    road: ComplexArray
    road_dir: ComplexArray
    road_edge: IntArray
    road_tail: IntArray
    road_head: IntArray
    road_share: FloatArray
    road_end: FloatArray
    half: IntArray
    crossing_unit: ComplexArray
    crossing_rarity: FloatArray
    nearest_junction: NearestNeighbours
    nearest_road: NearestNeighbours

    def __len__(self) -> int:
        return len(self.z)

    @property
    def extent(self) -> Extent:
        """Its size."""
        return Extent(len(self), len(self.tail))


def _corridors(m: TopoMap | FusedMap, z: ComplexArray) -> IntArray:
    """Rows of the corridors that matching uses: no loops, and none without a length."""
    long = np.abs(z[m.source] - z[m.target]) > LEAST_M
    return np.flatnonzero((m.source != m.target) & long)


def prepare(topomap: TopoMap) -> Prepared:
    """Prepare a map for matching; pure and picklable. O(n log n).

    Positions are the map's own embedding (§3); directed corridors and the patterns of branches at
    their ends are what §2 compares, indexed here so that compatible ones are found by bisection.
    """
    m = topomap
    z = m.xy[:, 0] + 1j * m.xy[:, 1]
    heading, count = padded_branches(m), m.branches.counts
    observations = np.maximum(np.bincount(m.observation_vertex, minlength=len(z)), 1).astype(
        np.int64
    )
    rows = _corridors(m, z)
    tail = np.concatenate([m.source[rows], m.target[rows]])
    head = np.concatenate([m.target[rows], m.source[rows]])
    leave = np.concatenate([m.source_branch[rows], m.target_branch[rows]])
    reverse = np.roll(np.arange(2 * len(rows)), len(rows))
    chord = z[head] - z[tail]
    length, angle = np.abs(chord), np.angle(chord)
    traversals = np.tile(np.maximum(m.traversals[rows], 1), 2)
    variance = _length_variance(m.noise, length, traversals, observations[tail], observations[head])
    sagitta, road, road_dir, road_edge = _corridor_shapes(m, rows, z)
    road_tail, road_head = tail[road_edge], head[road_edge]
    offset = _offsets(heading, count, tail, leave, angle)
    near_masks = _masks(offset)
    mask = near_masks[0]
    pattern = mask * 16 + mask[reverse]
    self_information, turn_rarity = _pattern_bits(heading, count)
    branch_variance = m.noise.branch_rad**2 * (0.5 + 1 / observations) + MATCH.floor_rad**2
    fault_rate = _fault_rate(m.noise, observations)
    alike, alike_pairs = density_of_equals(length)
    probe_key, probe_row = _probes(near_masks[1], reverse, length)
    order = np.argsort(tail * len(z) + head, kind="stable")
    nearest_junction = NearestNeighbours.of(z)
    neighbour, near_m = _neighbours(nearest_junction)
    unit = unit_headings(heading)
    two_forks = halves(z, unit, turn_rarity, (tail, head), shows_bends=m.shows_bends)
    return Prepared(
        run=m.run,
        noise=m.noise,
        shows_bends=m.shows_bends,
        z=z,
        heading=heading,
        count=count,
        observations=observations,
        turn_rarity=turn_rarity,
        branch_unit=unit,
        fault_rate=fault_rate,
        descriptor=np.column_stack(
            [count, branch_variance, fault_rate, self_information, np.log(m.confidence)]
        ),
        confidence=m.confidence,
        neighbour=neighbour,
        near_m=near_m,
        near_rarity=_near_rarity(near_m),
        near_weight=np.exp(-0.5 * (near_m / MATCH.reach_m) ** 2),
        tail=tail,
        head=head,
        length=length,
        angle=angle,
        leave=leave,
        by_branch=_by_branch(heading.shape, tail, leave),
        sagitta=sagitta,
        reverse=reverse,
        variance=variance,
        traversals=traversals,
        rarity=rarity(length) / BIT,
        pair_key=(tail * len(z) + head)[order],
        pair_row=order,
        pattern=pattern,
        probe_key=probe_key,
        probe_row=probe_row,
        middle=(z[tail] + z[head]) / 2,
        end_information=self_information[tail] + self_information[head],
        worst_variance=float(variance.max(initial=0.0)),
        alike=alike,
        alike_pairs=alike_pairs,
        road=road,
        road_dir=road_dir,
        road_edge=road_edge,
        road_tail=road_tail,
        road_head=road_head,
        road_share=np.clip(((road - z[road_tail]) / chord[road_edge]).real, 0.0, 1.0),
        road_end=np.minimum(np.abs(road - z[road_tail]), np.abs(road - z[road_head])),
        half=two_forks.half,
        crossing_unit=two_forks.unit,
        crossing_rarity=two_forks.rarity,
        nearest_junction=nearest_junction,
        nearest_road=NearestNeighbours.of(road),
    )


def _by_branch(shape: tuple[int, ...], tail: IntArray, leave: IntArray) -> IntArray:
    """(n, d) the first corridor that leaves a junction by each of its branches, -1 for none."""
    out = np.full(shape, -1, np.int64)
    rows = np.flatnonzero(leave != NO_BRANCH)[::-1]
    out[tail[rows], leave[rows]] = rows
    return out


def _fault_rate(noise: RunNoise, observations: IntArray) -> FloatArray:
    """(n,) rate of branches missing or invented: persistent changes (doors), and errors of single
    passes."""
    return np.asarray(MATCH.fault_floor + noise.branch_fault_rate / np.minimum(observations, 3))


def _length_variance(
    noise: RunNoise, length: FloatArray, traversals: IntArray, looks_u: IntArray, looks_v: IntArray
) -> FloatArray:
    """(k,) variance [m²] of corridors' chords: centres at both ends, odometry along them and its
    scale, at least the precision of documents. looks_u, looks_v: (k,) passes by both ends."""
    centres = noise.centre_m**2 * (1 / np.minimum(looks_u, 4) + 1 / np.minimum(looks_v, 4))
    along = noise.along_m_per_sqrt_m**2 * length / np.minimum(traversals, 4)
    return np.asarray(LEAST_M**2 + centres + along + (noise.scale * length) ** 2)


def _corridor_shapes(
    m: TopoMap, rows: IntArray, z: ComplexArray
) -> tuple[FloatArray, ComplexArray, ComplexArray, IntArray]:
    """Sagitta [m] of every directed corridor; and points along the corridors away from their ends,
    x + iy, their tangents as unit numbers, and their corridors.

    All polylines are concatenated and resampled by one interpolation over the arc length.
    """
    if len(rows) == 0:
        none = np.zeros(0, np.complex128)
        return np.zeros(0), none, none, np.zeros(0, np.int64)
    points = [m.paths[r] for r in rows.tolist()]
    size = np.array([len(p) for p in points])
    flat = np.concatenate(points)
    line = flat[:, 0] + 1j * flat[:, 1]
    first = np.concatenate([[0], np.cumsum(size)[:-1]])
    step = np.abs(np.diff(line, prepend=line[:1]))
    step[first] = 0.0
    arc = np.cumsum(step)
    start, end = arc[first], arc[first + size - 1]
    # A strictly increasing abscissa for np.interp: consecutive polylines are 1e-6 apart.
    at = arc + np.repeat(np.arange(len(rows)), size) * 1e-6
    shift = np.arange(len(rows)) * 1e-6

    def point(s: FloatArray) -> ComplexArray:
        return np.asarray(np.interp(s, at, line.real) + 1j * np.interp(s, at, line.imag))

    chord = z[m.target[rows]] - z[m.source[rows]]
    unit = chord / np.abs(chord)
    middle = point((start + end) / 2 + shift)
    bow = ((middle - (z[m.source[rows]] + z[m.target[rows]]) / 2) * unit.conj()).imag
    inner = np.maximum(end - start - 2 * MATCH.clear_m, 0.0)
    pieces = np.ceil(inner / MATCH.clear_m).astype(np.int64)
    owner, nth = numbered(pieces)
    s = (start + shift)[owner] + MATCH.clear_m + (nth + 0.5) / pieces[owner] * inner[owner]
    tangent = point(s + MATCH.clear_m / 2) - point(s - MATCH.clear_m / 2)
    tangent = tangent / np.maximum(np.abs(tangent), 1e-9)
    return np.concatenate([bow, -bow]), point(s), tangent, owner


def _offsets(
    heading: FloatArray, count: IntArray, tail: IntArray, leave: IntArray, angle: FloatArray
) -> FloatArray:
    """(k, d) angle [rad] from the branch by which each corridor leaves to the other branches
    there."""
    used = np.where(leave == NO_BRANCH, angle, heading[tail, np.maximum(leave, 0)])
    offset = np.asarray(wrap(heading[tail] - used[:, None]))
    column = np.arange(heading.shape[1])
    other = (column < count[tail][:, None]) & (column != leave[:, None])
    return np.where(other, offset, np.nan)


def _masks(offset: FloatArray) -> tuple[IntArray, IntArray]:
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
    return np.asarray(np.bitwise_or.reduce(np.where(there, 1 << sector, 0), axis=1))


def _probes(
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


def _pattern_bits(heading: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
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


def length_bits(difference: FloatArray, variance: FloatArray) -> FloatArray:
    """log2 density [1/m] of the difference [m] of two measurements of one corridor."""
    return length_log_density(difference, variance) / BIT


def _neighbours(points: NearestNeighbours) -> tuple[IntArray, FloatArray]:
    """(n, q) nearest junctions of each junction, itself first, and their distances [m]; padded by
    itself at infinite distance."""
    neighbour = np.arange(len(points)).repeat(MATCH.neighbours).reshape(-1, MATCH.neighbours)
    near_m = np.full(neighbour.shape, np.inf)
    if points.tree is not None:
        most = min(MATCH.neighbours, len(points))
        near_m[:, :most], neighbour[:, :most] = points.tree.query(
            points.across.T, k=np.arange(1, most + 1)
        )
    return neighbour, near_m


def _near_rarity(near_m: FloatArray) -> FloatArray:
    """(n, q) self-information [bits] of neighbours at these distances; 0 where there is none."""
    out = np.zeros(near_m.shape)
    there = np.isfinite(near_m)
    out[there] = rarity(near_m[there]) / BIT
    return out
