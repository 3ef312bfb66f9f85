"""From a recorded run to its topological map: the whole chain, one step after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..topology.closure.answers import Identification
from ..topology.closure.certainty import place_errors
from ..topology.closure.dead_reckoning import SystematicErrors, Walk, make_walk
from ..topology.closure.estimate import lay_out
from ..topology.closure.incremental import (
    Closed,
    RoundSettings,
    closure_without_grid,
    full_closure,
)
from ..topology.closure.missed_detections import (
    CorrectedPlaces,
    DrivenBySettings,
    correct_detections,
)
from ..topology.closure.nearest_neighbour import gated_closure
from ..topology.closure.pieces import set_apart
from ..topology.closure.variance_components import fitted_noise
from ..topology.errors import DataError
from ..topology.mapbuilding import MapBuildingSettings, build_topomap
from ..topology.odometry import Odometry
from ..topology.passes import Passes
from ..topology.run import Run
from ..topology.topomap import Closure, RunNoise, TopoMap
from ..topology.vertex_errors import VertexErrors
from .odometry.bridging import bridged, jumps_told, split_told
from .odometry.calibration import Calibration, CalibrationSettings, apply_calibration, calibrate
from .odometry.noise import NoiseSettings, estimate_noise, refine_noise, refine_scale
from .passes import PassSettings, fuse_passes, scanned_passes

IntArray = NDArray[np.int64]

_PHANTOM = "taken back: driven by unseen, so that the place is taken for a phantom"


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """How a run becomes a map; part of the document, so that a map tells how it was made."""

    closure: Literal["none", "gated", "full"] = "full"
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    calibration_doubt: float = 1.5
    """Factor on the calibration's own sigma, which trusts corridors to be straight."""
    systematic: SystematicErrors = field(default_factory=SystematicErrors)
    """Constant errors of an odometry that could not be calibrated."""
    passes: PassSettings = field(default_factory=PassSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    rounds: RoundSettings = field(default_factory=RoundSettings)
    driven_by: DrivenBySettings = field(default_factory=DrivenBySettings)
    drawing: MapBuildingSettings = field(default_factory=MapBuildingSettings)


def build_map(
    run: Run,
    settings: MappingSettings = MappingSettings(),
    *,
    on_step: Callable[[str], None] | None = None,
) -> TopoMap:
    """The topological map of a run.

    Where the odometry broke, the map is in several `pieces`, drawn side by side: how they lie to
    each other is for `merge.pieces` to find out. Raises DataError if the run has no junction pass,
    or its odometry does not move. `on_step` hears the name of each step before it begins.
    """
    return build_map_with_errors(run, settings, on_step=on_step)[0]


def build_map_with_errors(
    run: Run,
    settings: MappingSettings = MappingSettings(),
    *,
    on_step: Callable[[str], None] | None = None,
) -> tuple[TopoMap, VertexErrors]:
    """`build_map`, and how far off its vertices may be, together: what its sigmas come from."""
    step = on_step or (lambda name: None)
    step("calibration")
    calibration = _calibration(run, settings)
    odometry = apply_calibration(run.odometry, calibration)
    step("passes")
    passes = _passes(run, odometry, settings)
    _require_passes(run, passes)
    _require_motion(run, settings.passes.reach_m)
    step("noise")
    noise = _noise(run, odometry, passes, settings)
    step("loop closure")
    walk = make_walk(odometry, passes, noise, _systematic(calibration, settings))
    odometry, walk = _with_jumps_measured(run, odometry, walk, settings)
    closed = _closed(walk, settings)
    step("map")
    fit = fitted_noise(walk, odometry, closed.place, closed.layout, grid=closed.grid)
    layout = set_apart(walk, closed.place, fit.layout)
    corrected = correct_detections(
        closed.walk,
        odometry,
        closed.place,
        layout,
        settings.driven_by,
        resolution_m=_resolution_m(run, settings),
    )
    measured = _with_scale(run, odometry, fit.walk, settings)
    errors = place_errors(measured, fit.layout, closed.place, corrected.kept, fit.grid)

    def refined(prior: RunNoise) -> RunNoise:
        return refine_noise(
            walk.passes,
            corrected.place,
            layout.pose[:, 2],
            prior,
            drive_bys=int(np.sum(~corrected.visits.seen)),
            settings=_noise_settings(run, settings),
        )

    topomap = build_topomap(
        run.name,
        odometry,
        walk.passes,
        xy=corrected.xy,
        visits=corrected.visits,
        pass_vertex=corrected.place,
        pass_fair=corrected.fair,
        pass_turn=layout.pose[:, 2],
        noise=refined(closed.walk.noise),
        fitted_noise=refined(replace(measured.noise, branch_rad=walk.noise.branch_rad)),
        errors=errors,
        closures=_closures(closed, corrected, walk.passes),
        settings=settings.drawing,
    )
    info = _info(run, settings, calibration, walk, odometry)
    return replace(topomap, info=info, shows_bends=run.scanned is None), errors


def _with_jumps_measured(
    run: Run, odometry: Odometry, walk: Walk, settings: MappingSettings
) -> tuple[Odometry, Walk]:
    """The odometry and its walk, once the places on both sides told how far it jumped."""
    if len(odometry.jumps) == 0 or settings.closure != "full":
        return odometry, walk

    def walk_of(track: Odometry) -> Walk:
        return make_walk(track, _passes(run, track, settings), walk.noise, walk.systematic)

    odometry = bridged(odometry, walk_of, lambda w: closure_without_grid(w, settings.rounds))
    return odometry, walk_of(odometry)


def _closed(walk: Walk, settings: MappingSettings) -> Closed:
    """The places of the passes, by as much of loop closure as is asked for."""
    if settings.closure == "full":
        return full_closure(walk, settings.rounds)
    if settings.closure == "gated":
        return gated_closure(walk, settings.rounds)
    place = np.arange(len(walk), dtype=np.int64)
    return Closed(walk, place, lay_out(walk, place), asked=[], grid=None)


def _with_scale(run: Run, odometry: Odometry, walk: Walk, settings: MappingSettings) -> Walk:
    """The walk with the error of scale that no loop tells of."""
    scale = refine_scale(odometry, run.detections, walk.passes, walk.noise, settings.noise)
    return replace(walk, noise=replace(walk.noise, scale=scale))


def _resolution_m(run: Run, settings: MappingSettings) -> float:
    """Places nearer than this are one [m]; 0 where places are not to be identified so."""
    if run.scanned is None or settings.closure != "full":
        return 0.0
    return run.scanned.passes.resolution_m


def _calibration(run: Run, settings: MappingSettings) -> Calibration:
    """Of odometry that scans corrected, nothing is left to calibrate but what usually is left."""
    if run.scanned is None:
        return calibrate(run.odometry, run.detections, settings.calibration, settings.passes)
    usual = settings.systematic
    return Calibration(sigma=(usual.turn_rad_per_m, usual.turn_rad_per_rad, 0.0))


def _passes(run: Run, odometry: Odometry, settings: MappingSettings) -> Passes:
    """The passes of a run in the frame of its odometry as corrected so far."""
    if run.scanned is None:
        return fuse_passes(odometry, run.detections, settings.passes)
    return scanned_passes(odometry, run.scanned.passes, settings.passes)


def _noise(run: Run, odometry: Odometry, passes: Passes, settings: MappingSettings) -> RunNoise:
    if run.scanned is None:
        return estimate_noise(odometry, run.detections, passes, settings.noise)
    return run.scanned.noise


def _noise_settings(run: Run, settings: MappingSettings) -> NoiseSettings:
    """What is expected of the detector: scans have rates of their own."""
    if run.scanned is None:
        return settings.noise
    return replace(settings.noise, prior=run.scanned.noise)


def _systematic(calibration: Calibration, settings: MappingSettings) -> SystematicErrors:
    """What the calibration leaves of the constant errors: its sigma, and what it did not apply."""
    usual = settings.systematic
    left = np.hypot(calibration.sigma, np.subtract(calibration.estimate, calibration.applied))
    left = settings.calibration_doubt * left
    return SystematicErrors(
        turn_rad_per_m=float(left[0]) if np.isfinite(left[0]) else usual.turn_rad_per_m,
        turn_rad_per_rad=float(left[1]) if np.isfinite(left[1]) else usual.turn_rad_per_rad,
    )


def _require_motion(run: Run, reach_m: float) -> None:
    """DataError if the robot never got out of the one junction that it may have stood at."""
    xy = run.odometry.pose[:, :2]
    if len(xy) > 0 and np.hypot(*np.ptp(xy, axis=0)) < reach_m:
        raise DataError(
            f"run {run.name}: the odometry does not move: all of it lies within {reach_m:g} m; "
            "nothing can be mapped"
        )


def _require_passes(run: Run, passes: Passes) -> None:
    if len(passes) > 0:
        return
    if len(run.odometry) == 0:
        raise DataError(f"run {run.name}: holds no odometry; nothing can be mapped")
    if run.scanned is not None:
        raise DataError(f"run {run.name}: its scans show no junction; nothing can be mapped")
    if len(run.detections) == 0:
        raise DataError(f"run {run.name}: holds no junction detection; nothing can be mapped")
    raise DataError(
        f"run {run.name}: none of its {len(run.detections)} junction detections lies within the "
        "time of its odometry; check the clocks of the two topics"
    )


def _closures(closed: Closed, corrected: CorrectedPlaces, passes: Passes) -> tuple[Closure, ...]:
    """The record of the map: every identification made, refused and taken back."""
    asked = [*closed.asked, *corrected.asked]
    answers = [(_without_phantoms(q, corrected.place), False) for q in asked]
    answers += [(q, True) for q in closed.revised]
    answers.sort(key=lambda a: (a[0].second, a[0].first, a[0].round, a[1]))
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
            revised=earlier,
        )
        for q, earlier in answers
    )


def _without_phantoms(q: Identification, place: IntArray) -> Identification:
    """An identification is taken back with the place that it made, if that was a phantom."""
    if not q.accepted or min(place[q.first], place[q.second]) >= 0:
        return q
    return replace(q, accepted=False, reason=_PHANTOM, round=0, accepted_round=q.round)


def _info(
    run: Run,
    settings: MappingSettings,
    calibration: Calibration,
    walk: Walk,
    odometry: Odometry,
) -> dict[str, Any]:
    """What the document says about the making of the map."""
    pieces = len(np.unique(walk.chain))
    return {
        "source": dict(run.source),
        "settings": asdict(settings),
        "warnings": [*run.warnings, *split_told(run.odometry, odometry)],
        **({"pieces": pieces} if pieces > 1 else {}),
        **({"jumps": jumps_told(run.odometry, odometry)} if len(odometry.jumps) else {}),
        "calibration": {
            name: {
                "applied": calibration.applied[k],
                "estimate": calibration.estimate[k],
                "sigma": calibration.sigma[k] if np.isfinite(calibration.sigma[k]) else None,
            }
            for k, name in enumerate(("bias_rad_per_m", "turn_scale", "lag_s"))
        },
    }
