"""By how much the bias has left its own running mean: a surface that fails while it is little used moves it too far."""

from __future__ import annotations

import math

from task.rates import RATES


class Shift:
    """Compares the bias with its running mean, in units of what its drift allows for.

    Such a surface surprises no single sample; the bias takes up what it does wrong.
    """

    def __init__(self, drift: tuple[float, float, float], time: float, dt: float) -> None:
        """Take the bias's drift in a sample [rad/s2], the mean's time constant and the sample time [s]."""
        self._gain = min(dt / time, 1.0)
        # Of a random walk's distance from its own running mean.
        self._variance = [each * each / (2.0 * self._gain) for each in drift]
        self.restart([0.0] * RATES)

    def restart(self, bias: list[float]) -> None:
        """Take the bias (3,) [rad/s2] as it is."""
        self._mean = bias
        self.size = 0.0
        """How far the bias is from its mean, in standard deviations."""

    def learn(self, bias: list[float], levels: list[float], blind: tuple[bool, bool, bool]) -> None:
        """Take the bias (3,) [rad/s2], the turbulence's levels (3,) and the axes that tell nothing, which follow."""
        size = 0.0
        for axis, (found, mean, level) in enumerate(zip(bias, self._mean, levels, strict=True)):
            away = found - mean
            if blind[axis]:
                self._mean[axis] = found
            else:
                self._mean[axis] += self._gain * away
                size += away * away / (self._variance[axis] * level)
        self.size = math.sqrt(size)
