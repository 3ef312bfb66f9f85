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
from ..matching.likelihood import LIKELIHOOD
from ..odometry import Odometry
from ..passes import DRIVEN_RAD, ONE_WAY_RAD
from ..se2 import turned, wrap
from ..track import BEYOND_M, seconds_at
from ..visits import STEP_M, DrawnTrack, PassesAtPlaces, Visits, draw_track
from .answers import Identification
from .dead_reckoning import DeadReckoning
from .estimate import Estimate
from .places import NOWHERE, Places, tabulate
from .resolution import join_below_resolution, one_drive_by


@dataclass(frozen=True, slots=True)
class PhantomSettings:
    """When a place is a phantom."""

    straight_gain: float = 4.5
    """Log odds [nats] of a phantom that are added for a place with two opposite branches only."""
    least_odds: float = 2.0
    """Log odds [nats] of a phantom at which a place is removed."""


PHANTOM = PhantomSettings()


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
    merged = join_below_resolution(reckoning, place, estimate, resolution_m)
    fair = merged.place[place] == place
    kept, number = _renumbered(merged.place == np.arange(len(estimate.xy)))
    place, xy = number[merged.place[place]], merged.xy[kept]
    # One drive-by is one visit.
    is_repeat = np.zeros(len(place), bool)
    is_repeat[1:] = ~fair[1:] & (place[1:] == place[:-1]) & one_drive_by(reckoning, resolution_m)
    place, turn = np.where(is_repeat, NOWHERE, place), estimate.pose[:, 2]

    def driven(place: IntArray, xy: FloatArray) -> tuple[Places, Visits, Visits]:
        """The places, and the detected and the undetected visits to them."""
        places = tabulate(reckoning, np.where(fair, place, NOWHERE), turn)
        seen = visits_of(reckoning, place, fair, estimate, xy)
        return places, seen, undetected_visits(odometry, seen, xy, places)

    places, _, undetected = driven(place, xy)
    unseen = np.bincount(undetected.vertex, minlength=len(places))
    is_phantom = phantoms(reckoning, places, unseen)
    # A map needs a place: if all are phantoms, they stay.
    real, number = _renumbered(~is_phantom | is_phantom.all())
    place, xy = np.where(place >= 0, number[place], NOWHERE), xy[real]
    visits = joined(driven(place, xy)[1:])
    visits = take(visits, np.argsort(visits.time_ns, kind="stable"))
    return CorrectedPlaces(place, fair, turn, xy, visits, kept[real], merged.identifications)


def _renumbered(keep: BoolArray) -> tuple[IntArray, IntArray]:
    """Rows to keep, by a mask (n,), and (n,) the new number of each row, NOWHERE for the others."""
    number = np.where(keep, np.cumsum(keep) - 1, NOWHERE)
    return np.flatnonzero(keep), number


def undetected_visits(odometry: Odometry, visits: Visits, xy: FloatArray, places: Places) -> Visits:
    """Undetected visits of places at `xy` (n, 2) [m], between the detected `visits`.

    The whole track is sampled and each sample assigned to its nearest place within `junction_m`
    (`DRAWING`). Consecutive such samples are one event, at the sample nearest to a place: if the
    track passes two places at once, as in overlapping layers of an unclosed loop, it is not known
    which one was passed. O(way / step · log n).
    """
    first = np.flatnonzero(np.diff(visits.piece) == 0)
    track = draw_track(odometry, visits, xy, first)
    nearest = cKDTree(xy).query(track.xy, distance_upper_bound=DRAWING.junction_m)
    distance, near = np.asarray(nearest[0], np.float64), np.asarray(nearest[1], np.int64)
    hits = np.flatnonzero(np.isfinite(distance))
    begins_event = np.ones(len(hits), bool)
    begins_event[1:] = (np.diff(hits) != 1) | (np.diff(track.owner[hits]) != 0)
    starts = np.flatnonzero(begins_event)
    events = hits[np.lexsort((distance[hits], np.cumsum(begins_event)))[starts]]
    begin, end = hits[starts], hits[np.append(starts[1:], len(hits))[: len(starts)] - 1]
    # The visits at the two ends are detected ones.
    at_start = begin == track.offsets[track.owner[begin]]
    at_end = end == track.offsets[track.owner[end] + 1] - 1
    events = events[~(at_start | at_end)]
    samples = events[_along_branches(track, places, near, events)]
    place, turn = near[samples], track.turn[samples]
    seconds, _ = seconds_at(odometry, track.way[samples])
    return Visits(
        time_ns=odometry.time_ns[0] + np.rint(1e9 * seconds).astype(np.int64),
        vertex=place,
        seen=np.zeros(len(samples), bool),
        pose=np.column_stack([xy[place], turn]),
        # The place in the odometry frame at that time.
        centre=track.odom[samples] + turned(xy[place] - track.xy[samples], -turn),
        piece=visits.piece[first[track.owner[samples]]],
    )


def _along_branches(track: DrawnTrack, places: Places, near: IntArray, row: IntArray) -> BoolArray:
    """(k,) whether the nearest places of track samples `row` have a branch where the robot came
    from or where it went."""
    reach = int(np.ceil(BEYOND_M / STEP_M))
    low, high = track.offsets[track.owner[row]], track.offsets[track.owner[row] + 1] - 1
    heading = places.heading[near[row]]
    fits = np.zeros(len(row), np.int64)
    for beyond in (np.maximum(row - reach, low), np.minimum(row + reach, high)):
        step = track.xy[beyond] - track.xy[row]
        turn_rad = np.abs(wrap(heading - np.arctan2(step[:, 1], step[:, 0])[:, None]))
        fits += np.where(np.isfinite(turn_rad), turn_rad, np.inf).min(axis=1) < DRIVEN_RAD
    return np.asarray(fits >= 1)


def phantoms(reckoning: DeadReckoning, places: Places, unseen: IntArray) -> BoolArray:
    """(n,) whether a place is more likely spurious than missed by all undetected passes.

    unseen: (n,) number of passes by each place without a detection.
    """
    noise = reckoning.noise
    # Causes persist: what was missed once is missed twice as often.
    miss = 2 * noise.miss_rate
    invented = max(noise.phantom_rate, LIKELIHOOD.fault_floor)
    odds = places.visits * np.log(invented) - unseen * np.log(miss)
    count = np.isfinite(places.heading).sum(axis=1)
    first_two = np.sort(places.heading, axis=1)[:, :2]
    if first_two.shape[1] == 2:
        opposite = np.abs(np.abs(wrap(first_two[:, 1] - first_two[:, 0])) - np.pi)
        straight = (count == 2) & (opposite < ONE_WAY_RAD)
        odds = odds + PHANTOM.straight_gain * straight
    return np.asarray((odds > PHANTOM.least_odds) & (unseen > 0))


def visits_of(
    reckoning: DeadReckoning, place: IntArray, fair: BoolArray, estimate: Estimate, xy: FloatArray
) -> Visits:
    """The visits of detected places. A pass that does not show its place correctly (fair: (p,)) is
    moved to the place's position."""
    row = np.flatnonzero(place >= 0)
    pose, centre = estimate.pose[row].copy(), reckoning.passes.centre[row].copy()
    shift = np.where(fair[row, None], 0.0, xy[place[row]] - pose[:, :2])
    pose[:, :2] += shift
    centre += turned(shift, -pose[:, 2])
    return Visits(
        time_ns=reckoning.passes.time_ns[row],
        vertex=place[row],
        seen=np.ones(len(row), bool),
        pose=pose,
        centre=centre,
        piece=reckoning.piece[row],
    )
