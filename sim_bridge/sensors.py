"""What the sensors say of the state: ideal by default; noise, bias, delay and stuck readings as settings or faults."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec
import numpy as np

from task.config import Settings
from task.limits import DT
from task.state import N_STATE, STATE

SignalName = Literal["p", "q", "r", "V", "alpha", "beta", "phi", "theta", "psi", "h", "xe", "ye"]
"""A measured signal, as :class:`task.state.STATE` names it."""
DRAWN = 128
"""Samples whose noise is drawn at once."""
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]


LARGEST: dict[str, tuple[float, str]] = {
    **dict.fromkeys(("p", "q", "r"), (5.0, "rad/s")),
    **dict.fromkeys(("alpha", "beta", "phi", "theta", "psi"), (3.15, "rad")),
    "V": (200.0, "m/s"),
    **dict.fromkeys(("h", "xe", "ye"), (10000.0, "m")),
}
"""Largest noise or bias of each signal and its unit: what is larger is a mistake, and nothing flies by it."""


def check_error(key: str, signal: SignalName, value: float, times: float = 1.0) -> None:
    """Raise ValueError where the noise or bias of a signal is larger than so many times the largest."""
    most, unit = times * LARGEST[signal][0], LARGEST[signal][1]
    if not abs(value) <= most:  # not a number is never
        raise ValueError(f"{key}: expected at most {most:g} {unit} either way, got {value:g}")


class SensorSettings(Settings, frozen=True):
    """How a flight's sensors are; the defaults are ideal."""

    noise: dict[SignalName, NotNegative] = {}
    """Standard deviation of white noise, by signal, in its SI unit."""
    bias: dict[SignalName, float] = {}
    """Constant error, by signal, in its SI unit."""
    delay: Annotated[float, msgspec.Meta(ge=0.0, le=2.0)] = 0.0
    """Delay of all signals [s], rounded to samples."""

    def __post_init__(self) -> None:
        """Check each signal against the largest error of its kind."""
        for field in ("noise", "bias"):
            for name, value in getattr(self, field).items():
                check_error(f"{field}.{name}", name, value)


class Sensors:
    """Sensors of one flight; all randomness comes from the generator."""

    def __init__(self, settings: SensorSettings, rng: np.random.Generator, dt: float = DT) -> None:
        """Take settings, generator and sample time [s]."""
        self._rng = rng
        self._dt = dt
        self._noise = np.zeros(N_STATE)
        self._bias = np.zeros(N_STATE)
        for name, deviation in settings.noise.items():
            self._noise[STATE[name]] = deviation
        for name, bias in settings.bias.items():
            self._bias[STATE[name]] = bias
        self._own = (self._noise.copy(), self._bias.copy(), settings.delay)
        self._delay = settings.delay
        self._stuck = np.zeros(N_STATE, dtype=bool)
        self._last = np.full(N_STATE, np.nan)
        self._past: list[np.ndarray] = []
        self._drawn: Iterator[np.ndarray] = iter(())
        self._update()

    def impair(self, noise: dict[int, float], bias: dict[int, float], delay: float, stuck: set[int]) -> None:
        """Set what faults add to the settings, by state index: deviations, biases, delay [s], stuck signals."""
        own_noise, own_bias, own_delay = self._own
        self._noise, self._bias = own_noise.copy(), own_bias.copy()
        for index, deviation in noise.items():
            self._noise[index] = np.hypot(self._noise[index], deviation)
        for index, value in bias.items():
            self._bias[index] += value
        self._delay = own_delay + delay
        self._stuck = np.isin(np.arange(N_STATE), list(stuck))
        self._update()

    def measure(self, x: np.ndarray) -> np.ndarray:
        """Return the readings (12,) for the state x (12,); x itself is returned when the sensors are ideal."""
        if self._ideal:
            self._last = x
            return x
        delayed = self._delayed(x)
        reading = delayed + self._bias
        reading += self._noise * self._normal()
        if self._any_stuck:
            held = self._stuck & np.isfinite(self._last)
            reading[held] = self._last[held]
        self._last = reading
        return reading

    def _normal(self) -> np.ndarray:
        """Return the next twelve normal numbers: always twelve, so that one signal's noise is not another's.

        Drawn a block at a time, which costs a tenth and gives the same numbers.
        """
        if (numbers := next(self._drawn, None)) is None:
            self._drawn = iter(self._rng.standard_normal((DRAWN, N_STATE)))
            numbers = next(self._drawn)
        return numbers

    def _update(self) -> None:
        self._samples = round(self._delay / self._dt)
        self._any_stuck = bool(self._stuck.any())
        self._ideal = not (self._noise.any() or self._bias.any() or self._samples or self._any_stuck)
        if not self._samples:
            self._past.clear()  # nothing is kept while there is no delay: another one must not begin with what is old

    def _delayed(self, x: np.ndarray) -> np.ndarray:
        if not self._samples:
            return x
        self._past.append(x.copy())
        del self._past[: -self._samples - 1]
        return self._past[0]
