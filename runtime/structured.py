"""Which way, and how strongly, each surface works: a Kalman filter on body rates, and the alarm that it raises.

The model is :mod:`task.rates`. State of the filter: rates w (3), signed effectiveness lambda (3), bias b (3). Only
p, q, r are measured; nothing is differentiated, so that gyro noise is smoothed by the filter's own integration.
Nothing here allocates an array after construction.
"""

from __future__ import annotations

import math

import numpy as np

from runtime.config import Adaptation
from task.limits import DT
from task.rates import N_EFFECT, RATES, RateModel, dynamic_pressure, effect_terms, features, washout
from task.state import N_ACTION, N_IDENTIFIED, STATE

N = RATES + N_ACTION + RATES
"""States of the filter."""
THIRD_DIFFERENCE = np.array([-1.0, 3.0, -3.0, 1.0])
W, LAMBDA, B = slice(0, 3), slice(3, 6), slice(6, 9)
"""Where rates, effectiveness and bias lie among them."""


class RateFilter:
    """The Kalman filter alone: s = [w; lambda; b], s+ = F s + dt A phi, w measured with independent noise.

    ``s`` (9,) and ``P`` (9, 9) are changed in place; ``nis`` is the last normalised innovation squared (mean 3).
    """

    def __init__(self, model: RateModel, dt: float = DT) -> None:
        self.dt = dt
        self._drift = np.ascontiguousarray(model.drift)
        self._effect = np.ascontiguousarray(model.effect.transpose(1, 0, 2)).reshape(N_EFFECT, N_ACTION * RATES)
        self.s, self.P = np.zeros(N), np.zeros((N, N))
        self.q = np.zeros(N)
        """Variance added at each prediction (9,)."""
        self.r = np.zeros(RATES)
        """Variance of the measured rates (3,) [rad2/s2]."""
        self.nis = 0.0
        self.surprise = [0.0] * RATES
        """Its share of each axis; of p, q, r in turn."""
        self.F = np.eye(N)
        self.F[W, B] = dt * np.eye(RATES)
        self.drift_step = np.zeros(RATES)
        """dt A phi of the last prediction (3,) [rad/s]."""
        self._s = np.zeros(N)
        self._FP, self._product = np.zeros((N, N)), np.zeros((N, N))
        self._product_transposed = self._product.T
        self._phi = np.zeros(model.drift.shape[0])
        self._terms = np.zeros(N_EFFECT)
        self._per_surface = np.zeros(N_ACTION * RATES)
        self._effects = self._per_surface.reshape(N_ACTION, RATES)
        self._u = np.zeros((N_ACTION, 1))
        self._F_effect = self.F[W, LAMBDA].T  # a view: writing (surface, axis) fills F
        self._F_transposed = self.F.T
        self._F_rates = self.F[W]
        self.variances = self.P.reshape(-1)[:: N + 1]
        """The diagonal of P (9,); a view."""
        self._v = np.zeros(N)
        self._v_column, self._v_row = self._v[:, None], self._v[None, :]
        self._outer = np.zeros((N, N))

    def linearise(self, x: np.ndarray, washed: float, u: np.ndarray) -> None:
        """Set F and the drift's step at a state x (>= 10,) and the deflections u (3,) [rad] that act on it."""
        _, _, _, V, alpha, beta, _, _, _, h = x[:N_IDENTIFIED].tolist()
        p, q, r = self.s[W].tolist()
        qbar = dynamic_pressure(V, h)
        self._phi[:] = features(p, q, r, V, alpha, beta, washed, qbar)
        np.dot(self._phi, self._drift, out=self.drift_step)
        self.drift_step *= self.dt
        self._terms[:] = effect_terms(V, alpha, qbar)
        np.dot(self._terms, self._effect, out=self._per_surface)
        self._u[:, 0] = u
        np.multiply(self._effects, self._u, out=self._effects)
        np.multiply(self._effects, self.dt, out=self._F_effect)

    def predict(self) -> None:
        """Take s and P one sample on, with F and the drift as linearised."""
        np.dot(self.F, self.s, out=self._s)
        self._s[W] += self.drift_step
        np.copyto(self.s, self._s)
        np.dot(self.F, self.P, out=self._FP)
        np.dot(self._FP, self._F_transposed, out=self._product)
        np.add(self._product, self._product_transposed, out=self.P)  # rounding must not make it lean
        np.multiply(self.P, 0.5, out=self.P)
        self.variances += self.q

    def update(self, w: np.ndarray) -> None:
        """Learn from measured rates w (3,) [rad/s]; the axes in turn, which with independent noise is the same."""
        nis = 0.0
        for axis in range(RATES):
            innovation = float(w[axis] - self.s[axis])
            variance = max(float(self.P[axis, axis]), 0.0) + float(self.r[axis])
            self.surprise[axis] = innovation * innovation / variance
            nis += self.surprise[axis]
            np.divide(self.P[axis], math.sqrt(variance), out=self._v)
            np.dot(self._v_column, self._v_row, out=self._outer)
            np.subtract(self.P, self._outer, out=self.P)
            np.multiply(self._v, innovation / math.sqrt(variance), out=self._v)
            np.add(self.s, self._v, out=self.s)
        self.nis = nis

    def modelled(self, increment: np.ndarray) -> None:
        """Set the increment of the rates (3,) [rad/s] that the model, as learnt now, gives the last sample."""
        np.dot(self._F_rates, self.s, out=increment)
        np.subtract(increment, self.s[W], out=increment)
        np.add(increment, self.drift_step, out=increment)


class Effectiveness:
    """Feeds the filter, learns the level of noise and of turbulence, raises the alarm and opens the filter on it.

    Once a sample: :meth:`observe` with the state, then :meth:`command` with the command answered to it.
    """

    WINDOW = 5
    """Samples that the alarm sums."""
    STEP = 4.0
    """One sample moves what is learnt of noise and turbulence as if it were at most this many times as large as
    expected: a fault is neither."""
    LEARNING = 100
    """So many samples are looked at for noise alone, and as many again for turbulence, before there is an alarm."""
    BEYOND = 1e9
    """Largest normalised innovation; what is more, or no number, counts as this."""

    def __init__(self, settings: Adaptation, model: RateModel, command_lag: int, dt: float = DT) -> None:
        self.settings = settings
        self.filter = RateFilter(model, dt)
        self._dt = dt
        self._open_at = max(round(settings.open_after / dt), 1)
        self._close_at = self._open_at + max(round(settings.open_time / dt), 1)
        self._hold = round(settings.alarm_hold / dt)
        self._noise_gain, self._unrest_gain = dt / settings.noise_time, dt / settings.unrest_time
        self._q_quiet = self._process(settings.q_rate, settings.q_effectiveness)
        self._q_open = self._process(settings.q_rate_open, settings.q_effectiveness_open)
        self._mean_bias = np.zeros(RATES)
        self._shift_gain = min(dt / settings.shift_time, 1.0)
        # Of a random walk's distance from its own running mean.
        self._shift_variance = (np.square(settings.q_bias) / (2.0 * self._shift_gain)).tolist()
        self._commands = np.zeros((command_lag + 1, N_ACTION))
        self._slots = list(self._commands)
        self._x = np.zeros(N_IDENTIFIED)
        self._w = self._x[W]
        self._past = np.zeros((4, RATES))
        self._rows = list(self._past)
        self._third = np.zeros(RATES)
        self._nis = [0.0] * self.WINDOW
        self.effectiveness = self.filter.s[LAMBDA]
        """lambda (3,): signed effectiveness of elevator, aileron, rudder; a view."""
        self.bias = self.filter.s[B]
        """b (3,) [rad/s2]; a view."""
        self.rates = self.filter.s[W]
        """Filtered p, q, r (3,) [rad/s]; a view."""
        self.increment = np.zeros(RATES)
        """What the model makes of the last increment of the rates (3,) [rad/s]: free of the sensors' noise."""
        self.reset()

    def _process(self, rate: float, effectiveness: float) -> np.ndarray:
        q = np.zeros(N)
        q[W], q[LAMBDA], q[B] = rate**2, effectiveness**2, np.square(self.settings.q_bias)
        return q

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft, nothing counted."""
        f, settings = self.filter, self.settings
        f.s[:] = 0.0
        f.s[LAMBDA] = 1.0
        self._spread(settings.effectiveness_sd)
        self._q = self._q_quiet
        self.noise_variance = settings.rate_noise**2
        """Of the measured rates, as found in flight [rad2/s2]."""
        self.unrest = [1.0] * RATES
        """How many times the process noise (variance) of p, q, r is what still air asks for, as found in flight."""
        self.shift = 0.0
        """How far the bias is from its running mean, in standard deviations."""
        self._mean_bias[:] = 0.0
        self._seen = 0
        self.alarms = self.restarts = 0
        self._since = self._close_at + self._hold
        self.restart_history()

    def restart_history(self) -> None:
        """Forget the last samples, not what was learnt: the next ones follow a gap."""
        self._states = self._sent = 0
        self._low_passed = 0.0
        self._nis[:] = [0.0] * self.WINDOW
        self.alarmed = False
        """True at the sample at which an alarm was raised."""
        self.increment[:] = 0.0

    def _spread(self, effectiveness: float) -> None:
        """Forget correlations and set the variances of an open filter; effectiveness: standard deviation of lambda."""
        f, settings = self.filter, self.settings
        f.P[:] = 0.0
        f.variances[W], f.variances[LAMBDA] = settings.open_rate**2, effectiveness**2
        f.variances[B] = np.square(settings.open_bias)

    @property
    def sd(self) -> np.ndarray:
        """Return the standard deviations of lambda (3,)."""
        return np.sqrt(self.filter.variances[LAMBDA])

    @property
    def known(self) -> bool:
        """Whether the filter runs: it has two samples without a gap."""
        return self._states > 1 and self._sent >= len(self._slots)

    def observe(self, x: np.ndarray) -> None:
        """Take the state x (>= 10,) of this sample."""
        f, x = self.filter, x[:N_IDENTIFIED]
        self.alarmed = False
        if self._states and self._sent >= len(self._slots):
            r = float(self._w[2])
            f.linearise(self._x, r - self._low_passed, self._slots[0])
            self._low_passed = washout(self._low_passed, r, self._dt)
            np.copyto(f.q, self._q)
            np.multiply(f.q[W], self.unrest, out=f.q[W])
            np.multiply(f.q[B], self.unrest, out=f.q[B])
            f.predict()
            self._learn_noise(x[W])
            f.r[:] = self.noise_variance
            f.update(x[W])
            if not f.nis < np.inf:
                f.nis = self.BEYOND
                self.restarts += 1
                f.s[:] = 0.0
                f.s[LAMBDA] = 1.0
                self._spread(self.settings.effectiveness_sd_open)
                np.copyto(self.rates, x[W])
            self._judge(min(f.nis, self.BEYOND), x[W])
            f.modelled(self.increment)
        else:
            np.copyto(self.rates, x[W])
            f.P[W] = 0.0
            f.P[:, W] = 0.0
            f.variances[W] = self.settings.open_rate**2
            self._low_passed = float(x[STATE.r]) if self._states == 0 else self._low_passed
            self._past[:] = x[W]
        np.copyto(self._x, x)
        self._states += 1

    def command(self, action: np.ndarray) -> None:
        """Take the command (3,) [rad] that was sent in answer to the last state."""
        for older, newer in zip(self._slots, self._slots[1:], strict=False):
            np.copyto(older, newer)
        np.copyto(self._slots[-1], action)
        self._sent += 1

    def impose(self, x: np.ndarray, dx: np.ndarray, model: np.ndarray) -> None:
        """Change a snapshot to what the filter knows: x (10,), dx (10,) and model (13, 10), all in place.

        A surface that works lambda times as well does so in every equation, so that whole rows of G are multiplied. The
        rates and their increments, which start the imagined flight, come from the filter: raw differences of noisy
        gyros would be accelerations that are not there.
        """
        limit = self.settings.effectiveness_limit
        model[N_IDENTIFIED:] *= np.clip(self.effectiveness, -limit, limit)[:, None]
        if self.known:
            x[W], dx[W] = self.rates, self.increment

    def _learn_noise(self, w: np.ndarray) -> None:
        """Find the sensors' noise in the third difference of the rates: motion has none at 100 Hz, noise 20 times."""
        for older, newer in zip(self._rows, self._rows[1:], strict=False):
            np.copyto(older, newer)
        np.copyto(self._rows[3], w)
        np.dot(THIRD_DIFFERENCE, self._past, out=self._third)
        seen = float(np.dot(self._third, self._third)) / (20.0 * RATES)
        self._seen += 1
        if self._seen > self.LEARNING:
            seen = min(seen, self.STEP * self.noise_variance)
        gain = max(self._noise_gain, 1.0 / self._seen)
        learnt = self.noise_variance + gain * (seen - self.noise_variance)
        self.noise_variance = max(learnt, self.settings.rate_noise**2)

    def _learn_shift(self) -> float:
        """Return by how much the bias left its running mean, squared, in units of what is allowed for; 0 while open.

        A surface that fails while it is little used surprises no single sample; the bias takes it up, too far for one.
        """
        if self._since < self._close_at:
            return 0.0
        if self._since == self._close_at or self._seen <= 2 * self.LEARNING:
            np.copyto(self._mean_bias, self.bias)
            return 0.0
        shifted = 0.0
        for axis in range(RATES):
            away = float(self.bias[axis] - self._mean_bias[axis])
            self._mean_bias[axis] += self._shift_gain * away
            shifted += away * away / (self._shift_variance[axis] * self.unrest[axis])
        self.shift = math.sqrt(shifted)
        return shifted

    def _learn_unrest(self) -> None:
        """Raise or lower each axis's process noise until its normalised innovations squared are 1 on average."""
        if self._seen <= self.LEARNING:
            return
        gain = max(self._unrest_gain, 1.0 / (self._seen - self.LEARNING + self.WINDOW))
        for axis, surprise in enumerate(self.filter.surprise):
            self.unrest[axis] = max(self.unrest[axis] * math.exp(gain * (min(surprise, self.STEP) - 1.0)), 1.0)

    def _judge(self, nis: float, w: np.ndarray) -> None:
        """Raise the alarm; open the filter after it, and close it again."""
        settings = self.settings
        self._nis[self._states % self.WINDOW] = nis
        self._since += 1
        if self._since == self._open_at:
            self._spread(settings.effectiveness_sd_open)
            np.copyto(self.rates, w)
            self._q = self._q_open
        elif self._since == self._close_at:
            self._q = self._q_quiet
        self._learn_unrest()
        if self._seen == self.LEARNING:  # what was taken for a change of the surfaces was noise not yet known
            self.effectiveness[:] = 1.0
            self._spread(settings.effectiveness_sd)
            np.copyto(self.rates, w)
        shifted = self._learn_shift()
        if self._seen <= 2 * self.LEARNING or self._since <= self._hold:
            return
        threshold = settings.alarm_threshold * (1.0 + settings.alarm_colour * math.log(max(self.unrest)))
        if sum(self._nis) > threshold or shifted > settings.alarm_shift**2:
            self.alarmed = True
            self.alarms += 1
            self._since = 0
