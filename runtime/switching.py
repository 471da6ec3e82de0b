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
    OVERTAKEN = 7
    DWELL = 8
    UNCONFIRMED = 9


REASONS = {
    Reason.SWITCHED_OFF: "switch = none",
    Reason.BETTER: "another member is predicted to fly better by more than the margin",
    Reason.MARGIN: "the best member does not beat the incumbent by the margin",
    Reason.INCUMBENT_IS_BEST: "the best member flies already, or the blend is on its way to it",
    Reason.TOO_OLD: "the prediction is older than max_age",
    Reason.NO_PREDICTION: "no member has a finite predicted return",
    Reason.OVERTAKEN: "an alarm came after the question",
    Reason.UNCONFIRMED: "so few imaginations are not enough to change to this member",
    Reason.DWELL: "the last switch is younger than the dwell time",
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
    """R_best - R_incumbent, with the head start of who flies first; NaN when either is unknown."""


def decide(
    returns: np.ndarray,
    flying: int,
    age: float,
    settings: Adaptation,
    since_switch: float = np.inf,
    overtaken: bool = False,
    first: int = -1,
) -> Decision:
    """Return what to do with one imagination of the cast.

    returns: (P + 1,) predicted returns, the behavioural policy's own last (it may be half-way between members);
    flying: index of the member that flies or that a blend moves towards; age: of the prediction [s]; since_switch: time
    since the last switch [s]; overtaken: whether an alarm came after the question, which was about an aircraft that is
    no more; first: index of the member that flies first, whose returns are taken to be better by ``head_start``.

    The best member replaces the incumbent if R_best > R_incumbent + margin * |R_incumbent|.
    """
    members, incumbent = returns[:-1], float(returns[-1])
    if settings.head_start > 0.0 and first >= 0:
        members = members.copy()
        members[first] += settings.head_start
        incumbent += settings.head_start * (flying == first)
    known = np.isfinite(members)
    best = int(np.argmax(np.where(known, members, -np.inf))) if known.any() else -1
    lead = float(members[best]) - incumbent if best >= 0 and np.isfinite(incumbent) else float("nan")
    switch = Action.HARD if settings.switch == "hard" else Action.SOFT
    if settings.switch == "none":
        return Decision(Action.KEEP, best, Reason.SWITCHED_OFF, lead)
    if overtaken:
        return Decision(Action.KEEP, best, Reason.OVERTAKEN, lead)
    if age > settings.max_age:
        return Decision(Action.KEEP, best, Reason.TOO_OLD, lead)
    if best < 0:
        return Decision(Action.KEEP, best, Reason.NO_PREDICTION, lead)
    if best == flying:
        return Decision(Action.KEEP, best, Reason.INCUMBENT_IS_BEST, lead)
    if since_switch < settings.dwell:
        return Decision(Action.KEEP, best, Reason.DWELL, lead)
    if not np.isfinite(incumbent):
        return Decision(switch, best, Reason.INCUMBENT_UNKNOWN, lead)
    if lead > settings.margin * abs(incumbent):
        return Decision(switch, best, Reason.BETTER, lead)
    return Decision(Action.KEEP, best, Reason.MARGIN, lead)


OPPOSED = -0.5
"""Two members whose commands on a surface correlate less than this must not be averaged."""


def opposed(actions: np.ndarray) -> np.ndarray:
    """Return which members must not be averaged, (P, P) bool, symmetric.

    actions: (P, N, 3) [rad], every member's commands on the same N observations. A policy and its mirror command the
    same with the opposite sign: half-way between them nothing is commanded at all. Pairs whose commands on any one
    surface are that unlike (cosine below ``OPPOSED``) are switched hard.
    """
    per_surface = np.moveaxis(np.asarray(actions, dtype=float), -1, 0)  # (3, P, N)
    size = np.linalg.norm(per_surface, axis=-1, keepdims=True)
    unit = np.divide(per_surface, size, out=np.zeros_like(per_surface), where=size > 0.0)
    return (unit @ np.swapaxes(unit, -1, -2) < OPPOSED).any(axis=0)


class Cast:
    """Which member flies, and the change under way; applied at cycle boundaries only.

    ``live`` (K,) are the behavioural policy's own parameters, changed in place, and ``members`` (P, K) the
    population's; float32. ``opposed`` (P, P): which must not be averaged, from :func:`opposed`. Members from P on are
    laws, which have no parameters: a soft change from or to one of them is a handing over of actions
    (:class:`runtime.ensemble.Ensemble`), with the same ``blend``.
    """

    DONE = 1e-6
    """A blend ends when less than this share is left to go: float32 parameters no longer move."""

    def __init__(
        self, live: np.ndarray, members: np.ndarray, first: int, rho: float, opposed: np.ndarray | None = None
    ) -> None:
        self.live = live
        self._members = members
        self.first = first
        self._rho = np.float32(rho)
        self._opposed = opposed
        self._step = np.empty_like(live)
        self.reset()

    def reset(self) -> None:
        """Fly the member that flies first."""
        self.flying = self._origin = self.first
        self.blend = 0.0
        self.handing_over = self.taken = False
        """Whether a change of actions is under way, and whether it began in this cycle."""
        self._copy()

    @property
    def law(self) -> int | None:
        """Return which law flies; None when a network does."""
        number = self.flying - len(self._members)
        return number if number >= 0 else None

    def _copy(self) -> None:
        if self.law is None:
            np.copyto(self.live, self._members[self.flying])

    def _is_law(self, member: int) -> bool:
        return member >= len(self._members)

    def opposes(self, member: int) -> bool:
        """Return whether a member must not be averaged with what flies."""
        if self._opposed is None or self._is_law(member) or self._is_law(self.flying):
            return False
        row = self._opposed[member]
        return bool(row[self.flying] or (self.blend > 0.0 and not self._is_law(self._origin) and row[self._origin]))

    def take(self, decision: Decision) -> None:
        """Begin what was decided: copy the member at once (hard) or move towards it from here on (soft)."""
        if decision.action is Action.KEEP:
            return
        self._origin, self.flying = self.flying, decision.member
        self.blend = 1.0 if decision.action is Action.SOFT else 0.0
        averaged = not (self.handing_over or self._is_law(self._origin) or self._is_law(self.flying))
        self.handing_over = self.taken = decision.action is Action.SOFT and not averaged
        if decision.action is Action.HARD or self.handing_over:
            self._copy()

    def step(self) -> None:
        """Do one sample of a blend: theta_b <- (1 - rho) theta_b + rho theta_c (eq. 8.8)."""
        if self.blend == 0.0:
            return
        if self.handing_over:
            if not self.taken:
                self.blend *= 1.0 - float(self._rho)
            if self.blend < self.DONE:
                self.blend, self.handing_over = 0.0, False
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
