"""Random numbers that are the same on every machine and with every version of numpy.

numpy guarantees the raw output of its bit generators but not that of its distributions, and the
last digits of transcendental functions depend on the processor. The distributions here are computed
from raw bits, and results of transcendental functions are rounded well above their last digit.
"""

from __future__ import annotations

import zlib

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray


def quantised(values: FloatArray | float, bits: int) -> FloatArray:
    """Values rounded to multiples of 2^-bits, so that sums are exact and independent of their
    order."""
    grid = float(2**bits)
    return np.round(np.asarray(values, np.float64) * grid) / grid + 0.0


class Chance:
    """A random stream with a key of integers and strings.

    Streams of different keys are independent, so that a further draw in one place changes nothing
    elsewhere.
    """

    def __init__(self, *key: int | str) -> None:
        words = [zlib.crc32(k.encode()) if isinstance(k, str) else k for k in key]
        self._bits = np.random.PCG64(np.random.SeedSequence(words))

    def uniform(self, low: float, high: float, size: int) -> FloatArray:
        """(size,) uniform in [low, high)."""
        raw = self._bits.random_raw(size)
        unit = (raw >> np.uint64(11)).astype(np.float64) * 2.0**-53
        return low + (high - low) * unit

    def around(self, half: float, size: int) -> FloatArray:
        """(size,) uniform in [-half, half)."""
        return self.uniform(-half, half, size)

    def normal(self, sigma: float, size: int) -> FloatArray:
        """(size,) normal with mean 0, by inverse transform sampling."""
        from scipy.special import ndtri

        u = self.uniform(2.0**-54, 1.0, size)
        return sigma * quantised(ndtri(u), 32)

    def happens(self, probability: float, size: int) -> BoolArray:
        """(size,) True with the given probability, independently."""
        return self.uniform(0.0, 1.0, size) < probability

    def one_uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """One number in [low, high)."""
        return float(self.uniform(low, high, 1)[0])

    def one_normal(self, sigma: float) -> float:
        """One normal number with mean 0."""
        return float(self.normal(sigma, 1)[0])

    def one_happens(self, probability: float) -> bool:
        """True with the given probability."""
        return self.one_uniform() < probability

    def index(self, count: int) -> int:
        """Uniform in 0 … count - 1."""
        return min(int(self.one_uniform() * count), count - 1)

    def weighted_index(self, weights: FloatArray) -> int:
        """An index drawn with probability proportional to its non-negative weight."""
        total = np.cumsum(weights)
        at = self.one_uniform() * total[-1]
        return min(int(np.searchsorted(total, at, side="right")), len(total) - 1)

    def order(self, count: int) -> IntArray:
        """(count,) a random permutation of 0 … count - 1."""
        return np.argsort(self.uniform(0.0, 1.0, count), kind="stable")
