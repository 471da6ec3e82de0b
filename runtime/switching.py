"""When to change the cast: a pure decision from predicted returns (thesis section 8.3)."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from runtime.config import Adaptation


class Action(IntEnum):
    """What to do with the behavioural policy."""

    KEEP = 0
    HARD = 1
    SOFT = 2


class Reason(IntEnum):
    """Why; the value is what the log holds."""

    SWITCHED_OFF = 0
    BETTER = 1
    MARGIN = 2
    INCUMBENT_IS_BEST = 3
    TOO_OLD = 4
    NO_PREDICTION = 5
    INCUMBENT_UNKNOWN = 6


REASONS = {
    Reason.SWITCHED_OFF: "switch = none",
    Reason.BETTER: "another member is predicted to fly better by more than the margin",
    Reason.MARGIN: "the best member does not beat the incumbent by the margin",
    Reason.INCUMBENT_IS_BEST: "the best member flies already, or the blend is on its way to it",
    Reason.TOO_OLD: "the prediction is older than max_age",
    Reason.NO_PREDICTION: "no member has a finite predicted return",
    Reason.INCUMBENT_UNKNOWN: "the incumbent's own return is not finite; the best member takes over",
}
"""Reason: in words."""


class Decision(NamedTuple):
    """What to do, towards which member, why, and by how much the best member is ahead of the incumbent."""

    action: Action
    member: int
    """Index of the best member; -1 without one."""
    reason: Reason
    lead: float
    """R_best - R_incumbent; NaN when either is unknown."""


def decide(returns: np.ndarray, flying: int, age: float, settings: Adaptation) -> Decision:
    """Return what to do with one imagination of the cast.

    returns: (P + 1,) predicted returns, the behavioural policy's own last (it may be half-way between members);
    flying: index of the member that flies or that a blend moves towards; age: of the prediction [s].

    The best member replaces the incumbent if R_best > R_incumbent + margin * |R_incumbent|.
    """
    members, incumbent = returns[:-1], float(returns[-1])
    known = np.isfinite(members)
    best = int(np.argmax(np.where(known, members, -np.inf))) if known.any() else -1
    lead = float(members[best]) - incumbent if best >= 0 and np.isfinite(incumbent) else float("nan")
    switch = Action.HARD if settings.switch == "hard" else Action.SOFT
    if settings.switch == "none":
        return Decision(Action.KEEP, best, Reason.SWITCHED_OFF, lead)
    if age > settings.max_age:
        return Decision(Action.KEEP, best, Reason.TOO_OLD, lead)
    if best < 0:
        return Decision(Action.KEEP, best, Reason.NO_PREDICTION, lead)
    if best == flying:
        return Decision(Action.KEEP, best, Reason.INCUMBENT_IS_BEST, lead)
    if not np.isfinite(incumbent):
        return Decision(switch, best, Reason.INCUMBENT_UNKNOWN, lead)
    if lead > settings.margin * abs(incumbent):
        return Decision(switch, best, Reason.BETTER, lead)
    return Decision(Action.KEEP, best, Reason.MARGIN, lead)


class Cast:
    """Which member flies, and the change of parameters under way; applied at cycle boundaries only.

    ``live`` (K,) are the behavioural policy's own parameters, changed in place, and ``members`` (P, K) the
    population's; float32.
    """

    DONE = 1e-6
    """A blend ends when less than this share is left to go: float32 parameters no longer move."""

    def __init__(self, live: np.ndarray, members: np.ndarray, champion: int, rho: float) -> None:
        self.live = live
        self._members = members
        self._champion = champion
        self._rho = np.float32(rho)
        self._step = np.empty_like(live)
        self.reset()

    def reset(self) -> None:
        """Fly the champion."""
        self.flying = self._champion
        self.blend = 0.0
        np.copyto(self.live, self._members[self._champion])

    def take(self, decision: Decision) -> None:
        """Begin what was decided: copy the member at once (hard) or move towards it from here on (soft)."""
        if decision.action is Action.KEEP:
            return
        self.flying = decision.member
        self.blend = 1.0 if decision.action is Action.SOFT else 0.0
        if decision.action is Action.HARD:
            np.copyto(self.live, self._members[decision.member])

    def step(self) -> None:
        """Do one sample of a blend: theta_b <- (1 - rho) theta_b + rho theta_c (eq. 8.8)."""
        if self.blend == 0.0:
            return
        target = self._members[self.flying]
        self.blend *= 1.0 - float(self._rho)
        if self.blend < self.DONE:
            self.blend = 0.0
            np.copyto(self.live, target)
            return
        np.subtract(target, self.live, out=self._step)
        np.multiply(self._step, self._rho, out=self._step)
        np.add(self.live, self._step, out=self.live)
