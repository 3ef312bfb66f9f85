"""Connected components of a graph given by its links."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .arrays import IntArray


def connected(first: NDArray[Any], second: NDArray[Any], count: int) -> IntArray:
    """(count,) connected component of each of `count` nodes, numbered by their first nodes.

    first, second: (k,) nodes at the two ends of each link. O(count + k).
    """
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)
