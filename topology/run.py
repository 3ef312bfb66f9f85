"""A recorded run, whatever container it came in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .frozen import frozen_array
from .odometry import Odometry
from .ragged import Ragged


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Junction sightings, one row per message, in the robot's frame.

    time_ns: (k,) int64, not descending; centre: (k, 2) junction centre [m]; branches: k rows of
    headings [rad] in the order of the message. Messages in the odometry frame are turned into the
    robot's frame when they are read, so that the odometry can be corrected later.
    """

    time_ns: NDArray[np.int64]
    centre: NDArray[np.float64]
    branches: Ragged

    def __post_init__(self) -> None:
        time_ns = frozen_array(self.time_ns, np.int64, (None,), "time_ns")
        centre = frozen_array(self.centre, np.float64, (len(time_ns), 2), "centre")
        if len(self.branches) != len(time_ns):
            raise ValueError("one row of branches per detection is needed")
        if np.any(np.diff(time_ns) < 0):
            raise ValueError("detections must be in the order of time")
        object.__setattr__(self, "time_ns", time_ns)
        object.__setattr__(self, "centre", centre)

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One recorded run: `name` (file name without its suffix), odometry, detections.

    source: where it came from (topics used, types, counts), for the document's `graph.source`:
    JSON values that depend on the content alone, not on the container, the path or the machine.
    warnings: one sentence per thing found wrong with the log, with a count.
    """

    name: str
    odometry: Odometry
    detections: Detections
    source: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
