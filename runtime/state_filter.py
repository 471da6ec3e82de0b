"""Speed, angle of attack, sideslip, bank and pitch angle where their sensors are noisy: a filter that knows the model.

The rates have their own filters. What else starts an imagined flight, and what whoever flies reads, is as the sensors
say: differences of noisy readings would be motion that is not there.
"""

from __future__ import annotations

import math

import numpy as np

from task.model import N_REGRESSORS, kinematic_rates
from task.scheduling import LEAST_SPEED, Condition, schedule_angle
from task.state import N_IDENTIFIED, STATE

SIGNALS = (STATE.V, STATE.alpha, STATE.beta, STATE.phi, STATE.theta)
_MOVING = slice(STATE.V, STATE.beta + 1)
"""Those of them whose increments go on as the incremental model says."""
_TURNING = (STATE.phi, STATE.theta)


class StateFilter:
    """One gain for each signal, from the noise that is found in flight.

    With d the increment that the model expects (eq. 8.2 for V, alpha, beta; kinematics for phi, theta),
    e[k] = y[k] - y[k-1] - d[k] = g[k] + v[k] - v[k-1]: gusts g move the aircraft, the sensor's noise v does not. So
    -E[e[k] e[k-1]] is the variance r of v, however rough the air is. With q, the variance of g that is allowed for,

        x = x_ + K nu,   d = d_ + K^2 / (2 - K) nu,   nu = y - x_,   P = (q + sqrt(q^2 + 4 q r)) / 2,   K = P / (P + r)

    (the steady state of a random walk in noise, and Kalata's relation for its rate). A signal is filtered where r
    exceeds q for certain, and as measured everywhere else.
    """

    GUST = {STATE.V: 0.02, STATE.alpha: 1.5e-4, STATE.beta: 1.5e-4, STATE.phi: 1e-4, STATE.theta: 1e-4}
    """Square root of q: what the model may miss in a sample [m/s, rad]."""
    MEMORY = 500
    """Samples in the means."""
    LEAST = 100
    """Samples before anything is filtered."""
    CERTAIN = 4.0
    """Standard errors by which r must exceed zero."""
    STEADY = 0.02
    """Largest gain of d: were it as fast as the readings, gusts would be expected to go on, and look like noise."""
    SLOWEST = 0.03
    """Smallest K: the model and the filtered rates are not to be trusted for longer, however noisy a signal is."""
    WILDEST = 5.0
    """A sample counts as at most so many standard deviations: a step is no noise."""

    def __init__(self, learnt_at: Condition | None, dt: float) -> None:
        """``learnt_at``: where Theta is from, if it is to be taken to where the aircraft flies; dt: [s]."""
        self._learnt_at, self._dt = learnt_at, dt
        self._q = [self.GUST[signal] ** 2 for signal in SIGNALS]
        self._z, self._columns = np.zeros(N_REGRESSORS), np.zeros((N_REGRESSORS, 3))
        self._dx = self._z[:N_IDENTIFIED]
        self.reset()

    def reset(self) -> None:
        """Start a new flight: nothing is known of the noise."""
        self._mean_square, self._mean_product = [0.0] * len(SIGNALS), [0.0] * len(SIGNALS)
        self._seen = 0
        self._gains = [1.0] * len(SIGNALS)
        self.noisy = [False] * len(SIGNALS)
        """Whether V, alpha, beta, phi, theta are filtered."""
        self.any = False
        self.restart()

    def restart(self) -> None:
        """Begin after a gap: what was measured last is no neighbour."""
        self._measured: list[float] = []
        self._errors = [0.0] * len(SIGNALS)
        self._x = [0.0] * len(SIGNALS)
        self._z[:] = 0.0

    def hear(self, x: np.ndarray, rates: np.ndarray, step: np.ndarray, da: np.ndarray, theta: np.ndarray) -> None:
        """Take the state x (>= 10,) of the next sample.

        rates (3,), step (3,): p, q, r and their last increment, filtered [rad/s]; da (3,): increment of healthy
        deflection that moved the last increment of the state [rad]; theta (13, 10).
        """
        measured = [x.item(signal) for signal in SIGNALS]
        dx = self._dx
        if self._measured:
            self._z[N_IDENTIFIED:] = da
            dx[_MOVING] = self._z @ self._at(x, theta)
            expected = [dx.item(signal) for signal in SIGNALS]
            self._learn(measured, expected)
            for i, (y, d) in enumerate(zip(measured, expected, strict=True)):
                signal, gain = SIGNALS[i], self._gains[i]
                surprise = _difference(signal, y, self._x[i] + d)
                self._x[i] = y if gain == 1.0 else y - (1.0 - gain) * surprise
                if signal not in _TURNING:
                    dx[signal] += min(gain * gain / (2.0 - gain), self.STEADY) * surprise
        else:
            self._x = measured
        self._measured = measured
        dx[: STATE.r + 1] = step
        seen = x[:N_IDENTIFIED].copy()
        seen[: STATE.r + 1] = rates
        self.apply(seen)
        phi_dot, theta_dot, _, _ = kinematic_rates(seen).tolist()
        dx[STATE.phi], dx[STATE.theta] = self._dt * phi_dot, self._dt * theta_dot

    def apply(self, x: np.ndarray, dx: np.ndarray | None = None) -> None:
        """Put what is filtered into a state (>= 10,), and into its last increment (>= 10,), in place."""
        for i, (signal, noisy) in enumerate(zip(SIGNALS, self.noisy, strict=True)):
            if noisy:
                x[signal] = self._x[i]
                if dx is not None:
                    dx[signal] = self._dx[signal]

    def _at(self, x: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return the columns (13, 3) of V, alpha and beta of the model, here."""
        np.copyto(self._columns, theta[:, _MOVING])
        if self._learnt_at is not None and x[STATE.V] > LEAST_SPEED:
            for i, angle in enumerate((STATE.alpha, STATE.beta)):
                schedule_angle(self._columns[:, i + 1], angle, self._learnt_at, x, self._dt)
        return self._columns

    def _learn(self, measured: list[float], expected: list[float]) -> None:
        """Learn the noise from what the model did not expect of the last increments of the signals."""
        self._seen += 1
        share = 1.0 / min(self._seen, self.MEMORY)
        for i, (y, before, d) in enumerate(zip(measured, self._measured, expected, strict=True)):
            error = _difference(SIGNALS[i], y, before + d)
            square, product = self._mean_square[i], self._mean_product[i]
            if self._seen > self.LEAST:
                most = self.WILDEST * math.sqrt(max(square, self._q[i]))
                error = min(max(error, -most), most)
            square += share * (error * error - square)
            product += share * (error * self._errors[i] - product)
            self._errors[i], self._mean_square[i], self._mean_product[i] = error, square, product
            if self._seen > self.LEAST:
                r, q = -product, self._q[i]
                self.noisy[i] = r > q and r > self.CERTAIN * math.sqrt(share) * square
                p = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r)) if r > 0.0 else q
                self._gains[i] = max(p / (p + r), self.SLOWEST) if self.noisy[i] else 1.0
        self.any = True in self.noisy


def _difference(signal: int, a: float, b: float) -> float:
    """Return a - b, of bank angles the short way round."""
    return math.remainder(a - b, 2.0 * math.pi) if signal == STATE.phi else a - b
