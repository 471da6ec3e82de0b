"""What sensors and air do to the measured rates: white noise of the gyros, and turbulence, both found in flight."""

from __future__ import annotations

import math

from task.rates import RATES

Three = tuple[float, float, float]


class Unrest:
    """The level of sensor noise and of turbulence, so that no threshold must know them beforehand.

    Noise is the variance of the rates' third difference: motion has next to none at 100 Hz, white noise twenty times
    its own. Turbulence is by how much the drift of each axis's bias must be raised for its normalised innovations
    squared to be 1 on average: gusts last longer than a sample, and so does the bias; were they taken for white noise
    of the rates, the innovations would not be white and every sum of them would alarm.
    """

    LEARNING = 100
    """So many samples are looked at for noise alone, and twice as many again for turbulence."""
    LOUD = 4.0
    """A sample counts as at most this many times the noise that is known: a fault is no noise."""
    SHARED = 0.003
    """Every axis has at least this share of the roughest one's level: gusts on the pitch axis come seldom and hard."""
    ROUGH = 9.0
    """A squared innovation counts as at most this many times its variance: one sample is no turbulence."""

    def __init__(self, least_noise: float, noise_gain: float, unrest_gain: float) -> None:
        """Take the least standard deviation of the noise [rad/s] and what one sample counts for in each mean [-]."""
        self._least, self._noise_gain, self._unrest_gain = least_noise**2, noise_gain, unrest_gain
        self._past: list[Three] = []
        self.reset()

    def reset(self) -> None:
        """Start a new flight."""
        self.noise_variance = self._least
        """Of the measured rates [rad2/s2]."""
        self.levels = [1.0] * RATES
        """How many times the drift (variance) of the bias of p, q, r is what still air asks for."""
        self.seen = 0

    def restart(self, w: Three) -> None:
        """Begin after a gap with the rates w [rad/s]: the last ones are no neighbours."""
        self._past = [w, w, w]

    @property
    def noise_known(self) -> bool:
        """Whether the samples for noise alone are over."""
        return self.seen >= self.LEARNING

    @property
    def ends_a_phase(self) -> bool:
        """Whether noise or turbulence are known from this sample on."""
        return self.seen in (self.LEARNING, 3 * self.LEARNING)

    @property
    def known(self) -> bool:
        """Whether noise and turbulence have both been looked at for long enough."""
        return self.seen > 3 * self.LEARNING

    def hear(self, w: Three) -> None:
        """Learn the noise from the next measured rates w [rad/s]."""
        one, two, three = self._past
        seen = 0.0
        for a, b, c, d in zip(one, two, three, w, strict=True):
            third = d - a + 3.0 * (b - c)
            seen += third * third
        seen /= 20.0 * RATES
        self._past = [two, three, w]
        self.seen += 1
        if self.seen > self.LEARNING:
            seen = min(seen, self.LOUD * self.noise_variance)
        gain = max(self._noise_gain, 1.0 / self.seen)
        learnt = self.noise_variance + gain * (seen - self.noise_variance)
        self.noise_variance = max(learnt, self._least)

    def feel(self, surprise: Three) -> None:
        """Learn the turbulence from each axis's squared innovation over its variance."""
        if self.seen <= self.LEARNING:
            return
        gain = max(self._unrest_gain, 1.0 / (self.seen - self.LEARNING + 5))
        least = max(1.0, self.SHARED * max(self.levels))
        for axis, each in enumerate(surprise):
            self.levels[axis] = max(self.levels[axis] * math.exp(gain * (min(each, self.ROUGH) - 1.0)), least)
