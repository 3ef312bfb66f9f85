"""From a recorded run to its topological map, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.closure.alternatives import most_likely_closure
from ..topology.closure.answers import Identification
from ..topology.closure.certainty import place_errors, shared_centre_sigma
from ..topology.closure.dead_reckoning import DeadReckoning, dead_reckoning
from ..topology.closure.estimate import set_apart
from ..topology.closure.incremental import Closed, closure_without_grid, full_closure, unclosed
from ..topology.closure.missed_detections import CorrectedPlaces, correct_detections
from ..topology.closure.variance_components import Fitted, fitted_noise
from ..topology.columns import take
from ..topology.digits import significant
from ..topology.errors import DataError
from ..topology.mapbuilding import build_topomap
from ..topology.odometry import Odometry
from ..topology.passes import Passes
from ..topology.run import NO_DETECTIONS, NOT_SEEN_AGAIN, Detections, Run
from ..topology.se2 import compose
from ..topology.topomap import Closure, RunNoise, TopoMap
from ..topology.track import BEYOND_M
from ..topology.turning_back import turning_points
from ..topology.vertex_errors import VertexErrors
from ..topology.views import Views
from ..topology.visits import Visits, in_map_frame
from .driven_shares import driven_shares
from .logs.grids import GridLog
from .mapping_settings import DEFAULT_MAPPING, MappingSettings
from .odometry.bridging import bridged, confirmed, describe_splits, jump_records
from .odometry.calibration import Calibration, apply_calibration
from .odometry.motion_errors import describe_scale, motion_errors, refine_scale
from .odometry.noise import refine_noise
from .pass_source import PassSource

_PHANTOM = "taken back: driven by unseen, so that the place is taken for a phantom"


def map_of_log(log: Run | GridLog, settings: MappingSettings = DEFAULT_MAPPING) -> TopoMap:
    """The map of a log: of a run by `build_map`, of a grid by its skeleton. Raises DataError, with
    the faults of the log, which may be the reason."""
    with _faults_named(log):
        return _map_of_grid(log, settings) if isinstance(log, GridLog) else build_map(log, settings)


def require_junctions(log: Run | GridLog, settings: MappingSettings = DEFAULT_MAPPING) -> None:
    """The errors of `map_of_log`, without closing loops."""
    with _faults_named(log):
        if isinstance(log, GridLog):
            _map_of_grid(log, settings)
        else:
            _calibrated(PassSource(log))


@contextmanager
def _faults_named(log: Run | GridLog) -> Iterator[None]:
    try:
        yield
    except DataError as error:
        raise DataError("; ".join((str(error), *log.warnings))) from error


def _map_of_grid(log: GridLog, settings: MappingSettings) -> TopoMap:
    # These load what most runs do without.
    from .grid_map import map_of_grid
    from .scans.floorplan import FloorplanSettings

    return map_of_grid(log, FloorplanSettings.of_robot(settings.robot_radius_m))


def build_map(run: Run, settings: MappingSettings = DEFAULT_MAPPING) -> TopoMap:
    """The topological map of a run.

    If the odometry broke, the map is in several `pieces`, drawn side by side, which `merge.pieces`
    may join. Raises DataError if the run has no junction pass, or its odometry does not move.
    """
    return build_map_with_errors(run, settings)[0]


def build_map_with_errors(
    run: Run, settings: MappingSettings = DEFAULT_MAPPING
) -> tuple[TopoMap, VertexErrors]:
    """`build_map`, and the joint errors of its vertices, which its sigmas are derived from."""
    run, odometry, reckoning, calibration = dead_reckoned(run)
    source = PassSource(run)
    if settings.closure == "full":
        odometry, reckoning, closed, fitted = _close_loops(odometry, reckoning, source)
    else:
        closed = unclosed(reckoning)
        fitted = _fitted(reckoning, odometry, closed)
    places = correct_detections(
        closed.reckoning,
        odometry,
        closed.place,
        set_apart(reckoning, closed.place, fitted.estimate),
        resolution_m=source.resolution_m if settings.closure == "full" else 0.0,
    )
    measured, shared_m = _measure_hidden_errors(
        fitted.reckoning, odometry, run, source, too_long=calibration.too_long
    )
    errors = place_errors(
        measured, fitted.estimate, closed.place, places.kept, fitted.grid, shared_m=shared_m
    )
    cautious, likely = _refine_noise(reckoning, closed, measured, places, source)
    topomap = build_topomap(
        run.name,
        odometry,
        reckoning.passes,
        places,
        noise=cautious,
        errors=errors,
        askew_rad=source.askew_rad,
        fitted_noise=likely,
    )
    topomap = _add_turning_points(topomap, odometry, places.visits, source)
    topomap = _add_views(topomap, run, odometry, places)
    info = _info(run, settings, calibration, reckoning, odometry)
    info["driven"] = driven_shares(topomap, odometry, places.visits)
    closures = _closures(closed, places, reckoning.passes)
    return replace(topomap, closures=closures, info=info), errors


def seen_on_the_way(run: Run, odometry: Odometry) -> Views:
    """The views of a run in the frame of its odometry."""
    if run.scanned is not None:
        return run.scanned.views
    body = odometry.at(run.views.time_ns)
    return replace(run.views, pose=compose(body, run.views.pose))


def dead_reckoned(run: Run) -> tuple[Run, Odometry, DeadReckoning, Calibration]:
    """The run with detections seen from the point that its odometry refers to; its calibrated
    odometry, and its passes with the noise known before loop closure."""
    source = PassSource(run)
    odometry, passes, calibration = _calibrated(source)
    noise = source.noise(odometry, passes)
    motion = motion_errors(odometry, _usable_detections(run), passes, noise)
    calibration = replace(calibration, motion=motion)
    if calibration.moves:
        run = replace(run, detections=run.detections.moved(calibration.offset_m))
        source = PassSource(run)
        odometry = odometry.shortened(calibration.too_long)
        passes = source.passes(odometry)
        noise = source.noise(odometry, passes)
    again = run.scanned.loops if run.scanned is not None else NOT_SEEN_AGAIN
    reckoning = dead_reckoning(odometry, passes, noise, again)
    return run, odometry, reckoning, calibration


def _usable_detections(run: Run) -> Detections:
    """The detections that tell of lengths and levers: none of those that are misread."""
    return NO_DETECTIONS if run.misread else run.detections


def _calibrated(source: PassSource) -> tuple[Odometry, Passes, Calibration]:
    """The odometry without the errors of headings and stamps that detections show, and the passes
    in its frame. Raises DataError if nothing can be mapped."""
    run, calibration = source.run, source.calibration()
    odometry = apply_calibration(run.odometry, calibration)
    passes = source.passes(odometry)
    if len(passes) == 0:
        raise DataError(f"run {run.name}: {source.why_none()}")
    _require_motion(run)
    return odometry, passes, calibration


def _require_motion(run: Run) -> None:
    """DataError if the robot never moved beyond one junction, not counting resets of its
    odometry."""
    xy, first = run.odometry.pose[:, :2], [0, *run.odometry.breaks.tolist()]
    if len(xy) == 0:
        return
    reached = np.maximum.reduceat(xy, first) - np.minimum.reduceat(xy, first)
    if np.hypot(*reached.T).max() < BEYOND_M:
        resets = " between its resets" if len(first) > 1 else ""
        raise DataError(
            f"run {run.name}: the odometry does not move: all of it lies within "
            f"{BEYOND_M:g} m{resets}; nothing can be mapped"
        )


def _close_loops(
    odometry: Odometry, reckoning: DeadReckoning, source: PassSource
) -> tuple[Odometry, DeadReckoning, Closed, Fitted]:
    """`close_loops`, with the jumps of the odometry measured by the places seen on both sides, or
    the odometry broken there; the odometry and dead reckoning with these jumps come first."""
    if not len(odometry.jumps):
        return odometry, reckoning, *close_loops(reckoning, odometry)

    def reckoning_of(track: Odometry) -> DeadReckoning:
        return dead_reckoning(track, source.passes(track), reckoning.noise)

    measured = bridged(odometry, reckoning_of, closure_without_grid)
    driven = reckoning_of(measured)
    closed, fitted = close_loops(driven, measured)
    sure = confirmed(odometry, measured, driven, closed.place)
    if len(sure.breaks) > len(measured.breaks):
        driven = reckoning_of(sure)
        closed, fitted = close_loops(driven, sure)
    return sure, driven, closed, fitted


def close_loops(reckoning: DeadReckoning, odometry: Odometry) -> tuple[Closed, Fitted]:
    """The places of the passes, and the noise that these show."""
    first = full_closure(reckoning)
    fitted = _fitted(reckoning, odometry, first)
    closed = most_likely_closure(reckoning, first, fitted.reckoning)
    return closed, fitted if closed is first else _fitted(reckoning, odometry, closed)


def _fitted(reckoning: DeadReckoning, odometry: Odometry, closed: Closed) -> Fitted:
    return fitted_noise(reckoning, odometry, closed.place, closed.estimate, grid=closed.grid)


def _measure_hidden_errors(
    fitted: DeadReckoning, odometry: Odometry, run: Run, source: PassSource, *, too_long: float
) -> tuple[DeadReckoning, FloatArray | None]:
    """Dead reckoning with the noise that closed loops do not show: the scale, and the error of
    centres that all passes by a place share; (p,) the latter of each pass [m], None if there is
    none. too_long: the share that was taken off all lengths."""
    passes, noise = fitted.passes, fitted.noise
    scale = refine_scale(odometry, _usable_detections(run), passes, noise, too_long=too_long)
    noise = replace(noise, scale=significant(scale))
    alike = None if source.shared_m is None else shared_centre_sigma(source.shared_m, noise)
    if alike is not None:
        noise = replace(noise, shared_centre_m=significant(float(np.median(alike))))
    return replace(fitted, noise=noise), alike


def _refine_noise(
    reckoning: DeadReckoning,
    closed: Closed,
    measured: DeadReckoning,
    places: CorrectedPlaces,
    source: PassSource,
) -> tuple[RunNoise, RunNoise]:
    """The noise to match with, on the cautious side, and the most likely one; both with the error
    rates of the detector that the places show."""
    likely = replace(measured.noise, branch_rad=reckoning.noise.branch_rad)
    cautious, likely = (
        refine_noise(
            reckoning.passes,
            places.place,
            places.turn,
            noise,
            drive_bys=int(np.sum(~places.visits.seen)),
            prior=source.prior,
        )
        for noise in (closed.reckoning.noise, likely)
    )
    return cautious, likely


def _add_turning_points(
    topomap: TopoMap, odometry: Odometry, visits: Visits, source: PassSource
) -> TopoMap:
    """The map with the turning points that its source of passes does not report as junctions."""
    if source.shows_bends:
        return topomap
    turned = turning_points(topomap, odometry, visits, source.resolution_m)
    return replace(topomap, turning_points=turned, shows_bends=False)


def _add_views(topomap: TopoMap, run: Run, odometry: Odometry, places: CorrectedPlaces) -> TopoMap:
    """The map with the views of its run in its frame, without those of parts that it does not
    show."""
    views = seen_on_the_way(run, odometry)
    if not len(views):
        return topomap
    pose = in_map_frame(odometry, places.visits, places.xy, views.time_ns, views.pose)
    known = np.flatnonzero(np.isfinite(pose).all(axis=1))
    return replace(topomap, views=replace(take(views, known), pose=pose[known]))


def _closures(closed: Closed, places: CorrectedPlaces, passes: Passes) -> tuple[Closure, ...]:
    """The record of the map: all identifications made, refused and taken back."""
    identifications = [*closed.identifications, *places.identifications]
    answers = [_without_phantoms(q, places.place) for q in identifications]
    answers.sort(key=lambda q: (q.second, q.first, q.round))
    times = passes.time_ns.tolist()
    return tuple(
        Closure(
            times[q.first],
            times[q.second],
            accepted=q.accepted,
            bits=q.bits,
            reason=q.reason,
            round=q.round or None,
            accepted_round=q.accepted_round or None,
        )
        for q in answers
    )


def _without_phantoms(q: Identification, place: IntArray) -> Identification:
    """An identification whose place was a phantom is taken back."""
    if not q.accepted or min(place[q.first], place[q.second]) >= 0:
        return q
    return replace(q, accepted=False, reason=_PHANTOM, round=0, accepted_round=q.round)


def _info(
    run: Run,
    settings: MappingSettings,
    calibration: Calibration,
    reckoning: DeadReckoning,
    odometry: Odometry,
) -> dict[str, Any]:
    """The document's entries on how the map was made."""
    pieces = len(np.unique(reckoning.piece))
    return {
        "source": dict(run.source),
        "settings": asdict(settings),
        "warnings": [
            *run.warnings,
            *describe_scale(calibration.motion),
            *describe_splits(run.odometry, odometry),
        ],
        **({"pieces": pieces} if pieces > 1 else {}),
        **({"jumps": jump_records(run.odometry, odometry)} if len(odometry.jumps) else {}),
        "calibration": {
            name: {
                "applied": calibration.applied[k],
                "estimate": calibration.estimate[k],
                "sigma": calibration.sigma[k],
            }
            for k, name in enumerate(("bias_rad_per_m", "turn_scale", "lag_s"))
        }
        | ({} if calibration.motion is None else asdict(calibration.motion)),
    }
