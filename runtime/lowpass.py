"""A second-order Butterworth low-pass for vectors, in place."""

from __future__ import annotations

import math

import numpy as np


class LowPass:
    """y = H(z) x with a cut-off [Hz], by the bilinear transform, in transposed direct form II."""

    def __init__(self, cutoff: float, dt: float, size: int) -> None:
        k = math.tan(math.pi * min(cutoff * dt, 0.499))
        scale = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
        self.b0 = k * k * scale
        self.a1 = 2.0 * (k * k - 1.0) * scale
        self.a2 = (1.0 - math.sqrt(2.0) * k + k * k) * scale
        self.settling = math.ceil(3.0 / (cutoff * dt))
        """Samples after which less than 2e-6 of an initial condition is left."""
        self.first, self.second = np.zeros(size), np.zeros(size)
        """What it remembers."""
        self._input, self._product = np.zeros(size), np.zeros(size)

    def reset(self) -> None:
        """Forget the past."""
        self.first[:] = 0.0
        self.second[:] = 0.0

    def filter(self, x: np.ndarray) -> None:
        """Replace x (size,) by its low-passed value."""
        np.multiply(x, self.b0, out=self._input)
        np.add(self._input, self.first, out=x)
        np.multiply(x, self.a1, out=self._product)
        np.subtract(self.second, self._product, out=self.first)
        np.add(self.first, self._input, out=self.first)
        np.add(self.first, self._input, out=self.first)
        np.multiply(x, self.a2, out=self._product)
        np.subtract(self._input, self._product, out=self.second)
