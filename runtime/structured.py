"""Which way, how strongly and how late each surface works: a bank of filters, the alarm, and what is believed.

The filters are :mod:`runtime.rate_filter`, what they differ in :mod:`runtime.hypotheses`. One more filter for each
surface, an agile one, has the believed hypothesis's commands and lets that surface's lambda move: when it explains the
rates better than the believed one, whose lambda is nearly fixed, the surface has changed, however little it is used.
"""

from __future__ import annotations

import math

import numpy as np

from runtime.alarm import Alarm
from runtime.config import Adaptation
from runtime.hypotheses import Evidence, Inputs, actuators, hypotheses
from runtime.process_noise import ProcessNoise
from runtime.ranges import Ranges
from runtime.rate_filter import ALPHA_MID, LAMBDA, SLOPES, B, RateFilters, W
from runtime.reopening import AXIS, Reopening
from runtime.stuck import Stuck, turning
from runtime.uncommanded import Uncommanded
from runtime.unrest import Unrest
from task.actuators import ACTUATOR
from task.limits import DT
from task.rates import KNEE, RATES, RateModel, washout
from task.state import ACTION, N_ACTION, N_IDENTIFIED, STATE


class Effectiveness:
    """Feeds the filters, weighs the hypotheses, raises the alarm and opens the filters on it.

    Once a sample: :meth:`observe` with the state, then :meth:`command` with the command answered to it.
    """

    TURNING_NOISE = 0.02
    """Standard deviation of a stuck rate as the attitude tells it [rad/s]."""
    DEAD = 0.2
    """A surface whose lambda is known as well as this and may be zero is taken to be zero: it is stuck."""
    DOUBT = 0.1
    """Gusts are allowed for while lambda of aileron or rudder is known less well than this: a filter that is sure of
    its surfaces takes no gust for one, and the allowance would hide faults, and the turbulence from the thresholds."""

    def __init__(self, settings: Adaptation, model: RateModel, command_lag: int, dt: float = DT) -> None:
        self.settings = settings
        self.hypotheses = hypotheses(settings, dt)
        """What may have become of the commands; the healthy one first."""
        self._agile = len(self.hypotheses)
        """Row of the first agile filter."""
        self._limited = self._agile - N_ACTION * settings.ranges
        """Row of the first filter that looks for a range."""
        self._moving = self._limited - N_ACTION * (settings.q_uncommanded > 0.0)
        """Row of the first filter in which a surface moves by itself."""
        self.filter = RateFilters(model, self._agile + N_ACTION, dt)
        self._inputs = Inputs(self.hypotheses, command_lag, dt)
        self._u, self._known = np.zeros((2, self._agile + N_ACTION, N_ACTION))
        """What each filter multiplies lambda with, and what it knows of the deflections besides [rad]."""
        self.ranges = Ranges(self.filter, self._limited) if settings.ranges else None
        self._motions = Uncommanded(self.filter, self._moving, self._agile, dt) if settings.q_uncommanded else None
        self._dt = dt
        self._q_gust = settings.q_gust**2
        self._noise = ProcessNoise(settings, self._moving, self._limited, self._agile, dt)
        self.alarm = Alarm(settings, dt)
        odds = [0.0 if each.uncommanded is None else Uncommanded.ODDS for each in self.hypotheses]
        self.evidence = Evidence(odds, settings.delay_memory, settings.delay_lead, settings.delay_lead_open)
        limited = slice(self._limited, self._agile)
        self._reopening = Reopening(
            settings, self.filter, self.evidence, self._noise, self.ranges, self._motions, limited, dt
        )
        self.unrest = Unrest(settings.rate_noise, dt / settings.noise_time, dt / settings.unrest_time)
        self.stuck = Stuck(dt)
        self.increment = np.zeros(RATES)
        """What the model makes of the last increment of the rates (3,) [rad/s]: free of the sensors' noise."""
        self._x: list[float] = []
        self.believed = np.ones(N_ACTION)
        """lambda (3,) as it is imagined: what was believed before, moved only as far as ``belief_sd`` standard
        deviations of what is estimated now ask for."""
        self.reset()

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft, nothing counted."""
        self.filter.forget()
        self._reopening.reset()
        self.evidence.reset()
        self.unrest.reset()
        self.believed[:] = 1.0
        self.alarm.shift.restart([0.0] * RATES)
        self.alarm.clear()
        self.stuck.reset()
        self.alarms = self.restarts = 0
        self._low_passed = 0.0
        self.restart_history()

    def restart_history(self, commands_known: bool = False) -> None:
        """Forget the last states, not what was learnt: the next ones follow a gap.

        commands_known: whether :meth:`command` has been told of all commands, those in the gap included.
        """
        self._states = 0
        self._noise.restart()
        if not commands_known:
            self._inputs.restart()
        self.alarm.restart()
        self.alarmed = False
        """True at the sample at which an alarm was raised."""
        self.increment[:] = 0.0

    @property
    def effectiveness(self) -> np.ndarray:
        """Return lambda (3,): signed effectiveness of elevator, aileron, rudder, as the believed filter has it."""
        found = self.filter.s[self.evidence.believed, LAMBDA]
        limited, moving = self.limited, self.uncommanded
        if limited is not None and self.ranges:
            found = found.copy()
            found[limited] = self.ranges.of[limited].effectiveness
        elif moving is not None and self._motions:
            found = found.copy()
            found[moving] = self._motions.effectiveness[moving]
        return found

    @property
    def sd(self) -> np.ndarray:
        """Return the standard deviations of lambda (3,)."""
        sd = np.sqrt(self.filter.variances[self.evidence.believed, LAMBDA])
        for surface in (self.limited, self.uncommanded):
            if surface is not None:
                sd[surface] = self.settings.effectiveness_sd
        return sd

    @property
    def bias(self) -> np.ndarray:
        """Return b (3,) [rad/s2]."""
        return self.filter.s[self.evidence.believed, B]

    @property
    def pitching(self) -> float:
        """Return q' of the last sample, as the model has it [rad/s2]."""
        return self.increment.item(STATE.q) / self._dt

    @property
    def nose_up(self) -> float:
        """Return q' that the healthy aircraft would not have here, whatever it comes from [rad/s2]."""
        f, i = self.filter, self.evidence.believed
        return f.s.item(i, B.start + 1) + f.s.item(i, SLOPES.start) * (self._x[STATE.alpha] - ALPHA_MID)

    @property
    def elevator_effect(self) -> float:
        """Return q' of the elevator, as it works now [rad/s2 per rad]; negative unless it is reversed."""
        return self.filter.effect(STATE.q, ACTION.de) * self.effectiveness.item(ACTION.de)

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
    def limited(self) -> int | None:
        """Return the surface that is believed to have lost some of its range, or None."""
        return self.hypotheses[self.evidence.believed].limited

    @property
    def uncommanded(self) -> int | None:
        """Return the surface that is believed to move besides by itself, or None."""
        return self.hypotheses[self.evidence.believed].uncommanded

    @property
    def slow(self) -> bool:
        """Return whether surfaces are believed to move slowly."""
        return self.hypotheses[self.evidence.believed].rate < math.inf

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
        found, surface = actuators(self.hypotheses[self.evidence.believed]), self.limited
        if surface is not None and self.ranges:
            found[[ACTUATOR.low, ACTUATOR.high], surface] = self.ranges.of[surface].ends
        return found

    @property
    def searching(self) -> bool:
        """Whether an alarm has opened the filters, less than ``watch`` ago."""
        return self.known and self._reopening.opening.searching

    @property
    def alpha(self) -> float:
        """Return the angle of attack that was seen last [rad]."""
        return self._x[STATE.alpha]

    @property
    def near_stall(self) -> bool:
        """Whether the angle of attack was last seen beyond the knee of the lift curve."""
        return self._states > 0 and self._x[STATE.alpha] > KNEE

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
            self.unrest.hear(w, turning(self._x, state, w, self._dt))
            f.r[:] = self.unrest.variances
            stuck = self.stuck.look(state, self.increment.tolist(), math.sqrt(self.unrest.noise_variance))
            if stuck or self.unrest.broke:
                self._reopening.undo(self.believed)
                self.alarm.forget_surprise()
            if self.stuck.any:
                w = self._unstick(state)
            if f.update(w) and f.sound:
                if self.ranges:
                    self.ranges.learn(self._inputs.u[0].tolist())
                if self._motions:
                    self._motions.learn()
                self._weigh()
                self._judge(w)
                self._believe()
            else:
                self.restarts += 1
                self._reopening.start_anew(self.settings.effectiveness_sd_open)
                f.s[:, W] = w
            self._model_increment()
        else:
            for axis, stuck in enumerate(self.stuck.signals[:RATES]):
                if not stuck:
                    f.s[:, axis] = state[axis]
            f.P[:, W] = 0.0
            f.P[:, :, W] = 0.0
            f.variances[:, W] = self.settings.open_rate**2
            if self._states == 0:
                self._low_passed = f.s.item(self.evidence.believed, STATE.r)
            self.unrest.restart(w)
        self._x = state
        self._states += 1

    def correct(self, x: np.ndarray) -> None:
        """Take speed, angle of attack and sideslip of the last state from x (>= 10,) instead: they are filtered."""
        self._x[STATE.V : STATE.beta + 1] = x[STATE.V : STATE.beta + 1].tolist()

    def command(self, action: np.ndarray) -> None:
        """Take the command (3,) [rad] that was sent in answer to the last state."""
        self._inputs.send(action)

    def followed(self, before: int = 0) -> np.ndarray:
        """Return what is believed to become of the last ``command_lag`` + 1 commands (L, 3) [rad], oldest first.

        Their delay is left out: it is what waits. before: 1 for the one before them besides.
        """
        commands, surface = self._inputs.followed(self.evidence.believed, before), self.limited
        if surface is not None and self.ranges:
            commands = commands.copy()
            commands[:, surface] = commands[:, surface].clip(*self.ranges.of[surface].ends)
        return commands

    @property
    def acted(self) -> np.ndarray:
        """Return the commands (3,) [rad] that are believed to have acted in the last sample."""
        return self._inputs.u[self.evidence.believed]

    def moved(self, out: np.ndarray) -> None:
        """Set the increment (3,) [rad] of healthy deflection that would have moved the last increment of the state."""
        inputs, believed = self._inputs, self.evidence.believed
        np.subtract(inputs.u[believed], inputs.before[believed], out=out)
        np.multiply(out, self.believed, out=out)

    @property
    def acting(self) -> np.ndarray:
        """Return the healthy deflections (3,) [rad] that would do what the surfaces are believed to do now."""
        return self.mixing @ self.followed()[-1]

    def smooth(self, x: np.ndarray, dx: np.ndarray) -> None:
        """Put the filter's rates and their increments into a state (10,) and its increment (10,), in place.

        They start the imagined flight: raw differences of noisy gyros would be accelerations that are not there.
        """
        x[W], dx[W] = self.rates, self.increment

    def mended(self, x: np.ndarray) -> np.ndarray:
        """Return the state (>= 10,) with the filter's rates in place of those that are stuck."""
        if not self.stuck.any:
            return x
        x = x.copy()
        for axis, stuck in enumerate(self.stuck.signals[:RATES]):
            if stuck:
                x[axis] = self.rates[axis]
        return x

    def _predict(self) -> None:
        """Take the filters from the last sample to this one."""
        f, levels, x = self.filter, self.unrest.levels, self._x
        r = x[STATE.r]
        self._u[: self._agile] = u = self._inputs.take()
        believed = self.evidence.believed
        if self.ranges:
            rows = slice(self._limited, self._agile)
            followers = range(self._agile, len(self._u))
            self.ranges.deflect(u[0].tolist(), self._u[rows], self._known[rows], self.limited, followers)
            for surface, acting in enumerate(self.ranges.acting):
                u[self._limited + surface, surface] = acting
        if self._motions:
            rows = slice(self._moving, self._limited)
            self._motions.deflect(u[0], self._u[rows], self._known[rows], self.uncommanded)
        self._u[self._agile :], self._known[self._agile :] = self._u[believed], self._known[believed]
        if self._q_gust:
            f.q_gust = self._q_gust if self._noise.opened or max(self.sd[ACTION.da :]) > self.DOUBT else 0.0
        f.linearise(self.rates.tolist() + x[STATE.V :], r - self._low_passed, self._u, self._known)
        self._low_passed = washout(self._low_passed, r, self._dt)
        alpha, lacking = x[STATE.alpha], self.stuck.signals[RATES:]
        self._noise.fill(
            f.q, levels, f.drift_step.tolist(), alpha, self._reopening.opening.calm, lacking, self.uncommanded
        )
        f.predict()

    def _model_increment(self) -> None:
        """Set the increment of the rates that the model, as learnt now, gives the last sample."""
        f, believed = self.filter, self.evidence.believed
        np.dot(f.F_rates[believed], f.s[believed], out=self.increment)
        np.subtract(self.increment, self.rates, out=self.increment)
        np.add(self.increment, f.drift_step, out=self.increment)
        np.add(self.increment, f.known_step[believed], out=self.increment)

    def _weigh(self) -> None:
        """Weigh the hypotheses, and whether lambda moves."""
        f, evidence = self.filter, self.evidence
        agile, believed, alarm = self._agile, evidence.believed, self.alarm
        known = max(f.log_likelihood[evidence.best], f.log_likelihood[believed])
        alarm.compare(f.log_likelihood[agile:], known)
        lead = max(alarm.leads)
        explains = agile + alarm.leads.index(lead) if lead > evidence.behind[believed] else evidence.best
        surprise = f.surprise(explains)
        if self.stuck.any:
            p, q, r = (1.0 if blind else each for blind, each in zip(self.stuck.blind, surprise, strict=True))
            surprise = p, q, r
        self.unrest.feel(surprise)
        # Between an alarm and the opening the filters stand for an aircraft that is no more.
        if not self.unrest.known or self._reopening.opening.pending:
            alarm.clear()
        elif evidence.weigh(self._told(), self._reopening.opening.under_way and self.uncommanded is None):
            self.alarmed = True
            alarm.clear()
            np.copyto(self.believed, self.effectiveness)
            f.s[agile:], f.P[agile:] = f.s[evidence.believed], f.P[evidence.believed]

    def _told(self) -> list[float]:
        """Return the log-likelihood of each hypothesis, as far as it has a say."""
        told = self.filter.log_likelihood[: self._agile]
        if self._motions:
            levels = [self.unrest.levels[axis] for axis in AXIS]
            self._motions.hear(told, self.uncommanded, levels if self._noise.opened else None)
        if self.ranges:
            self.ranges.hear(told)
        return told

    def _believe(self) -> None:
        """Move what is believed of lambda as far as the estimate asks for."""
        f, i = self.filter, self.evidence.believed
        limited, moving = self.limited, self.uncommanded
        for surface, (before, found, variance) in enumerate(
            zip(self.believed.tolist(), f.s[i, LAMBDA].tolist(), f.variances[i, LAMBDA].tolist(), strict=True)
        ):
            if surface == moving or (self.stuck.any and self.stuck.blind[AXIS[surface]]):
                continue
            if self.ranges and surface == limited:
                self.believed[surface] = self.ranges.of[surface].effectiveness
                continue
            margin = self.settings.belief_sd * math.sqrt(max(variance, 0.0))
            moved = min(max(before, found - margin), found + margin)
            self.believed[surface] = 0.0 if abs(found) <= margin <= self.DEAD else moved

    def _judge(self, w: list[float]) -> None:
        """Raise the alarm when no hypothesis explains the rates; open the filters after it, and close them again."""
        f, alarm, opening = self.filter, self.alarm, self._reopening.opening
        explained = min(f.nis[self.evidence.best], f.nis[self.evidence.believed])
        self._reopening.step(w, self.stuck.blind, self._inputs.u[0], self.limited)
        if self.unrest.ends_a_phase:  # what was taken for a change was noise, or turbulence, not yet known
            self._reopening.start_anew(self.settings.effectiveness_sd)
            self.believed[:] = 1.0
            f.s[:, W] = w
        if opening.closed and self.unrest.known and self.uncommanded is None:
            alarm.shift.learn(self.bias.tolist(), self.unrest.levels, self.stuck.blind)
        else:
            alarm.shift.restart(self.bias.tolist())
        refuted = self._motions is not None and self._motions.refuted(self.uncommanded)
        sounds = alarm.sounds(explained, self.unrest.levels) or refuted
        if sounds and self.unrest.known and opening.may_begin:
            self.alarmed = True
            self.alarms += 1
            alarm.clear()
            self._reopening.begin(self.believed, refuted)
        moving = self.uncommanded is not None
        self._reopening.past.keep(f.s[self.evidence.believed], self.effectiveness, moving)

    def _unstick(self, x: list[float]) -> list[float]:
        """Return the rates (3,) [rad/s] with the attitude's in place of those that are stuck."""
        w = x[W]
        for axis, told in enumerate(turning(self._x, x, self.rates.tolist(), self._dt)):
            if self.stuck.signals[axis]:
                w[axis], self.filter.r[axis] = told, self.TURNING_NOISE**2
        return w
