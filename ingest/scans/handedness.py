"""Whether scans turn as the odometry does: those of a laser upside down turn the other way.

Seen from above, what such a laser sees is a mirror image, and matching mirror images gives turns of
the wrong sign, whatever else the odometry gets wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.errors import DataError
from ...topology.se2 import wrap

TURN_RAD = 0.05
"""A step that turns by more, by scans and odometry, turns beyond the errors of both."""
ENOUGH = 20
"""Steps, of a turn about once, after which chance alone gives 4 of 5 one time in 170."""
SAME_SHARE = 0.8
"""Of the steps so many turn one way, or neither hand fits."""


class MirroredError(DataError):
    """The scans are mirror images of what is around: they turn against the odometry."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Steps between keyframes that turn as the odometry says, and against it."""

    alike: int = 0
    against: int = 0

    def more(self, recorded: FloatArray, matched: FloatArray, piece: IntArray) -> Turns:
        """With those between poses (k, 3) that follow on one another, by odometry and by scans."""
        odometry, scans = (wrap(np.diff(pose[:, 2])) for pose in (recorded, matched))
        tells = (np.abs(odometry) > TURN_RAD) & (np.abs(scans) > TURN_RAD) & (np.diff(piece) == 0)
        alike = int(np.sum(odometry[tells] * scans[tells] > 0))
        return Turns(self.alike + alike, self.against + int(tells.sum()) - alike)

    @property
    def enough(self) -> bool:
        """Whether there are steps enough to tell."""
        return self.alike + self.against >= ENOUGH

    @property
    def mirrored(self) -> bool:
        """Whether it is the scans' mirror images that turn as the odometry does."""
        return self.enough and self.against >= SAME_SHARE * (self.alike + self.against)

    @property
    def unlike(self) -> bool:
        """Whether neither the scans nor their mirror images do."""
        return (
            self.enough
            and not self.mirrored
            and self.alike < SAME_SHARE * (self.alike + self.against)
        )

    def __str__(self) -> str:
        return f"against the odometry at {self.against} of {self.alike + self.against} turns"
