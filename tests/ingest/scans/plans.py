"""Floor plans of grids drawn by hand."""

from __future__ import annotations

import numpy as np

from topobatch.ingest.scans.floorplan import Floorplan, FloorplanSettings, Ground, plan


def planned(free: np.ndarray, cell_m: float, frontier: np.ndarray | None = None) -> Floorplan:
    """The plan of free cells by the usual settings; frontier: those next to unknown ones."""
    settings = FloorplanSettings()
    edge = np.zeros_like(free) if frontier is None else frontier
    return plan(Ground.of(free, edge, cell_m, settings.skeleton.clearance_m), settings)
