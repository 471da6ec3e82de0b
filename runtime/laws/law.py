"""What every classical law shares: its settings, the dynamic pressure that schedules it and the trim it starts from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar

import msgspec
import numpy as np

from task.config import Settings
from task.laws import LinearLaw
from task.limits import DT
from task.reward import ALTITUDE_LIMIT
from task.state import N_ACTION, N_REFERENCE, STATE

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Negative = Annotated[float, msgspec.Meta(lt=0.0)]
Row = tuple[float, float, float]

SEA_LEVEL_DENSITY = 1.225
"""Density of the standard atmosphere at sea level [kg/m3]."""
LAPSE = 2.25577e-5
"""Lapse rate over temperature at sea level, 0.0065 / 288.15 [1/m]."""
DENSITY_EXPONENT = 4.25588
"""g / (R lapse) - 1 of the troposphere [-]."""
TROPOPAUSE = 11_000.0
"""Altitude where the lapse ends [m]; the laws fly below it."""
PRESSURE_RATIO_RANGE = (0.2, 5.0)
"""Dynamic pressure over nominal is believed within these bounds only [-]."""
REFERENCE_RATE_LIMIT = 1.0
"""A reference that moves faster than this is a step, and its rate is cut [rad/s]."""


class Airframe(Settings, frozen=True, kw_only=True):
    """What a law knows of the healthy aircraft beforehand."""

    dynamic_pressure: Positive
    """Nominal dynamic pressure, at which everything here holds [Pa]."""
    trim_elevator: Row
    """Elevator of a steady flight [rad] as c0 + c1 s + c2 s^2, s = nominal over actual dynamic pressure."""
    effectiveness: tuple[Row, Row, Row]
    """Angular acceleration in p, q, r (row) for each rad of elevator, aileron, rudder (column) [1/s2]; grows with
    dynamic pressure."""
    dihedral: Negative
    """Roll acceleration for each rad of sideslip [1/s2]; grows with dynamic pressure."""


def air_density(altitude: float) -> float:
    """Return the density of the standard troposphere [kg/m3] at an altitude [m] (ISO 2533)."""
    return SEA_LEVEL_DENSITY * (1.0 - LAPSE * min(max(altitude, ALTITUDE_LIMIT), TROPOPAUSE)) ** DENSITY_EXPONENT


class Law:
    """Base of the laws: what the loop asks (:class:`runtime.policy.Policy`), and the scheduling.

    Vectors of three are plain floats: numpy's calls would cost more than the sums they make.
    """

    name = "law"
    """What the log calls it."""
    settings: ClassVar[type[Settings] | None] = None
    """Of a law of one's own: what its settings are, which its ``__init__`` takes after dt (docs/own.md)."""

    def __init__(self, airframe: Airframe, dt: float = DT) -> None:
        self._airframe = airframe
        self._dt = dt
        self.parameters = np.zeros(0, dtype=np.float32)
        """None: a law has nothing that a cast could blend."""
        self._action = np.zeros(N_ACTION)
        self._before: list[float] | None = None

    def reset(self) -> None:
        """Start a new flight."""
        self.restart_history()

    def restart_history(self) -> None:
        """Forget the last samples."""
        self._before = None

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad]; :meth:`runtime.policy.Policy.steer`."""
        raise NotImplementedError

    def sent(self, command: np.ndarray) -> None:
        """Take what was sent; a law without memory of it ignores it."""

    def match(self, delay: int, order: tuple[int, int, int], rate: float = math.inf) -> None:
        """Take what is believed to become of the commands; a law that cannot use it ignores it.

        delay: samples beyond the link's command lag; order: whose command acts as elevator, aileron and rudder;
        rate: how fast surfaces move at most [rad/s], which :meth:`sent` has in its commands then.
        """

    def inform(self, sure: Sequence[float | None], news: bool) -> None:
        """Take the effectiveness of elevator, aileron and rudder; a law that cannot use it ignores it.

        sure: signed, over that of the healthy aircraft [-], None where the sign is not known for sure; news: whether
        what is known is worth more than what a law finds itself.
        """

    def limit_alpha(self, highest: float, seen: bool) -> None:
        """Take the highest angle of attack that the elevator can hold; a law that cannot use it ignores it.

        highest: [rad], infinite for any; seen: whether the angle of attack that the law reads can be believed.
        """

    def limit_range(self, low: Sequence[float], high: Sequence[float]) -> None:
        """Take least and greatest deflection of each surface (3,) [rad]; a law that cannot use it ignores it."""

    def linear(self) -> LinearLaw:
        """Return how the law goes on from the last state it saw, for the imagination: linear, with its memory.

        Everything that is scheduled stays as it is now.
        """
        raise NotImplementedError

    def pressure_ratio(self, x: list[float]) -> float:
        """Return the dynamic pressure over nominal [-]; true airspeed is the inertial speed, as in still air."""
        pressure = 0.5 * air_density(x[STATE.h]) * x[STATE.V] * x[STATE.V]
        low, high = PRESSURE_RATIO_RANGE
        return min(max(pressure / self._airframe.dynamic_pressure, low), high)

    def trim(self, pressure_ratio: float) -> float:
        """Return the elevator of a steady flight [rad], the feed-forward of the pitch axis."""
        c0, c1, c2 = self._airframe.trim_elevator
        s = 1.0 / pressure_ratio
        return c0 + s * (c1 + s * c2)

    def reference_rates(self, reference: list[float]) -> list[float]:
        """Return how fast theta, phi and beta are asked to move [rad/s]; zero at the first sample and across a gap."""
        before, self._before = self._before, reference
        if before is None:
            return [0.0] * N_REFERENCE
        limit = REFERENCE_RATE_LIMIT
        return [min(max((now - then) / self._dt, -limit), limit) for now, then in zip(reference, before, strict=True)]


def attitude_rates(x: list[float]) -> tuple[float, float]:
    """Return d/dt of theta and phi [rad/s] of a state (12,): the kinematics of :func:`task.model.kinematic_rates`."""
    p, q, r, phi, theta = x[STATE.p], x[STATE.q], x[STATE.r], x[STATE.phi], x[STATE.theta]
    sin_phi, cos_phi = math.sin(phi), math.cos(phi)
    return q * cos_phi - r * sin_phi, p + (q * sin_phi + r * cos_phi) * math.tan(theta)
