"""When the cast is imagined and what comes of it: asks, waits or looks, and hands on the decision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from runtime.config import Adaptation
from runtime.ensemble import Ensemble
from runtime.forecast import Forecast, belief
from runtime.identification import IncrementalModel
from runtime.imagination import Imagines, Prediction, Snapshot
from runtime.reference import Reference, Trend
from runtime.switching import REASONS, Action, Cast, Decision, Reason, decide


class Played(NamedTuple):
    """An imagination at the moment that it decides."""

    returns: np.ndarray
    """(P + 1,) predicted returns, less what surface travel costs, the incumbent last; the mean of the models, where
    there are several."""
    unsafe: np.ndarray
    """(P + 1,) for how long each imagined flight is unsafe (thesis eq. 14) and not yet lost [s]."""
    age: float
    """Time since the state that it started from [s]."""
    tick_asked: int
    decision: Decision
    error: str
    """Why the imagination failed; empty when it did not."""

    def describe(self, members: list[str]) -> str:
        """Return a switch in words; members: the names of the P members."""
        action, member, reason, _ = self.decision
        predicted = f"predicted {self.returns[member]:.1f}"
        if self.unsafe[member] > 0.0:
            predicted += f" with {self.unsafe[member]:.2f} s unsafe"
        return (
            f"{action.name.lower()} switch to {members[member]}: {predicted}, incumbent {self.returns[-1]:.1f} "
            f"({REASONS[reason]})"
        )


class Plays:
    """Asks for an imagination every ``t_play`` and decides when it is there.

    In lockstep the answer to tick k decides at tick k + ``play_delay_ticks``, and is waited for there. In real time
    it decides when it is there; while one is under way no other is asked for.

    An alarm of the model asks at once, ``settle`` after it, and again every ``watch_period`` for ``watch``; what was
    asked before the alarm no longer decides.
    """

    def __init__(
        self,
        imagination: Imagines,
        model: IncrementalModel,
        cast: Cast,
        reference: Reference,
        settings: Adaptation,
        dt: float,
        lockstep: bool,
        laws: Ensemble | None = None,
    ) -> None:
        self._imagination = imagination
        self._model = model
        self._cast = cast
        self._laws = laws
        self._reference, self._trend = reference, Trend(settings.trend_time, dt)
        self._settings = settings
        self._dt = dt
        self._lockstep = lockstep
        self._period = max(round(settings.t_play / dt), 1)
        self._samples = round(settings.horizon / dt) + 1
        self._least_updates = len(model.rls.Theta) if settings.prior == "none" else 0
        self.seconds: list[float] = []
        """Wall time of each imagination [s]."""
        self.asked = 0
        self.skipped = 0
        self.failed = 0
        self._settle, self._watch = round(settings.settle / dt), round(settings.watch / dt)
        self._watch_period = max(round(settings.watch_period / dt), 1)
        self._asked_at = -1
        self._next = self._period
        self._alarm_at = self._watch_until = -1
        self._switched_at = -np.inf
        self._forecast = Forecast()
        self._belief: tuple[np.ndarray, int] | None = None
        self._candidate, self._votes = -1, 0

    def step(self, tick: int, t: float) -> Played | None:
        """Do what is due at a sample: return the decision that falls here, ask the next question.

        tick: samples since the flight began; t: time of the state [s]. The model must have observed the state.
        """
        if self._settings.switch == "none":
            return None
        self._trend.see(tick, self._reference.at(t))
        played = self._collect(tick)
        if self._model.alarmed:
            self._alarm_at, self._watch_until = tick, tick + self._settle + self._watch
            self._next = tick + self._settle
        if tick >= self._next and self._model.ready and self._model.rls.updates >= self._least_updates:
            if self._asked_at >= max(self._alarm_at, 0):
                self.skipped += 1
            else:
                self._imagination.request(self._snapshot(t), tick)
                self._asked_at = tick
                self._belief = belief(self._model.effectiveness)
                self.asked += 1
            watching = tick < self._watch_until
            self._next = tick + self._watch_period if watching else (tick // self._period + 1) * self._period
        return played

    def _snapshot(self, t: float) -> Snapshot:
        """Return all that the imagination starts from."""
        known = self._reference.preview(t, self._samples) if self._settings.preview else None
        reference = self._trend.ahead(self._samples) if known is None else known
        return Snapshot(
            **self._model.snapshot()._asdict(), reference=reference, incumbent=self._cast.live.copy(),
            laws=self._laws.linear() if self._laws else (), law=self._cast.law,
        )  # fmt: skip

    def _collect(self, tick: int) -> Played | None:
        """Return the decision of the imagination under way if it falls at this tick."""
        asked = self._asked_at
        if asked < 0 or (self._lockstep and tick < asked + self._settings.play_delay_ticks):
            return None
        prediction = self._imagination.wait(asked) if self._lockstep else self._imagination.result(asked)
        if prediction is None:
            if self._lockstep:
                self._asked_at = -1
                self.failed += 1
            return None
        self._asked_at = -1
        self.failed += bool(prediction.error)
        self.seconds.append(prediction.seconds)
        age = (tick - asked) * self._dt
        since_switch = (tick - self._switched_at) * self._dt
        overtaken = asked < self._alarm_at
        settings = self._settings
        worth = self._worth(prediction)
        returns = self._forecast.take(worth, asked * self._dt, self._belief, settings.forecast_time)
        unsafe = self._dt * prediction.unsafe.mean(axis=0)
        decision = decide(returns, self._cast.flying, age, settings, since_switch, overtaken, self._cast.first)
        decision = self._careful(decision, tick)
        if decision.action is not Action.KEEP:
            self._switched_at = tick
        played = Played(returns.copy(), unsafe, age, asked, decision, prediction.error)
        if decision.action is not Action.KEEP:
            self._forecast.follow(decision.member)
        return played

    def _worth(self, prediction: Prediction) -> np.ndarray:
        """Return what is predicted of each member (P + 1,): its return, less what the travel of its surfaces costs."""
        settings, returns = self._settings, prediction.returns
        if settings.travel_cost > 0.0:
            free = settings.travel_free * settings.horizon
            returns = returns - settings.travel_cost * np.maximum(prediction.travel - free, 0.0)
        return returns.mean(axis=0)

    def _careful(self, decision: Decision, tick: int) -> Decision:
        """Return the decision, hard when members must not be averaged, and put off when too little speaks for it.

        A member can be the better one by chance: ``confirmations`` in a row must name it, ``confirmations_watch`` after
        an alarm, the next of them asked for at once. One that opposes the member that flies is right only when a
        surface works backwards, and without an alarm needs two at least.
        """
        if decision.action is Action.KEEP:
            self._candidate = -1
            return decision
        opposed = self._cast.opposes(decision.member)
        self._votes = self._votes + 1 if decision.member == self._candidate else 1
        self._candidate = decision.member
        watching = tick < self._watch_until
        usual = self._settings.confirmations_watch if watching else self._settings.confirmations
        needed = max(usual, 2) if opposed and not watching and self._model.effectiveness is not None else usual
        if self._votes < needed:
            if usual > 1:
                self._next = tick
            return decision._replace(action=Action.KEEP, reason=Reason.UNCONFIRMED)
        self._candidate = -1
        return decision._replace(action=Action.HARD) if opposed else decision
