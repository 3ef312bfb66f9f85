"""From a recorded run to its topological map: the whole chain, one step after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..topology.closure.gated import GatedSettings, Identification, gated_closure
from ..topology.closure.layout import lay_out
from ..topology.closure.rounds import RoundSettings, full_closure
from ..topology.closure.walk import make_walk
from ..topology.errors import DataError
from ..topology.mapbuilding import MapBuildingSettings, Visits, build_topomap
from ..topology.passes import Passes
from ..topology.topomap import Closure, RunNoise, TopoMap
from .passes import PassSettings, fuse_passes
from .run import Run

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """How a run becomes a map; part of the document, so that a map tells how it was made."""

    closure: Literal["none", "gated", "full"] = "full"
    passes: PassSettings = field(default_factory=PassSettings)
    rounds: RoundSettings = field(default_factory=RoundSettings)
    gated: GatedSettings = field(default_factory=GatedSettings)
    drawing: MapBuildingSettings = field(default_factory=MapBuildingSettings)
    most_refusals: int = 200
    """Refused identifications kept in the map: those with the most evidence."""


def build_map(
    run: Run,
    settings: MappingSettings = MappingSettings(),
    *,
    on_step: Callable[[str], None] | None = None,
) -> TopoMap:
    """The topological map of a run.

    Raises DataError if the run has no junction pass. `on_step` hears the name of each step before
    it begins.
    """
    step = on_step or (lambda name: None)
    step("passes")
    odometry = run.odometry
    passes = fuse_passes(odometry, run.detections, settings.passes)
    _require_passes(run, passes)
    noise = RunNoise()
    step("loop closure")
    walk = make_walk(odometry, passes, noise)
    if settings.closure == "none":
        place = np.arange(len(passes), dtype=np.int64)
        asked: list[Identification] = []
    elif settings.closure == "gated":
        place, asked = gated_closure(walk, settings.gated)
    if settings.closure == "full":
        closed = full_closure(walk, settings.rounds)
        place, layout, asked = closed.place, closed.layout, closed.asked
    else:
        layout = lay_out(walk, place)
    step("map")
    visits = Visits(passes.time_ns, place, np.ones(len(passes), bool), layout.pose, passes.centre)
    topomap = build_topomap(
        run.name,
        odometry,
        passes,
        xy=layout.xy,
        visits=visits,
        pass_vertex=place,
        pass_turn=layout.pose[:, 2],
        noise=noise,
        closures=_closures(asked, passes, settings.most_refusals),
        settings=settings.drawing,
    )
    return replace(topomap, info=_info(run, settings))


def _require_passes(run: Run, passes: Passes) -> None:
    if len(passes) > 0:
        return
    if len(run.odometry) == 0:
        raise DataError(f"run {run.name}: holds no odometry; nothing can be mapped")
    if len(run.detections) == 0:
        raise DataError(f"run {run.name}: holds no junction detection; nothing can be mapped")
    raise DataError(
        f"run {run.name}: none of its {len(run.detections)} junction detections lies within the "
        "time of its odometry; check the clocks of the two topics"
    )


def _closures(
    asked: list[Identification], passes: Passes, most_refusals: int
) -> tuple[Closure, ...]:
    """The record of the map: every identification, and the most doubtful refusals."""
    refused = sorted((q for q in asked if not q.accepted), key=lambda q: (-q.bits, q.first))
    kept = [q for q in asked if q.accepted] + refused[:most_refusals]
    times = passes.time_ns.tolist()
    return tuple(
        Closure(times[q.first], times[q.second], q.accepted, q.bits, q.reason)
        for q in sorted(kept, key=lambda q: (q.second, q.first))
    )


def _info(run: Run, settings: MappingSettings) -> dict[str, Any]:
    """What the document says about the making of the map."""
    return {
        "source": dict(run.source),
        "settings": asdict(settings),
        "warnings": list(run.warnings),
        "calibration": {},
    }
