"""Detection of lasers mounted upside down: their scans turn against the odometry.

Seen from above, the scans of such a laser are mirror images, and matching them gives rotations of
the wrong sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.errors import DataError
from ...topology.se2 import wrap

TURN_RAD = 0.05
"""Rotations larger than this, by scans and odometry, exceed the errors of both."""
ENOUGH = 20
"""Number of steps, about one full turn, after which chance alone gives 4 of 5 once in 170 times."""
SAME_SHARE = 0.8
"""Least share of the steps with one sign; with less, neither mounting fits."""


class MirroredError(DataError):
    """The scans are mirror images: they turn against the odometry."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Numbers of steps between keyframes that turn with the odometry, and against it."""

    alike: int = 0
    against: int = 0

    def more(self, recorded: FloatArray, matched: FloatArray, piece: IntArray) -> Turns:
        """Add the steps between consecutive poses (k, 3), by odometry and by scans."""
        odometry, scans = (wrap(np.diff(pose[:, 2])) for pose in (recorded, matched))
        tells = (np.abs(odometry) > TURN_RAD) & (np.abs(scans) > TURN_RAD) & (np.diff(piece) == 0)
        alike = int(np.sum(odometry[tells] * scans[tells] > 0))
        return Turns(self.alike + alike, self.against + int(tells.sum()) - alike)

    @property
    def enough(self) -> bool:
        """Whether there are enough steps to decide."""
        return self.alike + self.against >= ENOUGH

    @property
    def mirrored(self) -> bool:
        """Whether the scans turn against the odometry."""
        return self.enough and self.against >= SAME_SHARE * (self.alike + self.against)

    @property
    def unlike(self) -> bool:
        """Whether the scans turn neither with nor against the odometry."""
        return (
            self.enough
            and not self.mirrored
            and self.alike < SAME_SHARE * (self.alike + self.against)
        )

    def __str__(self) -> str:
        return f"against the odometry at {self.against} of {self.alike + self.against} turns"
