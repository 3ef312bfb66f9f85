"""How legs of the track move when the odometry's heading has a systematic error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .odometry import Odometry
from .se2 import FloatArray, between


def leg_sensitivity(
    odometry: Odometry, from_ns: NDArray[np.int64], to_ns: NDArray[np.int64]
) -> FloatArray:
    """(m, 3, 2) derivative of T_from_to by a heading bias per metre and a scale of turns.

    What `SharedErrors.sensitivity` of `posegraph` takes for legs measured by the odometry between
    two times (m,) each, in either order. Legs must not cross a break. An error dg of the heading at
    one step turns all that follows about that step: with g the way driven (or the angle turned),
    dT = (R_fromᵀ J ∫ (p_to − p) dg, g_to − g_from), J the quarter turn; the integral is a
    difference of prefix sums. O(n + m log n).
    """
    way, turned = np.cumsum(odometry.step_m), np.cumsum(odometry.turn_rad)
    p = odometry.pose[:, :2]
    middle = np.concatenate([p[:1], 0.5 * (p[1:] + p[:-1])])
    origin = odometry.time_ns[0]
    time_s = (odometry.time_ns - origin) * 1e-9
    begin, end = ((np.asarray(t, np.int64) - origin) * 1e-9 for t in (from_ns, to_ns))
    T_odom_from, T_odom_to = odometry.at(from_ns), odometry.at(to_ns)
    leg = between(T_odom_from, T_odom_to)
    c, s = np.cos(T_odom_from[:, 2]), np.sin(T_odom_from[:, 2])
    out = np.zeros((len(leg), 3, 2))
    for k, g in enumerate((way, turned)):
        gain = np.interp(end, time_s, g) - np.interp(begin, time_s, g)
        moment = np.cumsum(middle * np.diff(g, prepend=g[:1])[:, None], axis=0)
        passed = np.column_stack(
            [
                np.interp(end, time_s, moment[:, axis]) - np.interp(begin, time_s, moment[:, axis])
                for axis in range(2)
            ]
        )
        arm = T_odom_to[:, :2] * gain[:, None] - passed
        turned_arm = np.column_stack([-arm[:, 1], arm[:, 0]])
        out[:, 0, k] = c * turned_arm[:, 0] + s * turned_arm[:, 1]
        out[:, 1, k] = c * turned_arm[:, 1] - s * turned_arm[:, 0]
        out[:, 2, k] = gain
    return out
