"""Speed, angle of attack, sideslip, bank and pitch angle where their sensors are noisy: a filter that knows the model.

The rates have their own filters. What else starts an imagined flight, and what whoever flies reads, is as the sensors
say: differences of noisy readings would be motion that is not there.
"""

from __future__ import annotations

import math

import numpy as np

from task.model import N_REGRESSORS
from task.rates import dynamic_pressure
from task.scheduling import AERODYNAMIC, GRAVITY, LEAST_SPEED, Condition
from task.state import N_IDENTIFIED, STATE

SIGNALS = (STATE.V, STATE.alpha, STATE.beta, STATE.phi, STATE.theta)
_MOVING = slice(STATE.V, STATE.beta + 1)
"""Those of them whose increments go on as the incremental model says."""
_BANK, _PITCH = 3, 4
"""Places of the attitude among them."""
_FORCES = len((STATE.alpha, STATE.beta))
"""Angles whose columns of the model go with the flight condition."""


class StateFilter:
    """One gain for each signal, from the noise that is found in flight.

    With d the increment that the model expects (eq. 8.2 for V, alpha, beta; kinematics for phi, theta),
    e[k] = y[k] - y[k-1] - d[k] = g[k] + v[k] - v[k-1]: gusts g move the aircraft, the sensor's noise v does not. So
    -E[e[k] e[k-1]] is the variance r of v, however rough the air is. With q, the variance of g that is allowed for,

        x = x_ + K nu,   d = d_ + K^2 / (2 - K) nu,   nu = y - x_,   P = (q + sqrt(q^2 + 4 q r)) / 2,   K = P / (P + r)

    (the steady state of a random walk in noise, and Kalata's relation for its rate), which K comes to from 1 as that of
    a mean does, 1/2, 1/3, ..., after a gap and where noise begins. A signal is filtered where r exceeds q for certain
    and most samples have a part in it, and as measured everywhere else.

    Vectors of five are plain floats: numpy's calls would cost more than the sums they make.
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
    BEYOND = 10.0
    """No aircraft moves so far in a sample [m/s, rad]: a model that says so starts the filter anew."""
    OFTEN, HALF, RECENT = 0.4, 0.5, 100
    """Least share of the last ``RECENT`` samples whose errors are beyond half a standard deviation. Of white noise it
    is 0.62; of a reading that jumps now and then less, and a mean over those would be worse than what lies between."""

    def __init__(self, learnt_at: Condition | None, dt: float) -> None:
        """``learnt_at``: where Theta is from, if it is to be taken to where the aircraft flies; dt: [s]."""
        self._learnt_at, self._dt = learnt_at, dt
        self._q = [self.GUST[signal] ** 2 for signal in SIGNALS]
        self._z = np.zeros(N_REGRESSORS)
        self._dx = self._z[:N_IDENTIFIED]
        self._model = np.zeros((N_REGRESSORS, 3 + 2 * _FORCES))
        """Columns of Theta: V, alpha and beta without what goes with the flight condition; then for alpha and beta
        what goes with rho V, and for both what goes with 1/V."""
        self.reset()

    def reset(self) -> None:
        """Start a new flight: nothing is known of the noise."""
        self._mean_square, self._mean_product = [0.0] * len(SIGNALS), [0.0] * len(SIGNALS)
        self._share_beyond = [0.0] * len(SIGNALS)
        self._seen = self._steps = 0
        self._measured: list[float] = []
        self.noisy = [False] * len(SIGNALS)
        """Whether V, alpha, beta, phi, theta are filtered."""
        self.any = False
        self.restart()

    def restart(self, missed: int | None = None) -> None:
        """Begin after a gap: what was measured last is no neighbour.

        missed: samples that are missing, through which the last increments went on; None where nobody knows.
        """
        self._steps = 0 if missed is None or not (self._measured or self._steps) else max(self._steps, 1) + missed
        """From the last state that was heard to the next, across a gap [samples]; 0 where that is the first."""
        self._measured = []
        self._errors = [0.0] * len(SIGNALS)
        if not self._steps:
            self._x = [0.0] * len(SIGNALS)
            self._gains = [1.0] * len(SIGNALS)
            self._z[:] = 0.0

    @property
    def bridges(self) -> bool:
        """Whether the next state follows a gap through which the last increments went on."""
        return self._steps > 0

    def take(self, theta: np.ndarray) -> None:
        """Take the model (13, 10): once, and again where it has learnt."""
        self._model[:] = 0.0
        self._model[:, :3] = theta[:, _MOVING]
        if self._learnt_at is None:
            return
        for i, angle in enumerate((STATE.alpha, STATE.beta)):
            column = theta[:, angle].copy()
            column[angle] -= 1.0
            own = self._model[:, 1 + i]
            for rows, at in ((AERODYNAMIC, 3 + i), (GRAVITY, 3 + _FORCES + i)):
                self._model[rows, at] = column[rows]
                own[rows] = 0.0
            own[angle] += 1.0
        self._model[STATE.p, 2] = 0.0

    def hear(self, x: np.ndarray, rates: np.ndarray, step: np.ndarray, da: np.ndarray) -> None:
        """Take the state x (>= 10,) of the next sample.

        rates (3,), step (3,): p, q, r and their last increment, filtered [rad/s]; da (3,): increment of healthy
        deflection that moved the last increment of the state [rad].
        """
        state = x.tolist()
        measured = state[STATE.V : STATE.theta + 1]
        dx = self._dx
        if self._measured:
            self._z[N_IDENTIFIED:] = da
            moving = self._expected(state)
            expected = [*moving, dx.item(STATE.phi), dx.item(STATE.theta)]
            if not all(abs(d) < self.BEYOND for d in expected):  # nor is what is not finite
                self.restart()
                expected = [0.0] * len(SIGNALS)
                self._x = measured.copy()
                self._measured = measured
            self._learn(measured, expected)
            self._correct(measured, expected)
        elif self._steps:
            self._correct(measured, [self._steps * dx.item(signal) for signal in SIGNALS])
        else:
            self._x = measured.copy()
        if not self._steps:  # after a gap the rates have no increment yet, and theirs of before it goes on too
            dx[: STATE.r + 1] = step
        self._measured, self._steps = measured, 0
        p, q, r = rates.tolist()
        phi, theta = (self._x[i] if self.noisy[i] else measured[i] for i in (_BANK, _PITCH))
        sin_phi, cos_phi = math.sin(phi), math.cos(phi)
        dx[STATE.phi] = self._dt * (p + (q * sin_phi + r * cos_phi) * math.tan(theta))
        dx[STATE.theta] = self._dt * (q * cos_phi - r * sin_phi)

    def _correct(self, measured: list[float], expected: list[float]) -> None:
        """Take the signals from where they were expected towards where they are measured; so their increments."""
        for i, (y, d, gain) in enumerate(zip(measured, expected, self._gains, strict=True)):
            surprise = y - self._x[i] - d
            if i == _BANK:
                surprise = math.remainder(surprise, 2.0 * math.pi)
            self._x[i] = y if gain == 1.0 else y - (1.0 - gain) * surprise
            if i < _BANK:
                most = self.WILDEST * math.sqrt(max(self._mean_square[i], self._q[i]))
                steady = min(gain * gain / (2.0 - gain), self.STEADY) * min(max(surprise, -most), most)
                self._dx[STATE.V + i] = steady + (self._dx.item(STATE.V + i) if self._steps else d)

    def apply(self, x: np.ndarray, dx: np.ndarray | None = None) -> None:
        """Put what is filtered into a state (>= 10,), and into its last increment (>= 10,), in place."""
        if not (self.any and self._measured):
            return
        for i, (signal, noisy) in enumerate(zip(SIGNALS, self.noisy, strict=True)):
            if noisy:
                x[signal] = self._x[i]
                if dx is not None:
                    dx[signal] = self._dx[signal]

    def steady(self, dx: np.ndarray) -> None:
        """Put the increments of p, q, r, V, alpha and beta that go on into the last one (>= 10,), in place."""
        if self._measured:
            dx[: STATE.beta + 1] = self._dx[: STATE.beta + 1]

    def _expected(self, x: list[float]) -> list[float]:
        """Return the increments (3,) of V, alpha and beta that the model expects here."""
        V, alpha, beta, *scheduled = (self._z @ self._model).tolist()
        if self._learnt_at is None:
            return [V, alpha, beta]
        at, speed = self._learnt_at, x[STATE.V]
        air, gravity = 1.0, 1.0
        if speed > LEAST_SPEED:
            air = dynamic_pressure(speed, x[STATE.h]) / speed / (dynamic_pressure(at.V, at.h) / at.V)
            gravity = at.V / speed
        turned = self._dt * x[STATE.alpha] * self._z.item(STATE.p)
        lift, side, weight, across = scheduled
        return [V, alpha + air * lift + gravity * weight, beta + air * side + gravity * across + turned]

    def _learn(self, measured: list[float], expected: list[float]) -> None:
        """Learn the noise from what the model did not expect of the last increments of the signals."""
        self._seen += 1
        share, recent = 1.0 / min(self._seen, self.MEMORY), 1.0 / min(self._seen, self.RECENT)
        certain, enough = self.CERTAIN * math.sqrt(share), self._seen > self.LEAST
        for i, (y, before, d, q) in enumerate(zip(measured, self._measured, expected, self._q, strict=True)):
            error = y - before - d
            if i == _BANK:
                error = math.remainder(error, 2.0 * math.pi)
            square = self._mean_square[i]
            most = self.WILDEST * math.sqrt(max(square, q))
            error = min(max(error, -most), most)
            beyond = error * error > self.HALF**2 * square
            square += share * (error * error - square)
            r = -self._mean_product[i]
            r -= share * (error * self._errors[i] + r)
            often = self._share_beyond[i] = self._share_beyond[i] + recent * (beyond - self._share_beyond[i])
            self._errors[i], self._mean_square[i], self._mean_product[i] = error, square, -r
            noisy = enough and r > q and r > certain * square and often > self.OFTEN
            if noisy:
                p = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
                gain = self._gains[i]
                self._gains[i] = max(p / (p + r), self.SLOWEST, gain / (1.0 + gain))
            else:
                self._gains[i] = 1.0
            self.noisy[i] = noisy
        self.any = True in self.noisy
