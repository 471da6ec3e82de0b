"""What sensors and air do to the measured rates: white noise of the gyros, and turbulence, both found in flight."""

from __future__ import annotations

import math

import numpy as np

from task.rates import RATES

Three = tuple[float, float, float]


def _third_difference(past: list[Three], now: Three) -> tuple[list[Three], Three]:
    """Return the last three values with the new one, and their third difference with it."""
    one, two, three = past
    p, q, r = (d - a + 3.0 * (b - c) for a, b, c, d in zip(one, two, three, now, strict=True))
    return [two, three, now], (p, q, r)


def _dot(a: Three, b: Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


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
    LATELY, BROKEN = 9, 16.0
    """Gyros have become noisier once most of so many samples are this many times as loud as they should be, and the
    attitude knows nothing of it."""
    SHARED_MOTION = 0.5
    """Share of the third differences that the attitude must confirm for the aircraft to be what moves: 0.9 to 1.8 where
    it swings surfaces to and fro, 0.2 and less where gyros are noisy."""
    LOUDEST = 2.0
    """The loudest of them is taken for so many times the variance: it is 2.9 times in the mean of five."""
    FADES = 0.02
    """What a sample counts for in the noise that has come so [-]."""
    SHARED = 0.003
    """Every axis has at least this share of the roughest one's level: gusts on the pitch axis come seldom and hard."""
    ROUGH = 9.0
    """A squared innovation counts as at most this many times its variance: one sample is no turbulence."""
    WILDEST = 1e6
    """No air asks for more than this; states that were garbage for a while would, and the level falls slowly."""

    def __init__(self, least_noise: float, noise_gain: float, unrest_gain: float) -> None:
        """Take the least standard deviation of the noise [rad/s] and what one sample counts for in each mean [-]."""
        self._least, self._noise_gain, self._unrest_gain = least_noise**2, noise_gain, unrest_gain
        self._past: list[Three] = []
        self.reset()

    def reset(self) -> None:
        """Start a new flight."""
        self.noise_variance = self._least
        """Of the measured rates [rad2/s2], as learnt since the flight began."""
        self._besides = [0.0] * RATES
        """What gyros have besides since one of them broke [rad2/s2]."""
        self.broke = False
        """Whether gyros are taken to be far noisier from this sample on."""
        self.levels = [1.0] * RATES
        """How many times the drift (variance) of the bias of p, q, r is what still air asks for."""
        self.seen = 0

    def restart(self, w: Three) -> None:
        """Begin after a gap with the rates w [rad/s]: the last ones are no neighbours."""
        self._past = [w, w, w]
        self._past_turning = [w, w, w]
        still: list[Three] = [(0.0, 0.0, 0.0)] * (self.LATELY + 1)
        self._thirds, self._thirds_turning = still.copy(), still.copy()

    @property
    def variances(self) -> list[float]:
        """Return the noise's variance on p, q, r [rad2/s2]."""
        return [self.noise_variance + each for each in self._besides]

    @property
    def ends_a_phase(self) -> bool:
        """Whether noise or turbulence are known from this sample on."""
        return self.seen in (self.LEARNING, 3 * self.LEARNING)

    @property
    def known(self) -> bool:
        """Whether noise and turbulence have both been looked at for long enough."""
        return self.seen > 3 * self.LEARNING

    def hear(self, w: Three, turning: Three) -> None:
        """Learn the noise from the next measured rates w, and from what the attitude says of them [rad/s]."""
        self._past, third = _third_difference(self._past, w)
        self._past_turning, third_turning = _third_difference(self._past_turning, turning)
        p, q, r = third
        seen = (p * p + q * q + r * r) / (20.0 * RATES)
        self._thirds = [*self._thirds[1:], third]
        self._thirds_turning = [*self._thirds_turning[1:], third_turning]
        self.seen += 1
        self.broke = False
        if self.seen > self.LEARNING:
            self._hear_breakage(seen)
            if any(self._besides):
                return
            seen = min(seen, self.LOUD * self.noise_variance)
        gain = max(self._noise_gain, 1.0 / self.seen)
        learnt = self.noise_variance + gain * (seen - self.noise_variance)
        self.noise_variance = max(learnt, self._least)

    def _hear_breakage(self, seen: float) -> None:
        """Find gyros that have become noisier, or less so again; seen: the variance that this sample speaks for."""
        enough = self.BROKEN * (self.noise_variance + sum(self._besides) / RATES)
        if seen > enough and self._loud(20.0 * RATES * enough):
            self.broke = True
            for axis, each in enumerate(zip(*self._thirds[1:], strict=True)):
                noise = max(third * third for third in each) / (20.0 * self.LOUDEST)
                if noise > self.LOUD * self.noise_variance:
                    self._besides[axis] = max(self._besides[axis], noise - self.noise_variance)
        elif any(self._besides):
            for axis, third in enumerate(self._thirds[-1]):
                known = self.noise_variance + self._besides[axis]
                now = known + self.FADES * (min(third * third / 20.0, self.LOUD * known) - known)
                self._besides[axis] = max(now - self.noise_variance, 0.0)

    def _loud(self, enough: float) -> bool:
        """Return whether most squared third differences of late are beyond ``enough``, and not the aircraft's."""
        if _median([_dot(each, each) for each in self._thirds[1:]]) <= enough:
            return False
        # The attitude is integrated with the rates after a step, before it, or with both.
        after, before = np.array(self._thirds[1:]), np.array(self._thirds[:-1])
        turning = np.array(self._thirds_turning[1:])
        return all(
            np.vdot(moved, turning) < self.SHARED_MOTION * np.vdot(moved, moved)
            for moved in (after, before, 0.5 * (after + before))
        )

    def feel(self, surprise: Three) -> None:
        """Learn the turbulence from each axis's squared innovation over its variance."""
        if self.seen <= self.LEARNING:
            return
        gain = max(self._unrest_gain, 1.0 / (self.seen - self.LEARNING + 5))
        least = max(1.0, self.SHARED * max(self.levels))
        for axis, each in enumerate(surprise):
            counts = each if each < self.ROUGH else self.ROUGH  # so does what is no number
            self.levels[axis] = min(max(self.levels[axis] * math.exp(gain * (counts - 1.0)), least), self.WILDEST)
