"""The views of two maps that tell most of a placement, to be shown."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...topology.matching.views import Compared, compared
from ...topology.se2 import turned
from .alignment import Candidate
from .prepare import Prepared
from .view_search import pictured


@dataclass(frozen=True, slots=True, eq=False)
class ShownViews:
    """A pair of views: the junction of either map nearest to its view, and both laid over each
    other, in the axes of a."""

    near_a: int
    near_b: int
    laid: Compared


def most_telling(a: Prepared, b: Prepared, c: Candidate) -> dict[int, ShownViews]:
    """Of the parts of the overlap that speak most for a placement, and most against it, the views
    that do so most; by the number of the part. None where none speaks."""
    bits, out = c.views.bits, {}
    if not len(c.views):
        return {}
    for part, sign in ((int(bits.argmax()), 1.0), (int(bits.argmin()), -1.0)):
        if sign * bits[part] > 0:
            own = np.flatnonzero(c.views.cell == part)
            k = own[np.argmax(sign * c.views.z[own])]
            out[part] = _laid(a, b, c, int(k))
    return out


def _laid(a: Prepared, b: Prepared, c: Candidate, k: int) -> ShownViews:
    """A pair of views, laid over each other as they were registered."""
    one, two = pictured(a.views), pictured(b.views)
    first, second = int(c.views.first[k]), int(c.views.second[k])
    seen = compared(one.index, two.index, (first, second), c.views.transform[k])
    return ShownViews(
        int(np.abs(a.z - one.place[first]).argmin()),
        int(np.abs(b.z - two.place[second]).argmin()),
        replace(seen, xy=turned(seen.xy, one.pose[first, 2])),
    )
