"""Three PID loops, for pitch, bank and sideslip, scheduled with dynamic pressure."""

from __future__ import annotations

import numpy as np

from runtime.laws.law import Airframe, Law, Row, attitude_rates
from task.config import Settings
from task.laws import N_MEMORY, N_SEEN, SEEN, LinearLaw
from task.limits import DEFLECTION_LIMIT, DT
from task.state import ACTION, N_ACTION, N_REFERENCE, REFERENCE, STATE, TRACKED

SIGNS = (-1.0, -1.0, 1.0)
"""Elevator, aileron, rudder that raise theta, phi, beta."""


class PIDGains(Settings, frozen=True, kw_only=True):
    """Gains of the loops at nominal dynamic pressure: P [-], I [1/s], D [s], deflection over error."""

    theta: Row
    """Pitch to elevator."""
    phi: Row
    """Bank to aileron."""
    beta: Row
    """Sideslip to rudder."""
    schedule: Row
    """Power of nominal over actual dynamic pressure that multiplies the gains of theta, phi, beta [-]."""


class PID(Law):
    """u = u_trim + sign (qbar0/qbar)^n (K_P e + K_I integral(e) + K_D de/dt), for theta, phi and beta.

    de/dt is the reference's rate less the attitude's, the latter from the rate gyros by exact kinematics; sideslip is
    differenced. An integral rests while it would push its surface further beyond the limit.
    """

    name = "pid"

    def __init__(self, airframe: Airframe, gains: PIDGains, dt: float = DT) -> None:
        super().__init__(airframe, dt)
        self._gains = (gains.theta, gains.phi, gains.beta)
        self._schedule = gains.schedule
        self._integral = [0.0] * N_REFERENCE
        self._beta = 0.0
        self._ratio = 1.0

    def reset(self) -> None:
        """Start a new flight: nothing is integrated."""
        super().reset()
        self._integral = [0.0] * N_REFERENCE

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad], within the limits of the task."""
        now, asked = x.tolist(), reference.tolist()
        if self._before is None:
            self._beta = now[STATE.beta]
        wanted = self.reference_rates(asked)
        theta_rate, phi_rate = attitude_rates(now)
        rates = (theta_rate, phi_rate, (now[STATE.beta] - self._beta) / self._dt)
        self._beta = now[STATE.beta]
        angles = (now[STATE.theta], now[STATE.phi], now[STATE.beta])
        ratio = self._ratio = self.pressure_ratio(now)
        feed_forward = (self.trim(ratio), 0.0, 0.0)
        for axis in range(N_REFERENCE):
            kp, ki, kd = self._gains[axis]
            scale = SIGNS[axis] * ratio ** -self._schedule[axis]
            error = asked[axis] - angles[axis]
            integral = self._integral[axis] + error * self._dt
            free = feed_forward[axis] + scale * (kp * error + kd * (wanted[axis] - rates[axis]))
            u = free + scale * ki * integral
            if abs(u) <= DEFLECTION_LIMIT or u * scale * error < 0.0:
                self._integral[axis] = integral
            else:
                u = free + scale * ki * self._integral[axis]
            self._action[axis] = min(max(u, -DEFLECTION_LIMIT), DEFLECTION_LIMIT)
        return self._action

    def linear(self) -> LinearLaw:
        """Return the law with its integrals as memory; they do not rest at a limit."""
        maps, memory = np.zeros((N_ACTION + N_MEMORY, N_MEMORY + N_SEEN)), np.zeros(N_MEMORY)
        memory[:N_REFERENCE] = self._integral
        v, memorised, seen = maps[:N_ACTION], maps[N_ACTION:], N_MEMORY
        v[ACTION.de, seen + SEEN.one.start] = self.trim(self._ratio)
        for axis, state in enumerate(TRACKED):
            kp, ki, kd = self._gains[axis]
            scale = SIGNS[axis] * self._ratio ** -self._schedule[axis]
            asked, angle = seen + SEEN.reference.start + axis, seen + SEEN.x.start + state
            memorised[axis, axis] = 1.0
            memorised[axis, [asked, angle]] = self._dt, -self._dt
            v[axis, axis] = scale * ki
            v[axis, [asked, angle]] = np.array([1.0, -1.0]) * scale * (kp + ki * self._dt)
            rate, increment = seen + SEEN.rate.start + axis, seen + SEEN.dx.start + state
            v[axis, [rate, increment]] = scale * kd, -scale * kd / self._dt
        return LinearLaw(maps, memory)


assert [int(a) for a in ACTION] == [int(r) for r in REFERENCE], "loop i moves surface i"
