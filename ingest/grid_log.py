"""An occupancy grid from a log or a file, in place of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..topology.run import Grid


@dataclass(frozen=True, slots=True)
class GridLog:
    """A grid as it was saved or recorded; name, source, warnings: see `Run`."""

    name: str
    grid: Grid
    source: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
