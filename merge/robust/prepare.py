"""Per-map preparation: all that matching needs of a map and that does not depend on other maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...topology.corridor_lengths import LEAST_M
from ...topology.matching.branches import unit_headings
from ...topology.matching.likelihood import BIT, density_of_equals, length_log_density, rarity
from ...topology.matching.structure import padded_branches
from ...topology.passes import NO_BRANCH
from ...topology.ragged import numbered
from ...topology.se2 import xy_as_complex
from ...topology.topomap import RunNoise, TopoMap
from ...topology.views import Views
from .branch_patterns import branch_offsets, pattern_bits, pattern_keys, sector_masks
from .settings import MATCH


@dataclass(frozen=True, slots=True, eq=False)
class NearestNeighbours:
    """A search structure for points z (n,), x + iy: a matrix for exhaustive search and a tree."""

    z: ComplexArray
    centre: complex
    across: FloatArray
    half: FloatArray
    tree: cKDTree | None

    @classmethod
    def of(cls, z: ComplexArray) -> NearestNeighbours:
        """Build the structure. O(n log n)."""
        centre = complex(z.mean()) if len(z) else 0j
        points = as_points(z - centre)
        half = (points * points).sum(axis=1) / 2
        tree = cKDTree(points) if len(z) else None
        return cls(z, centre, np.ascontiguousarray(points.T), half, tree)

    def __len__(self) -> int:
        return len(self.z)

    def nearest(self, queries: ComplexArray, within_m: float) -> tuple[FloatArray, IntArray]:
        """(k,) each: distances of `where` (k,) to the nearest points, and their indices.

        For queries without a point within `within_m` the distance is only known to be larger, and
        the index may be out of range.
        """
        if self.tree is None:
            return np.full(len(queries), np.inf), np.zeros(len(queries), np.int64)
        centred = queries - self.centre
        if len(queries) * len(self.z) > MATCH.most_pairs:
            distance, index = self.tree.query(as_points(centred), distance_upper_bound=within_m)
            return np.asarray(distance), np.asarray(index)
        # Nearest is where |w - z|² = |w|² - 2 (w · z - |z|² / 2) is least.
        score = as_points(centred) @ self.across
        score -= self.half
        index = score.argmax(axis=1)
        return np.abs(queries - self.z[index]), index


def as_points(z: ComplexArray) -> FloatArray:
    """(n, 2) points x, y of complex numbers (n,)."""
    return np.ascontiguousarray(z).view(np.float64).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The q nearest junctions of each of n junctions, itself first, padded by itself.

    index: (n, q); distance_m: (n, q) [m], inf for padding; rarity: (n, q) -log2 density [1/m] of
    neighbours at this distance; weight: (n, q) of their matches in predicting the junction.
    """

    index: IntArray
    distance_m: FloatArray
    rarity: FloatArray
    weight: FloatArray

    @classmethod
    def of(cls, points: NearestNeighbours) -> Neighbours:
        """The neighbours of each junction among all. O(n log n)."""
        index = np.arange(len(points)).repeat(MATCH.neighbours).reshape(-1, MATCH.neighbours)
        distance_m = np.full(index.shape, np.inf)
        if points.tree is not None:
            most = min(MATCH.neighbours, len(points))
            distance_m[:, :most], index[:, :most] = points.tree.query(
                points.across.T, k=np.arange(1, most + 1)
            )
        exists = np.isfinite(distance_m)
        bits = np.zeros(distance_m.shape)
        bits[exists] = rarity(distance_m[exists]) / BIT
        return cls(index, distance_m, bits, np.exp(-0.5 * (distance_m / MATCH.reach_m) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class CorridorsByEnds:
    """Directed corridors sorted by their end vertices: key: (k,) tail * n + head; row: (k,)."""

    key: IntArray
    row: IntArray

    @classmethod
    def of(cls, tail: IntArray, head: IntArray, vertices: int) -> CorridorsByEnds:
        """Sort the corridors of a map with n vertices. O(k log k)."""
        key = tail * vertices + head
        order = np.argsort(key, kind="stable")
        return cls(key[order], order)

    def find(self, key: IntArray) -> tuple[IntArray, BoolArray]:
        """(q,) each: the first corridor of each key, and whether there is one."""
        if not len(self.key):
            return np.zeros(len(key), np.int64), np.zeros(len(key), np.bool_)
        position = np.minimum(self.key.searchsorted(key), len(self.key) - 1)
        return self.row[position], self.key[position] == key


@dataclass(frozen=True, slots=True, eq=False)
class CorridorPoints:
    """r points along corridors, about `MATCH.clear_m` apart and as far from their ends.

    z: (r,) x + iy [m]; direction: (r,) tangents as unit numbers; edge: (r,) row of the corridor,
    directed from source to target; tail, head: (r,) its end vertices; share: (r,) projection on the
    chord, 0 at the tail … 1 at the head; end_m: (r,) distance from the nearer end [m].
    """

    z: ComplexArray
    direction: ComplexArray
    edge: IntArray
    tail: IntArray
    head: IntArray
    share: FloatArray
    end_m: FloatArray

    def __len__(self) -> int:
        return len(self.z)


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A map of n junctions with at most d branches, and of k directed corridors (both directions of
    each, loops left out).

    Junctions. z: (n,) positions x + iy [m]; heading: (n, d) of branches [rad], NaN beyond the
    degree, and branch_unit: the same as unit numbers, 0 beyond it; count: (n,) branches;
    observations: (n,) passes; turn_rarity: (n, d) mean -ln density [1/rad] of the angles between a
    branch and the others; fault_rate: (n,) rate of branches missing or invented; confidence: (n,)
    probability that a pass shows exactly these branches; descriptor: (n, 5) count, variance of one
    heading [rad²], fault_rate, self-information of the branches in this map [bits], ln confidence;
    by_branch: (n, d) first corridor that leaves by each branch, -1 for none; neighbours: the
    nearest junctions of each.

    Corridors, (k,) each. tail, head: vertices; length: of the chord [m]; angle: of the chord [rad];
    leave: row-local branch at the tail, NO_BRANCH where unknown; sagitta: signed offset of the
    middle of the path from the chord [m]; reverse: row of the other direction; variance: of the
    length [m²]; traversals; rarity: -log2 density [1/m] of this length in this map; pattern:
    branches at both ends, by sectors; middle: of the chord, x + iy [m]; end_information: of the
    branches at both ends [bits]. by_ends: the same, sorted by their vertices; probe_key, probe_row:
    sort keys of (pattern, length), with variants, and their corridors; worst_variance: the largest
    variance [m²]; alike, alike_pairs: how often two different corridors are equally long, see
    `density_of_equals`; points: along the corridors.

    nearest_junction, nearest_point: for nearest-neighbour search in `z` and in `points.z`.
    """

    topomap: TopoMap
    z: ComplexArray
    heading: FloatArray
    count: IntArray
    observations: IntArray
    turn_rarity: FloatArray
    branch_unit: ComplexArray
    fault_rate: FloatArray
    descriptor: FloatArray
    confidence: FloatArray
    neighbours: Neighbours
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
    by_ends: CorridorsByEnds
    pattern: IntArray
    probe_key: FloatArray
    probe_row: IntArray
    middle: ComplexArray
    end_information: FloatArray
    worst_variance: float
    alike: float
    alike_pairs: float
    points: CorridorPoints
    nearest_junction: NearestNeighbours
    nearest_point: NearestNeighbours

    def __len__(self) -> int:
        return len(self.z)

    @property
    def run(self) -> str:
        """The run of the map."""
        return self.topomap.run

    @property
    def noise(self) -> RunNoise:
        """How well it was measured."""
        return self.topomap.noise

    @property
    def views(self) -> Views:
        """What a laser or a grid shows around places."""
        return self.topomap.views


def prepare(topomap: TopoMap) -> Prepared:
    """Prepare a map for matching; pure and picklable. O(n log n).

    Positions are the map's own embedding (§3). Directed corridors and the patterns of branches at
    their ends, which §2 compares, are indexed so that compatible ones are found by bisection.
    """
    m = topomap
    z = xy_as_complex(m.xy)
    heading, count = padded_branches(m), m.branches.counts
    passes = np.bincount(m.observation_vertex, minlength=len(z))
    observations = np.maximum(passes, 1).astype(np.int64)
    # No loops, and none without a length.
    has_length = np.abs(z[m.source] - z[m.target]) > LEAST_M
    rows = np.flatnonzero((m.source != m.target) & has_length)
    tail = np.concatenate([m.source[rows], m.target[rows]])
    head = np.concatenate([m.target[rows], m.source[rows]])
    leave = np.concatenate([m.source_branch[rows], m.target_branch[rows]])
    reverse = np.roll(np.arange(2 * len(rows)), len(rows))
    chord = z[head] - z[tail]
    length, angle = np.abs(chord), np.angle(chord)
    traversals = np.tile(np.maximum(m.traversals[rows], 1), 2)
    variance = _length_variance(m.noise, length, traversals, observations[tail], observations[head])
    sagitta, points = _corridor_shapes(m, rows, z)
    offset = branch_offsets(heading, count, tail, leave, angle)
    masks = sector_masks(offset)
    mask = masks[0]
    pattern = mask * 16 + mask[reverse]
    self_information, turn_rarity = pattern_bits(heading, count)
    branch_variance = m.noise.branch_rad**2 * (0.5 + 1 / observations) + MATCH.floor_rad**2
    fault_rate = _fault_rate(m.noise, observations)
    alike, alike_pairs = density_of_equals(length)
    probe_key, probe_row = pattern_keys(masks[1], reverse, length)
    nearest_junction = NearestNeighbours.of(z)
    branch_unit = unit_headings(heading)
    return Prepared(
        topomap=m,
        z=z,
        heading=heading,
        count=count,
        observations=observations,
        turn_rarity=turn_rarity,
        branch_unit=branch_unit,
        fault_rate=fault_rate,
        descriptor=np.column_stack(
            [count, branch_variance, fault_rate, self_information, np.log(m.confidence)]
        ),
        confidence=m.confidence,
        neighbours=Neighbours.of(nearest_junction),
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
        by_ends=CorridorsByEnds.of(tail, head, len(z)),
        pattern=pattern,
        probe_key=probe_key,
        probe_row=probe_row,
        middle=(z[tail] + z[head]) / 2,
        end_information=self_information[tail] + self_information[head],
        worst_variance=float(variance.max(initial=0.0)),
        alike=alike,
        alike_pairs=alike_pairs,
        points=points,
        nearest_junction=nearest_junction,
        nearest_point=NearestNeighbours.of(points.z),
    )


def _corridor_shapes(
    m: TopoMap, rows: IntArray, z: ComplexArray
) -> tuple[FloatArray, CorridorPoints]:
    """Sagitta [m] of every directed corridor, and points along the corridors.

    rows: (c,) edges of the map in use; z: (n,) vertices, x + iy [m]. The 2 c directed corridors are
    these edges from source to target, then from target to source. All polylines are concatenated
    and resampled by one interpolation over the arc length.
    """
    if len(rows) == 0:
        empty, no_rows, reals = np.zeros(0, np.complex128), np.zeros(0, np.int64), np.zeros(0)
        return reals, CorridorPoints(empty, empty, no_rows, no_rows, no_rows, reals, reals)
    tail, head = m.source[rows], m.target[rows]
    paths = [m.paths[r] for r in rows.tolist()]
    count = np.array([len(path) for path in paths])
    flat = np.concatenate(paths)
    z_path = xy_as_complex(flat)
    start_row = np.concatenate([[0], np.cumsum(count)[:-1]])
    step = np.abs(np.diff(z_path, prepend=z_path[:1]))
    step[start_row] = 0.0
    arc = np.cumsum(step)
    start_m, end_m = arc[start_row], arc[start_row + count - 1]
    # A strictly increasing abscissa for np.interp: consecutive polylines are 1e-6 apart.
    abscissa = arc + np.repeat(np.arange(len(rows)), count) * 1e-6
    shift = np.arange(len(rows)) * 1e-6

    def point(s: FloatArray) -> ComplexArray:
        x, y = (np.interp(s, abscissa, part) for part in (z_path.real, z_path.imag))
        return np.asarray(x + 1j * y)

    chord = z[head] - z[tail]
    unit = chord / np.abs(chord)
    middle = point((start_m + end_m) / 2 + shift)
    sagitta = ((middle - (z[tail] + z[head]) / 2) * unit.conj()).imag
    inner_m = np.maximum(end_m - start_m - 2 * MATCH.clear_m, 0.0)
    samples = np.ceil(inner_m / MATCH.clear_m).astype(np.int64)
    corridor, number = numbered(samples)
    along_m = (number + 0.5) / samples[corridor] * inner_m[corridor]
    s = (start_m + shift)[corridor] + MATCH.clear_m + along_m
    tangent = point(s + MATCH.clear_m / 2) - point(s - MATCH.clear_m / 2)
    tangent = tangent / np.maximum(np.abs(tangent), 1e-9)
    at_tail, at_head, position = z[tail[corridor]], z[head[corridor]], point(s)
    points = CorridorPoints(
        z=position,
        direction=tangent,
        edge=corridor,
        tail=tail[corridor],
        head=head[corridor],
        share=np.clip(((position - at_tail) / chord[corridor]).real, 0.0, 1.0),
        end_m=np.minimum(np.abs(position - at_tail), np.abs(position - at_head)),
    )
    return np.concatenate([sagitta, -sagitta]), points


def _by_branch(shape: tuple[int, ...], tail: IntArray, leave: IntArray) -> IntArray:
    """(n, d) the first corridor that leaves a junction by each of its branches, -1 for none."""
    first_corridor = np.full(shape, -1, np.int64)
    rows = np.flatnonzero(leave != NO_BRANCH)[::-1]
    first_corridor[tail[rows], leave[rows]] = rows
    return first_corridor


def _fault_rate(noise: RunNoise, observations: IntArray) -> FloatArray:
    """(n,) rate of branches missing or invented: persistent changes (doors), and errors of single
    passes."""
    return np.asarray(MATCH.fault_floor + noise.branch_fault_rate / np.minimum(observations, 3))


def _length_variance(
    noise: RunNoise,
    length: FloatArray,
    traversals: IntArray,
    passes_u: IntArray,
    passes_v: IntArray,
) -> FloatArray:
    """(k,) variance [m²] of corridors' chords: centres at both ends, odometry along them and its
    scale, at least the precision of documents. passes_u, passes_v: (k,) passes by both ends."""
    centres = noise.centre_m**2 * (1 / np.minimum(passes_u, 4) + 1 / np.minimum(passes_v, 4))
    along = noise.along_m_per_sqrt_m**2 * length / np.minimum(traversals, 4)
    return np.asarray(LEAST_M**2 + centres + along + (noise.scale * length) ** 2)


def length_bits(difference: FloatArray, variance: FloatArray) -> FloatArray:
    """log2 density [1/m] of the difference [m] of two measurements of one corridor."""
    return length_log_density(difference, variance) / BIT
