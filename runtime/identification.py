"""The model learnt in flight: recursive least squares (eqs 8.5-8.7) on state increments (eq. 8.2).

Nothing here allocates an array after construction: every product has its place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from runtime.coasting import Coasting
from runtime.config import Adaptation
from runtime.foretelling import foretell
from runtime.guard import plausible
from runtime.history import CommandHistory
from runtime.lowpass import LowPass
from runtime.state_filter import StateFilter
from runtime.structured import Effectiveness
from task.actuators import HEALTHY
from task.errors import UserError
from task.limits import DT
from task.model import (
    DYNAMIC,
    N_REGRESSORS,
    REDUCED_REGRESSORS,
    embed_reduced,
    kinematic_rates,
    with_effectiveness,
)
from task.rates import RateModel
from task.scheduling import Condition, scheduled
from task.state import N_ACTION, N_IDENTIFIED, STATE


class RecursiveLeastSquares:
    """y = Theta' z with exponential forgetting.

    Shapes: z (n,), y (m,), ``Theta`` (n, m) (eq. 8.4), ``P`` (n, n), ``innovation`` (m,) (eq. 8.7).

    P stays symmetric to the last bit, because eq. 8.6 subtracts v v' with v = P z / sqrt(kappa + z' P z). Against
    blow-up: forgetting is suspended while trace(P) is above ``trace_limit``; an update whose denominator or innovation
    is not finite is skipped and counted; a P that is no longer finite and positive starts the recursion again from its
    prior, counted too.
    """

    def __init__(self, theta0: np.ndarray, p0: np.ndarray, kappa: float, trace_limit: float = np.inf) -> None:
        n, m = theta0.shape
        self._theta0 = np.array(theta0, dtype=float)
        self._p0 = np.array(p0, dtype=float)
        self.kappa = kappa
        self.trace_limit = trace_limit
        self.Theta = self._theta0.copy()
        self.P = self._p0.copy()
        self.innovation = np.zeros(m)
        self.updates = 0
        self.skipped = 0
        self.restarts = 0
        self._diagonal = self.P.reshape(-1)[:: n + 1]
        self._ones_n, self._ones_m = np.ones(n), np.ones(m)
        self._predicted = np.zeros(m)
        self._Pz, self._v = np.zeros(n), np.zeros(n)
        self._v_column, self._v_row, self._innovation_row = self._v[:, None], self._v[None, :], self.innovation[None, :]
        self._theta_step, self._p_step = np.zeros((n, m)), np.zeros((n, n))

    @property
    def trace(self) -> float:
        """Trace of P: how little is known."""
        return float(np.dot(self._diagonal, self._ones_n))

    def reset(self) -> None:
        """Start again from the prior."""
        self.Theta[:] = self._theta0
        self.P[:] = self._p0
        self.innovation[:] = 0.0
        self.updates = 0

    def predict(self, z: np.ndarray, y: np.ndarray) -> None:
        """Set the innovation, y - Theta' z, and learn nothing."""
        np.dot(z, self.Theta, out=self._predicted)
        np.subtract(y, self._predicted, out=self.innovation)

    def update(self, z: np.ndarray, y: np.ndarray) -> None:
        """Learn from one sample (eqs 8.5-8.7). z: (n,) regressor; y: (m,) measured outcome."""
        self.predict(z, y)
        np.dot(self.P, z, out=self._Pz)
        denominator = self.kappa + float(np.dot(z, self._Pz))
        surprise = float(np.dot(self.innovation, self._ones_m))
        trace = self.trace
        if not 0.0 < trace < np.inf or denominator <= 0.0:  # no later update would mend it
            self.reset()
            self.restarts += 1
            return
        if not (denominator < np.inf and -np.inf < surprise < np.inf):
            self.skipped += 1
            return
        np.divide(self._Pz, denominator, out=self._v)
        np.dot(self._v_column, self._innovation_row, out=self._theta_step)
        np.add(self.Theta, self._theta_step, out=self.Theta)
        np.divide(self._Pz, denominator**0.5, out=self._v)
        np.dot(self._v_column, self._v_row, out=self._p_step)
        np.subtract(self.P, self._p_step, out=self.P)
        if trace < self.trace_limit:
            np.divide(self.P, self.kappa, out=self.P)
        self.updates += 1


class Identified(NamedTuple):
    """What was learnt, as the imagination needs it; every array is a copy, float32.

    x (10,) state; dx (10,) its last increment; commands (command_lag + 1 + max_delay, 3) the last commands sent, oldest
    first [rad], those that act by now as they are believed to; delay: that of the commands, beyond ``command_lag``
    [samples]; model (13, 10) as in :mod:`task.model`; exact_kinematics: whether attitude and altitude follow from it;
    actuators (3, 3) as in :mod:`task.actuators`.
    """

    x: np.ndarray
    dx: np.ndarray
    commands: np.ndarray
    delay: int
    model: np.ndarray
    exact_kinematics: bool
    actuators: np.ndarray = HEALTHY


class IncrementalModel:
    """Keeps increments and the command lag, feeds the recursion, and hands out snapshots.

    Once a sample: :meth:`observe` with the state, then :meth:`command` with the command answered to it.
    ``command_lag`` L: the command a[k] first moves x[k+1+L] - x[k+L], so dx[k] is explained by
    dx[k-1] and a[k-1-L] - a[k-2-L], where dx[k] = x[k] - x[k-1].
    ``max_delay``: the longest delay beyond it that the imagination can carry [samples].
    ``theta0``, ``p0`` and ``learnt_at``: the population's prior, and the flight condition that it is of.
    """

    BRIDGED = 0.5
    """Longest gap through which the last command is taken to have been held [s]: so long the last gate holds it."""
    GOES_ON = 0.1
    """Longest stretch without a state that the model bridged after which other filters go on [s]."""
    COASTS = 3.0
    """For so long the model stands in for states that cannot be used [s]."""

    def __init__(
        self,
        settings: Adaptation,
        command_lag: int,
        theta0: np.ndarray | None = None,
        p0: np.ndarray | None = None,
        dt: float = DT,
        rates: RateModel | None = None,
        max_delay: int = 0,
        learnt_at: Condition | None = None,
    ) -> None:
        self.settings = settings
        self.command_lag = command_lag
        self.max_delay = max_delay
        self._dt = dt
        self._history = CommandHistory(command_lag + 2 + max_delay)
        self.exact_kinematics = settings.model == "reduced"
        self._rows = np.array(REDUCED_REGRESSORS if self.exact_kinematics else range(N_REGRESSORS))
        self.outputs = tuple(STATE(i) for i in (DYNAMIC if self.exact_kinematics else range(N_IDENTIFIED)))
        """The states whose increments are identified, in the order of the innovation."""
        theta0, p0 = self._prior(theta0, p0)
        self.rls = RecursiveLeastSquares(theta0, p0, settings.kappa, settings.p_growth_limit * float(np.trace(p0)))
        self._commands = np.zeros((command_lag + 2, N_ACTION))
        self._slots = list(self._commands)
        self._states = self._sent = 0
        self._x = np.zeros(N_IDENTIFIED)
        self._moved = np.zeros(N_REGRESSORS)
        """The increment of the state, and that of the command which moved it."""
        self._moved_dx, self._moved_da = self._moved[:N_IDENTIFIED], self._moved[N_IDENTIFIED:]
        self._y = self._moved[: len(self.outputs)]
        self._regressors = np.zeros(N_REGRESSORS)
        """The last increment of the state, and the same command."""
        self._dx, self._da = self._regressors[:N_IDENTIFIED], self._regressors[N_IDENTIFIED:]
        self._z = np.zeros(len(self._rows))
        self._filter = LowPass(settings.lowpass_hz, dt, N_REGRESSORS) if settings.lowpass_hz else None
        self._warm_up = 2 if self._filter is None else 2 + self._filter.settling
        self._learn = self.rls.update if settings.identify else self.rls.predict
        self.effectiveness: Effectiveness | None = None
        """The filter of the surfaces' effectiveness; None without (``effectiveness = "none"``)."""
        if settings.effectiveness == "structured":
            if rates is None:
                raise UserError(
                    "effectiveness = 'structured', but the population brings no rate model; "
                    "export it again, or fly --preset understudy"
                )
            self.effectiveness = Effectiveness(settings, rates, command_lag, dt)
        self._coasting: Coasting | None = None
        self.state_filter: StateFilter | None = None
        """The filter of the other states; None without one of the effectiveness."""
        self._schedule: tuple[Condition, RateModel] | None = None
        """Where the prior is from, and what takes it elsewhere; None where Theta is imagined as it is."""
        if settings.prior == "scheduled":
            if rates is None or learnt_at is None:
                raise UserError(
                    "prior = 'scheduled', but the population brings no rate model; "
                    "export it again, or --set prior=population"
                )
            self._schedule = learnt_at, rates
        if self.effectiveness is not None:
            self.state_filter = StateFilter(learnt_at if self._schedule else None, dt)
            self.state_filter.take(self._theta)
        self.restart_history()

    def _prior(self, theta0: np.ndarray | None, p0: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        shape = (len(self._rows), len(self.outputs))
        if self.settings.prior == "none":
            return np.zeros(shape), self.settings.p0 * np.eye(shape[0])
        if theta0 is None or p0 is None:
            raise UserError(
                f"prior = {self.settings.prior!r}, but the population brings no model prior; --set prior=none"
            )
        if theta0.shape != shape or p0.shape != (shape[0], shape[0]):
            raise UserError(
                f"model prior: expected theta {shape} and p0 {(shape[0],) * 2}, got {theta0.shape} and {p0.shape}"
            )
        return np.asarray(theta0, float), np.asarray(p0, float)

    def reset(self) -> None:
        """Start a new flight: prior, no history, nothing counted."""
        self.rls.reset()
        self.rls.skipped = self.rls.restarts = 0
        if self.effectiveness is not None and self.state_filter is not None:
            self.effectiveness.reset()
            self.state_filter.reset()
            self.state_filter.take(self._theta)
        self.restart_history()

    def restart_history(self, missed: int | None = None) -> None:
        """Forget the last states, not the model: the next increments would span a gap.

        missed: samples that are missing in the gap. Through a short one the last command was held, and what acts by
        now is known; through a longer one, or None, the commands are forgotten too.
        """
        self._states = 0
        coasted, self._coasting = self.coasting, None
        self._dx[:] = 0.0
        if self._filter is not None:
            self._filter.reset()
        bridged = missed is not None and missed * self._dt <= self.BRIDGED and self._sent > 0
        if bridged:
            held = self._slots[-1].copy()
            for _ in range(missed or 0):
                self.command(held)
        else:
            self._sent = 0
            self._history.restart()
        if self.effectiveness is not None and self.state_filter is not None:
            self.effectiveness.restart_history(commands_known=bridged)
            gone = coasted + (missed or 0)
            goes_on = bridged and gone * self._dt <= (self.GOES_ON if coasted else self.BRIDGED)
            self.state_filter.restart(gone if goes_on else None)

    @property
    def alarmed(self) -> bool:
        """Whether this sample says that the aircraft is no longer the one that was known."""
        return self.effectiveness is not None and self.effectiveness.alarmed

    @property
    def ready(self) -> bool:
        """True when there is enough of the past to form a regressor, and the low-pass has forgotten its start."""
        return self._states > self._warm_up and self._sent >= len(self._slots)

    def observe(self, x: np.ndarray) -> bool:
        """Take the state x (>= 10,) of this sample; return whether the model learnt from it."""
        x = x[:N_IDENTIFIED]
        np.subtract(x, self._x, out=self._moved_dx)
        _wrap(self._moved_dx, STATE.phi)
        _wrap(self._moved_dx, STATE.psi)
        np.subtract(self._slots[1], self._slots[0], out=self._moved_da)
        if self.effectiveness is not None:
            self.effectiveness.observe(x)
            # Theta's G stays that of healthy surfaces: it learns from what they do, not from what they are told.
            self.effectiveness.moved(self._moved_da)
            self._filter_state(x)
        np.copyto(self._x, x)
        self._states += 1
        if self._states == 1:
            return False
        if self._filter is not None:
            self._filter.filter(self._moved)
        learnt = self.ready
        if learnt:
            np.copyto(self._da, self._moved_da)
            np.take(self._regressors, self._rows, out=self._z, mode="clip")
            self._learn(self._z, self._y)
        np.copyto(self._dx, self._moved_dx)
        return learnt

    def _filter_state(self, x: np.ndarray) -> None:
        """Filter the states that are no rates."""
        found = self.effectiveness
        if found is None or self.state_filter is None or not (found.known or self.state_filter.bridges):
            return
        if self.settings.identify:
            self.state_filter.take(self._theta)
        self.state_filter.hear(x, found.rates, found.increment, self._moved_da)
        if self.state_filter.any:
            known = x.copy()
            self.state_filter.apply(known)
            found.correct(known)

    @property
    def _theta(self) -> np.ndarray:
        """Return Theta (13, 10), as learnt so far."""
        return embed_reduced(self.rls.Theta) if self.exact_kinematics else self.rls.Theta

    @property
    def filtered(self) -> int:
        """Return which of the states that are no rates are filtered, as bits: 1 V, 2 alpha, 4 beta, 8 phi, 16 theta."""
        return 0 if self.state_filter is None else sum(each << i for i, each in enumerate(self.state_filter.noisy))

    @property
    def foretold(self) -> int:
        """Return how many samples ahead the state is that whoever flies answers: as many as commands are late."""
        found = self.effectiveness
        if found is None or not (self.settings.foretell and found.known):
            return 0
        return min(found.delay_samples, self.max_delay)

    def answered(self, x: np.ndarray) -> np.ndarray:
        """Return the state (>= 10,) that whoever flies answers.

        That of this sample, x, with what is known instead of what stuck sensors say; where commands are late, the one
        that is foretold for when the answer acts. Call it between :meth:`observe` and :meth:`command`.
        """
        if self.effectiveness is None:
            return x
        x = self.effectiveness.mended(x)
        if self.foretold:
            x = x.copy()
            x[:N_IDENTIFIED] = self.snapshot().x
        elif self.state_filter is not None and self.state_filter.any:
            x = x.copy()
            self.state_filter.apply(x)
        return x

    @property
    def coasting(self) -> int:
        """For how many samples :meth:`coast` has stood in: the next usable state follows a gap."""
        return 0 if self._coasting is None else self._coasting.samples

    def coast(self) -> np.ndarray | None:
        """Return the state (10,) to answer instead of :meth:`answered` where that of this sample cannot be used.

        It is foretold from the last usable one with the commands that were sent since. None where no effectiveness is
        identified, and after ``COASTS``: the model knows the aircraft, not the air.
        """
        found = self.effectiveness
        if found is None or not self._states or self._sent < len(self._slots):
            return None
        now, commands = self._coasting, self._history.latest()
        if now is None:
            x, dx, model = self._healthy()
            # After a gap, and where the last states stood still, there is no increment.
            if self.state_filter is not None and not dx[STATE.V : STATE.beta + 1].any():
                self.state_filter.steady(dx)
            model, delay = with_effectiveness(model, found.mixing), min(found.delay_samples, self.max_delay)
            now = Coasting(x, dx, model, self.exact_kinematics, delay)
        if not now.delay:
            acting = found.followed(before=1)
            commands[-len(acting) :] = acting
        if self._dt * now.samples >= self.COASTS:
            return None
        now = now.step(commands, self.command_lag, self._dt)
        if now is None:
            return None
        self._coasting = now
        return now.answered(commands, self.foretold, self.command_lag, self._dt)

    def command(self, action: np.ndarray) -> None:
        """Take the command (3,) [rad] that was sent in answer to the last state."""
        for older, newer in zip(self._slots, self._slots[1:], strict=False):
            np.copyto(older, newer)
        np.copyto(self._slots[-1], action)
        self._sent += 1
        if self._sent == 1:
            self._commands[:] = action
        self._history.push(action)
        if self.effectiveness is not None:
            self.effectiveness.command(action)

    def _healthy(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the last state (10,) and its increment (10,), float32; the model (13, 10) with healthy surfaces."""
        model = self._theta
        x, dx = self._x.astype(np.float32), self._dx.astype(np.float32)
        if self.effectiveness is not None and self.effectiveness.known:
            self.effectiveness.smooth(x, dx)
        if self.state_filter is not None:
            self.state_filter.apply(x, dx)
        if self._schedule is not None:
            learnt_at, rates = self._schedule
            acting = self._slots[-1] if self.effectiveness is None else self.effectiveness.acting
            model = scheduled(model, learnt_at, rates, x, acting, self._dt)
        if self.effectiveness is not None and self.exact_kinematics:
            # Differences of noisy angles would be rates that are not there.
            dx[STATE.phi : STATE.h + 1] = self._dt * kinematic_rates(x)
        return x, dx, model

    def snapshot(self) -> Identified:
        """Return what was learnt so far; call it between :meth:`observe` and :meth:`command`."""
        x, dx, model = self._healthy()
        delay, commands, actuators = 0, self._history.latest()[1:], HEALTHY
        if self.effectiveness is not None:
            model = with_effectiveness(model, self.effectiveness.mixing)
            delay = min(self.effectiveness.delay_samples, self.max_delay)
            if ahead := self.foretold:
                then = foretell(x, dx, commands, ahead, self.command_lag, model, self.exact_kinematics, self._dt)
                then = then[0].astype(np.float32), then[1].astype(np.float32)
                if plausible(then[0]) and np.isfinite(then[1]).all():
                    (x, dx), delay = then, delay - ahead
            actuators = self.effectiveness.actuators
            if not delay:
                commands[-self.command_lag - 1 :] = self.effectiveness.followed()
        return Identified(
            x, dx, commands, delay, model.astype(np.float32), self.exact_kinematics, actuators.astype(np.float32)
        )


def _wrap(dx: np.ndarray, angle: int) -> None:
    """Bring the increment of an angle into (-pi, pi]."""
    if not -np.pi < dx[angle] <= np.pi:
        dx[angle] -= 2.0 * np.pi * np.round(dx[angle] / (2.0 * np.pi))
