"""Which way, how strongly and how late each surface works: a bank of filters, the alarm, and what is believed.

The filters are :mod:`runtime.rate_filter`, what they differ in :mod:`runtime.hypotheses`. One more filter for each
surface, an agile one, has the believed hypothesis's commands and lets that surface's lambda move: when it explains the
rates better than the believed one, whose lambda is nearly fixed, the surface has changed, however little it is used.
"""

from __future__ import annotations

import math

import numpy as np

from runtime.config import Adaptation
from runtime.hypotheses import Evidence, Inputs, actuators, hypotheses
from runtime.rate_filter import LAMBDA, SLOPES, B, N, RateFilters, W
from runtime.shift import Shift
from runtime.stuck import Stuck, turning
from runtime.unrest import Unrest
from task.limits import DT
from task.model import with_effectiveness
from task.rates import KNEE, RATES, RateModel, washout
from task.state import N_ACTION, N_IDENTIFIED, STATE

LOW_KNEE = math.radians(-3.0)
"""Angle of attack below which the model errs too. Soon after an alarm what surfaces do errs more."""
AXIS = (1, 0, 2)
"""Which of p, q, r elevator, aileron and rudder move most."""


class Effectiveness:
    """Feeds the filters, weighs the hypotheses, raises the alarm and opens the filters on it.

    Once a sample: :meth:`observe` with the state, then :meth:`command` with the command answered to it.
    """

    WINDOW = 5
    """Samples that the alarm sums."""
    HOLD = 3
    """Samples for which an agile filter must lead."""
    TURNING_NOISE = 0.02
    """Standard deviation of a stuck rate as the attitude tells it [rad/s]."""
    UNKNOWN = 0.25
    """Drift of the bias where the model lacks an angle, each sample (variance) [rad2/s4]."""
    CALM = 5.0
    """So long after the filters have closed nothing has changed lately [s]."""
    DEAD = 0.2
    """A surface whose lambda is known as well as this and may be zero is taken to be zero: it is stuck."""
    BEYOND = 1e9
    """Largest normalised innovation; what is more, or no number, counts as this."""

    def __init__(self, settings: Adaptation, model: RateModel, command_lag: int, dt: float = DT) -> None:
        self.settings = settings
        self.hypotheses = hypotheses(settings.delays, settings.crossed, settings.rate_limits, dt)
        """What may have become of the commands; the healthy one first."""
        self._agile = len(self.hypotheses)
        """Row of the first agile filter."""
        self.filter = RateFilters(model, self._agile + N_ACTION, dt)
        self._inputs = Inputs(self.hypotheses, command_lag, dt)
        self._u = np.zeros((self._agile + N_ACTION, N_ACTION))
        self._dt = dt
        self._open_at = max(round(settings.open_after / dt), 1)
        self._close_at = self._open_at + max(round(settings.open_time / dt), 1)
        self._hold = round(settings.alarm_hold / dt)
        self._calm_at = self._close_at + round(self.CALM / dt)
        self._q_quiet = self._process(settings.q_rate, settings.q_effectiveness)
        self._q_open = self._process(settings.q_rate_open, settings.q_effectiveness_open)
        self._least_q_bias = np.square(settings.q_bias).tolist()
        self._recent = np.zeros((max(round(settings.recall / dt), 1), N))
        self._recalled, self._believed_before = np.zeros(N), np.ones(N_ACTION)
        self.shift = Shift(settings.q_bias, settings.shift_time, dt)
        self.evidence = Evidence(self._agile, settings.delay_memory, settings.delay_lead, settings.delay_lead_open)
        self.unrest = Unrest(settings.rate_noise, dt / settings.noise_time, dt / settings.unrest_time)
        self.stuck = Stuck(dt)
        self.increment = np.zeros(RATES)
        """What the model makes of the last increment of the rates (3,) [rad/s]: free of the sensors' noise."""
        self.believed = np.ones(N_ACTION)
        """lambda (3,) as it is imagined: what was believed before, moved only as far as ``belief_sd`` standard
        deviations of what is estimated now ask for."""
        self.reset()

    def _process(self, rate: float, effectiveness: float) -> np.ndarray:
        q = np.zeros((self._agile + N_ACTION, N))
        q[:, W], q[:, LAMBDA] = rate**2, effectiveness**2
        agile = q[self._agile :, LAMBDA]
        np.fill_diagonal(agile, max(effectiveness, self.settings.q_effectiveness_agile) ** 2)
        return q

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft, nothing counted."""
        self._start_anew(self.settings.effectiveness_sd)
        self._q = self._q_quiet
        self.evidence.reset()
        self.unrest.reset()
        self.believed[:] = 1.0
        self.shift.restart([0.0] * RATES)
        self.agile_lead = [0.0] * N_ACTION
        """By how much each surface's agile filter leads the believed one [nats]."""
        self.alarms = self.restarts = 0
        self._since = self._close_at + self._hold
        self.restart_history()

    def restart_history(self) -> None:
        """Forget the last samples, not what was learnt: the next ones follow a gap."""
        self._states = 0
        self._low_passed = 0.0
        self._drift: list[float] = []
        self._inputs.restart()
        self._nis = [0.0] * self.WINDOW
        self._led = 0
        self.stuck.reset()
        self.alarmed = False
        """True at the sample at which an alarm was raised."""
        self.increment[:] = 0.0

    def _start_anew(self, effectiveness_sd: float) -> None:
        """Take every filter to a healthy aircraft with lambda as sure as said."""
        self.filter.s[:] = 0.0
        self.filter.s[:, LAMBDA] = 1.0
        self._spread(effectiveness_sd)

    def _spread(self, effectiveness_sd: float, slopes: tuple[float, float] = (0.0, 0.0)) -> None:
        """Forget correlations and set the variances of open filters."""
        f, settings = self.filter, self.settings
        f.P[:] = 0.0
        f.variances[:, W], f.variances[:, LAMBDA] = settings.open_rate**2, effectiveness_sd**2
        f.variances[:, B] = np.square(settings.open_bias)
        f.variances[:, SLOPES] = np.square(slopes)

    @property
    def effectiveness(self) -> np.ndarray:
        """Return lambda (3,): signed effectiveness of elevator, aileron, rudder, as the believed filter has it."""
        return self.filter.s[self.evidence.believed, LAMBDA]

    @property
    def sd(self) -> np.ndarray:
        """Return the standard deviations of lambda (3,)."""
        return np.sqrt(self.filter.variances[self.evidence.believed, LAMBDA])

    @property
    def bias(self) -> np.ndarray:
        """Return b (3,) [rad/s2]."""
        return self.filter.s[self.evidence.believed, B]

    @property
    def rates(self) -> np.ndarray:
        """Return the filtered p, q, r (3,) [rad/s]."""
        return self.filter.s[self.evidence.believed, W]

    @property
    def surprise(self) -> float:
        """Return the believed filter's normalised innovation squared, 3 on average."""
        return self.filter.nis[self.evidence.believed]

    @property
    def delay_samples(self) -> int:
        """Return the delay that is believed, beyond ``command_lag`` [samples]."""
        return self.hypotheses[self.evidence.believed].delay

    @property
    def mixing(self) -> np.ndarray:
        """Return the effect (3, 3) of each command (column) as elevator, aileron and rudder (row), as imagined."""
        limit = self.settings.effectiveness_limit
        mixing = np.zeros((N_ACTION, N_ACTION))
        order = self.hypotheses[self.evidence.believed].order
        mixing[range(N_ACTION), order] = np.clip(self.believed, -limit, limit)
        return mixing

    @property
    def actuators(self) -> np.ndarray:
        """Return what is believed of range and rate of the surfaces (3, 3), as in :mod:`task.actuators`."""
        return actuators(self.hypotheses[self.evidence.believed])

    @property
    def known(self) -> bool:
        """Whether the filters run: they have two samples without a gap."""
        return self._states > 1 and self._inputs.known

    def observe(self, x: np.ndarray) -> None:
        """Take the state x (>= 10,) of this sample."""
        f, x = self.filter, x[:N_IDENTIFIED]
        state = x.tolist()
        w = state[W]
        self.alarmed = False
        if self._states and self._inputs.known:
            self._predict()
            self.unrest.hear(w)
            f.r[:] = self.unrest.noise_variance
            if self.stuck.look(state, self.increment.tolist(), math.sqrt(self.unrest.noise_variance)):
                self._back()
            if self.stuck.any:
                w = self._unstick(state)
            if f.update(w):
                self._weigh()
                self._judge(w)
                self._believe()
            else:
                self.restarts += 1
                self._start_anew(self.settings.effectiveness_sd_open)
                f.s[:, W] = w
            self._model_increment()
        else:
            f.s[:, W] = x[W]
            f.P[:, W] = 0.0
            f.P[:, :, W] = 0.0
            f.variances[:, W] = self.settings.open_rate**2
            if self._states == 0:
                self._low_passed = state[STATE.r]
            self.unrest.restart(w)
        self._x = state
        self._states += 1

    def command(self, action: np.ndarray) -> None:
        """Take the command (3,) [rad] that was sent in answer to the last state."""
        self._inputs.send(action)

    def followed(self) -> np.ndarray:
        """Return what is believed to become of the last ``command_lag`` + 1 commands (L, 3) [rad], oldest first.

        Their delay is left out: it is what waits.
        """
        return self._inputs.followed(self.evidence.believed)

    def moved(self, out: np.ndarray) -> None:
        """Set the increment (3,) [rad] of healthy deflection that would have moved the last increment of the state."""
        inputs, believed = self._inputs, self.evidence.believed
        np.subtract(inputs.u[believed], inputs.before[believed], out=out)
        np.multiply(out, self.believed, out=out)

    def impose(self, x: np.ndarray, dx: np.ndarray, model: np.ndarray) -> None:
        """Change a snapshot to what the filter knows: x (10,), dx (10,) and model (13, 10), all in place.

        A surface that works lambda times as well does so in every equation, so that whole rows of G are multiplied; a
        crossed one has another's row. The rates and their increments, which start the imagined flight, come from the
        filter: raw differences of noisy gyros would be accelerations that are not there.
        """
        model[:] = with_effectiveness(model, self.mixing)
        if self.known:
            x[W], dx[W] = self.rates, self.increment

    def _predict(self) -> None:
        """Take the filters from the last sample to this one."""
        f, levels, x = self.filter, self.unrest.levels, self._x
        r = x[STATE.r]
        self._u[: self._agile] = self._inputs.take()
        self._u[self._agile :] = self._u[self.evidence.believed]
        f.linearise(self.rates.tolist() + x[STATE.V :], r - self._low_passed, self._u)
        self._low_passed = washout(self._low_passed, r, self._dt)
        f.q[:] = self._q
        drift = f.drift_step.tolist()
        opened = self._q is self._q_open
        share = (self.settings.model_error_open if opened else self.settings.model_error) / self._dt
        low = LOW_KNEE - x[STATE.alpha] if self._since > self._calm_at else 0.0
        near_stall = (1.0 + self.settings.stall_error * max(x[STATE.alpha] - KNEE, low, 0.0)) ** 2
        f.q[:, B] = [
            least * level * near_stall + (share * (new - old)) ** 2
            for least, level, new, old in zip(self._least_q_bias, levels, drift, self._drift or drift, strict=True)
        ]
        self._drift = drift
        if self.stuck.any:
            _, _, _, no_alpha, no_beta = self.stuck.signals
            f.q[:, B] += self.UNKNOWN * np.array((no_beta, no_alpha, no_beta))
        f.predict()

    def _model_increment(self) -> None:
        """Set the increment of the rates that the model, as learnt now, gives the last sample."""
        f, believed = self.filter, self.evidence.believed
        np.dot(f.F_rates[believed], f.s[believed], out=self.increment)
        np.subtract(self.increment, self.rates, out=self.increment)
        np.add(self.increment, f.drift_step, out=self.increment)

    def _weigh(self) -> None:
        """Weigh the hypotheses, and whether lambda moves."""
        f, evidence = self.filter, self.evidence
        agile, believed, memory = self._agile, evidence.believed, self.settings.delay_memory
        known = max(f.log_likelihood[evidence.best], f.log_likelihood[believed])
        moving = f.log_likelihood[agile:]
        self.agile_lead = [
            max(memory * lead + new - known, 0.0) for lead, new in zip(self.agile_lead, moving, strict=True)
        ]
        lead = max(self.agile_lead)
        explains = agile + self.agile_lead.index(lead) if lead > evidence.behind[believed] else evidence.best
        surprise = f.surprise[explains]
        if self.stuck.any:
            p, q, r = (1.0 if blind else each for blind, each in zip(self.stuck.blind, surprise, strict=True))
            surprise = p, q, r
        self.unrest.feel(surprise)
        # Between an alarm and the opening the filters stand for an aircraft that is no more.
        if not self.unrest.known or self._since < self._open_at:
            self.agile_lead = [0.0] * N_ACTION
        elif evidence.weigh(f.log_likelihood[:agile], self._since < self._close_at):
            self.alarmed = True
            self.agile_lead = [0.0] * N_ACTION
            np.copyto(self.believed, self.effectiveness)
            f.s[agile:], f.P[agile:] = f.s[evidence.believed], f.P[evidence.believed]

    def _believe(self) -> None:
        """Move what is believed of lambda as far as the estimate asks for."""
        f, i = self.filter, self.evidence.believed
        for surface, (found, variance) in enumerate(
            zip(f.s[i, LAMBDA].tolist(), f.variances[i, LAMBDA].tolist(), strict=True)
        ):
            if self.stuck.any and self.stuck.blind[AXIS[surface]]:
                continue
            margin = self.settings.belief_sd * math.sqrt(max(variance, 0.0))
            moved = min(max(self.believed[surface], found - margin), found + margin)
            self.believed[surface] = 0.0 if abs(found) <= margin <= self.DEAD else moved

    def _judge(self, w: list[float]) -> None:
        """Raise the alarm when no hypothesis explains the rates; open the filters after it, and close them again."""
        settings, f = self.settings, self.filter
        explained = min(f.nis[self.evidence.best], f.nis[self.evidence.believed])
        self._nis[self._states % self.WINDOW] = min(explained, self.BEYOND)
        self._since += 1
        if self._since == self._open_at:
            f.s[:] = self._recalled
            f.s[:, W] = w
            self._spread(settings.effectiveness_sd_open, settings.open_slopes)
            for surface, axis in enumerate(AXIS):
                if self.stuck.blind[axis]:
                    f.variances[:, LAMBDA.start + surface] = settings.effectiveness_sd**2
            self._q = self._q_open
            self.evidence.forget()
        elif self._since == self._close_at:
            self._q = self._q_quiet
        if self.unrest.seen == self.unrest.LEARNING:  # what was taken for a change was noise not yet known
            self._start_anew(settings.effectiveness_sd)
            f.s[:, W] = w
        if self._since > self._close_at and self.unrest.known:
            self.shift.learn(self.bias.tolist(), self.unrest.levels, self.stuck.blind)
        else:
            self.shift.restart(self.bias.tolist())
        colour = 1.0 + settings.alarm_colour * math.log(max(self.unrest.levels))
        moved = any(lead > colour * need for lead, need in zip(self.agile_lead, settings.agile_lead, strict=True))
        self._led = self._led + 1 if moved else 0
        oldest = self._recent[self._states % len(self._recent)]
        surprised = sum(self._nis) > settings.alarm_threshold * colour
        if not self.unrest.known or self._since <= self._hold:
            pass
        elif surprised or self.shift.size > settings.alarm_shift or self._led >= self.HOLD:
            self.alarmed = True
            self.alarms += 1
            self.agile_lead = [0.0] * N_ACTION
            self._since = 0
            np.copyto(self._recalled, oldest)
            np.copyto(self._believed_before, self.believed)
        np.copyto(oldest, f.s[self.evidence.believed])

    def _unstick(self, x: list[float]) -> list[float]:
        """Return the rates (3,) [rad/s] with the attitude's in place of those that are stuck."""
        w = x[W]
        for axis, told in enumerate(turning(self._x, x, self.rates.tolist(), self._dt)):
            if self.stuck.signals[axis]:
                w[axis], self.filter.r[axis] = told, self.TURNING_NOISE**2
        return w

    def _back(self) -> None:
        """Undo what was learnt since a sensor stopped, and the opening that it may have asked for."""
        f = self.filter
        now = f.s[:, W].copy()
        if self._since < self._close_at:
            f.s[:], self.believed[:] = self._recalled, self._believed_before
            if self._since >= self._open_at:
                self._spread(self.settings.effectiveness_sd)
                self._q = self._q_quiet
            self._since = self._close_at
        else:
            f.s[:] = self._recent[self._states % len(self._recent)]
        f.s[:, W] = now
        self._nis = [0.0] * self.WINDOW
        self.evidence.forget()
