"""A second-order Butterworth low-pass for vectors, in place."""

from __future__ import annotations

import math

import numpy as np


class LowPass:
    """y = H(z) x with a cut-off [Hz], by the bilinear transform, in transposed direct form II."""

    def __init__(self, cutoff: float, dt: float, size: int) -> None:
        k = math.tan(math.pi * min(cutoff * dt, 0.499))
        scale = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
        self._b0 = k * k * scale
        self._a1 = 2.0 * (k * k - 1.0) * scale
        self._a2 = (1.0 - math.sqrt(2.0) * k + k * k) * scale
        self.settling = math.ceil(3.0 / (cutoff * dt))
        """Samples after which less than 2e-6 of an initial condition is left."""
        self._first, self._second = np.zeros(size), np.zeros(size)
        self._input, self._product = np.zeros(size), np.zeros(size)

    def reset(self) -> None:
        """Forget the past."""
        self._first[:] = 0.0
        self._second[:] = 0.0

    def filter(self, x: np.ndarray) -> None:
        """Replace x (size,) by its low-passed value."""
        np.multiply(x, self._b0, out=self._input)
        np.add(self._input, self._first, out=x)
        np.multiply(x, self._a1, out=self._product)
        np.subtract(self._second, self._product, out=self._first)
        np.add(self._first, self._input, out=self._first)
        np.add(self._first, self._input, out=self._first)
        np.multiply(x, self._a2, out=self._product)
        np.subtract(self._input, self._product, out=self._second)
