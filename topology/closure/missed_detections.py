"""Missed detections (false negatives) and spurious ones (false positives) of junctions.

Places that the detector cannot tell apart are joined first (`resolution.py`). A leg that passes a
known place without a detection is split there. A place that was detected once and passed many times
without a detection is a phantom and removed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IntArray
from ..columns import joined, take
from ..mapbuilding import DRAWING
from ..odometry import Odometry
from ..passes import DRIVEN_RAD, ONE_WAY_RAD
from ..se2 import turned, wrap
from ..track import BEYOND_M, seconds_at
from ..visits import STEP_M, DrawnTrack, PassesAtPlaces, Visits, draw_track
from .answers import Identification
from .dead_reckoning import DeadReckoning
from .estimate import Estimate
from .places import NOWHERE, Places, tabulate
from .resolution import blurred, one_drive_by


@dataclass(frozen=True, slots=True)
class DrivenBySettings:
    """When a place is a phantom."""

    straight_gain: float = 4.5
    """Log odds [nats] of being a phantom added for a place with two opposite branches only."""
    least_odds: float = 2.0
    """Log odds [nats] of being a phantom at which a place is removed."""
    least_miss_rate: float = 0.1
    """Lower bound of the miss rate of a junction that was missed once: causes persist."""
    least_phantom_rate: float = 0.01
    """Lower bound of the rate at which a junction seen once is spurious, whatever the run shows."""


DRIVEN_BY = DrivenBySettings()


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedPlaces(PassesAtPlaces):
    """The places without phantoms, and all visits to them, detected and undetected.

    kept: (n,) previous number of each place; identifications: identifications made.
    """

    kept: IntArray
    identifications: list[Identification]


def correct_detections(
    reckoning: DeadReckoning,
    odometry: Odometry,
    place: IntArray,
    estimate: Estimate,
    *,
    resolution_m: float = 0.0,
) -> CorrectedPlaces:
    """Join places below the detector's resolution, remove phantoms, and split the legs that pass
    known places.

    place: (p,) of each pass, numbered from 0 by first visit; resolution_m: of the detector [m].
    """
    one = blurred(reckoning, place, estimate, resolution_m)
    fair = one.place[place] == place
    kept, number = _renumbered(one.place == np.arange(len(estimate.xy)))
    place, xy = number[one.place[place]], one.xy[kept]
    # One drive-by is one visit.
    again = np.zeros(len(place), bool)
    again[1:] = ~fair[1:] & (place[1:] == place[:-1]) & one_drive_by(reckoning, resolution_m)
    place, turn = np.where(again, NOWHERE, place), estimate.pose[:, 2]

    def driven(place: IntArray, xy: FloatArray) -> tuple[Places, Visits, Visits]:
        """The places, and the visits to them, detected and undetected."""
        places = tabulate(reckoning, np.where(fair, place, NOWHERE), turn)
        seen = visits_of(reckoning, place, fair, estimate, xy)
        return places, seen, driven_by(odometry, seen, xy, places)

    places, _, passed = driven(place, xy)
    unseen = np.bincount(passed.vertex, minlength=len(places))
    doubtful = phantoms(reckoning, places, unseen)
    # A map needs a place: where a run shows no other, doubtful ones stay.
    real, number = _renumbered(~doubtful | doubtful.all())
    place, xy = np.where(place >= 0, number[place], NOWHERE), xy[real]
    visits = joined(driven(place, xy)[1:])
    visits = take(visits, np.argsort(visits.time_ns, kind="stable"))
    return CorrectedPlaces(place, fair, turn, xy, visits, kept[real], one.identifications)


def _renumbered(keep: BoolArray) -> tuple[IntArray, IntArray]:
    """The rows to keep, and the new number of each row, NOWHERE for the others."""
    number = np.where(keep, np.cumsum(keep) - 1, NOWHERE)
    return np.flatnonzero(keep), number


def driven_by(
    odometry: Odometry,
    visits: Visits,
    xy: FloatArray,
    places: Places,
) -> Visits:
    """Undetected visits of places at `xy` (n, 2) [m], on the track between two detected ones. None
    of `visits.vertex` is negative.

    The whole track is sampled and each sample assigned to its nearest place within `junction_m`
    (`DRAWING`). A run of consecutive such samples is one event, at the sample nearest to a place:
    if the track passes two places at once, as in overlapping layers of an unclosed loop, it is not
    known which one was passed. O(way / step · log n).
    """
    first = np.flatnonzero(np.diff(visits.piece) == 0)
    track = draw_track(odometry, visits, xy, first)
    found = cKDTree(xy).query(track.xy, distance_upper_bound=DRAWING.junction_m)
    distance, near = np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
    hit = np.flatnonzero(np.isfinite(distance))
    fresh = np.ones(len(hit), bool)
    fresh[1:] = (np.diff(hit) != 1) | (np.diff(track.owner[hit]) != 0)
    head = np.flatnonzero(fresh)
    best = hit[np.lexsort((distance[hit], np.cumsum(fresh)))[head]]
    begin, end = hit[head], hit[np.append(head[1:], len(hit))[: len(head)] - 1]
    # The visits at the two ends are known already.
    at_start = begin == track.offsets[track.owner[begin]]
    at_end = end == track.offsets[track.owner[end] + 1] - 1
    best = best[~(at_start | at_end)]
    row = best[_along_branches(track, places, near, best)]
    place, turn = near[row], track.turn[row]
    seconds, _ = seconds_at(odometry, track.way[row])
    return Visits(
        time_ns=odometry.time_ns[0] + np.rint(1e9 * seconds).astype(np.int64),
        vertex=place,
        seen=np.zeros(len(row), bool),
        pose=np.column_stack([xy[place], turn]),
        # The place in the odometry's frame at that time: the turn taken back.
        centre=track.odom[row] + turned(xy[place] - track.xy[row], -turn),
        piece=visits.piece[first[track.owner[row]]],
    )


def _along_branches(track: DrawnTrack, places: Places, near: IntArray, row: IntArray) -> BoolArray:
    """(k,) whether the place has a branch where the robot came from or where it went."""
    reach = int(np.ceil(BEYOND_M / STEP_M))
    low, high = track.offsets[track.owner[row]], track.offsets[track.owner[row] + 1] - 1
    heading = places.heading[near[row]]
    fits = np.zeros(len(row), np.int64)
    for other in (np.maximum(row - reach, low), np.minimum(row + reach, high)):
        step = track.xy[other] - track.xy[row]
        off = np.abs(wrap(heading - np.arctan2(step[:, 1], step[:, 0])[:, None]))
        fits += np.where(np.isfinite(off), off, np.inf).min(axis=1) < DRIVEN_RAD
    result: BoolArray = fits >= 1
    return result


def phantoms(
    reckoning: DeadReckoning,
    places: Places,
    unseen: IntArray,
) -> BoolArray:
    """(n,) whether a place is more likely spurious than missed each time it was passed undetected.

    unseen: (n,) times each place was passed without a detection.
    """
    noise = reckoning.noise
    miss = max(2 * noise.miss_rate, DRIVEN_BY.least_miss_rate)
    invented = max(noise.phantom_rate, DRIVEN_BY.least_phantom_rate)
    odds = places.visits * np.log(invented) - unseen * np.log(miss)
    count = np.isfinite(places.heading).sum(axis=1)
    first_two = np.sort(places.heading, axis=1)[:, :2]
    if first_two.shape[1] == 2:
        opposite = np.abs(np.abs(wrap(first_two[:, 1] - first_two[:, 0])) - np.pi)
        straight = (count == 2) & (opposite < ONE_WAY_RAD)
        odds = odds + DRIVEN_BY.straight_gain * straight
    result: BoolArray = (odds > DRIVEN_BY.least_odds) & (unseen > 0)
    return result


def visits_of(
    reckoning: DeadReckoning,
    place: IntArray,
    fair: BoolArray,
    estimate: Estimate,
    xy: FloatArray,
) -> Visits:
    """The visits of detected places. A pass that does not show its place correctly (`fair` (p,)) is
    moved to the place's position."""
    row = np.flatnonzero(place >= 0)
    pose, centre = estimate.pose[row].copy(), reckoning.passes.centre[row].copy()
    off = np.where(fair[row, None], 0.0, xy[place[row]] - pose[:, :2])
    pose[:, :2] += off
    centre += turned(off, -pose[:, 2])
    return Visits(
        time_ns=reckoning.passes.time_ns[row],
        vertex=place[row],
        seen=np.ones(len(row), bool),
        pose=pose,
        centre=centre,
        piece=reckoning.piece[row],
    )
