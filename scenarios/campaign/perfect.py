"""Imagination in the aircraft itself, a perfect model: the process is forked, and each copy flies on with one member.

What comes of a member is then exactly what will come of it: the fault, the air, the noise, and what the estimator and
the laws will have found by then. No runtime has such a model. Its flights say what a better one could still gain; what
they lose, nobody in the cast saves who is chosen by looking ``horizon`` ahead.

With sequences each imagined flight may change its member once more on the way, and the best second one counts: a search
of the tree of depth two. Returns are sums of what is never positive, so that a flight is cut off when it has lost more
than the best one so far, which leaves every decision as it was.
"""

from __future__ import annotations

import os
import struct
import time

import numpy as np

from runtime.guard import UNUSABLE, Guard
from runtime.identification import IncrementalModel
from runtime.imagination import Prediction, Snapshot
from runtime.policy import Policy
from runtime.switching import Action, Cast, Decision, Reason
from sim_bridge.world import World
from task.errors import UserError
from task.limits import DT
from task.observation import tracking_error
from task.reward import CRASH_COST_PER_FRAME, terminated, tracking_reward, unsafe
from task.state import N_STATE

_ANSWER = struct.Struct("2d")
_NO_BOUND = float("-inf")


class PerfectModel:
    """Stands where :class:`runtime.imagination.Imagination` would; answers at once.

    Every imagined flight is a copy of this process, which flies the aircraft on with the runtime's own parts and ends.
    It excites no surface and counts no surface travel. Without a preview the reference of the moment is held, as in any
    imagination.
    """

    LOOK = 10
    """So often an imagined flight is looked at whether it is cut off [samples]."""

    def __init__(
        self,
        world: World,
        policy: Policy,
        cast: Cast,
        model: IncrementalModel,
        guard: Guard,
        members: int,
        soft: bool,
        stage: float = 0.0,
    ) -> None:
        """Take the aircraft and the parts of the runtime that fly it.

        members: how many there are; soft: how imagined flights change their member; stage: after so long each may
        change it once more [s], 0 for never. Raises UserError on a system that cannot fork.
        """
        if not hasattr(os, "fork"):
            raise UserError("the perfect model: this system cannot fork a process; fly this row on Linux or macOS")
        self._world, self._policy, self._cast, self._model, self._guard = world, policy, cast, model, guard
        self._members, self._action = members, Action.SOFT if soft else Action.HARD
        self._stage = round(stage / DT)
        self._order = list(range(members))
        """Members, the best of the last question first: the sooner a good one is flown, the sooner others are cut."""
        self._answer: Prediction | None = None

    def request(self, snapshot: Snapshot, tick: int) -> None:
        """Fly every member on from here, where the runtime has seen the state and not yet answered it."""
        began = time.perf_counter()
        flying, blending = self._cast.flying, self._cast.blend > 0.0
        incumbent = self._explore(None, snapshot.reference, 0, 0.0, _NO_BOUND)
        found = {} if blending else {flying: incumbent}
        best = incumbent[0]
        for member in self._order:
            if member not in found:
                found[member] = self._explore(member, snapshot.reference, 0, 0.0, best)
                best = max(best, found[member][0])
        self._order.sort(key=lambda member: -found[member][0])
        rows = np.array([*(found[member] for member in range(self._members)), incumbent])
        returns, dangers = rows.T[:, None]
        self._answer = Prediction(returns, dangers, np.zeros_like(returns), tick, time.perf_counter() - began)

    def result(self, tick: int) -> Prediction | None:
        """Return the answer to the question asked at ``tick``."""
        return self._answer

    def wait(self, tick: int) -> Prediction | None:
        """Return the answer to the question asked at ``tick``."""
        return self._answer

    def close(self) -> None:
        """Do nothing."""

    def _explore(
        self, member: int | None, reference: np.ndarray, start: int, earned: float, bound: float
    ) -> tuple[float, float]:
        """Return return and unsafe samples of a member (None: of whoever flies) from sample ``start`` on.

        reference: (H + 1, 3) [rad]; earned: before ``start``; bound: a return below it need not be exact.
        """
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.write(writing, _ANSWER.pack(*self._fly_on(member, reference, start, earned, bound)))
            finally:
                os._exit(0)  # nothing that the copy inherited is closed, written or said twice
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            said = pipe.read()
        os.waitpid(child, 0)
        if len(said) != _ANSWER.size:
            raise RuntimeError("a copy of the process, in which a flight was imagined, came to a bad end")
        returned, dangers = _ANSWER.unpack(said)
        return returned, dangers

    def _fly_on(
        self, member: int | None, reference: np.ndarray, start: int, earned: float, bound: float
    ) -> tuple[float, float]:
        """Fly to the end of the stage, then with the best second member to the horizon; the same as ``_explore``."""
        if member is not None and member != self._cast.flying:
            action = Action.HARD if self._cast.opposes(member) else self._action
            self._cast.take(Decision(action, member, Reason.BETTER, 0.0))
        horizon = len(reference) - 1
        last = horizon if start or not self._stage else min(self._stage, horizon)
        x, dangers = np.zeros((last - start, N_STATE)), 0.0
        learning = last < horizon or self._learning
        for first in range(start, last, self.LOOK):
            end = min(first + self.LOOK, last)
            for t in range(first, end):
                x[t - start] = self._step(reference[t], learning, seen=t == start)
            flown, rows = x[first - start : end - start], reference[first + 1 : end + 1]
            lost = terminated(flown)
            if lost.any():
                at = int(np.argmax(lost))
                earned += float(tracking_reward(tracking_error(flown[:at], rows[:at])).sum())
                return earned - CRASH_COST_PER_FRAME * (horizon - first - at), dangers + float(unsafe(flown[:at]).sum())
            earned += float(tracking_reward(tracking_error(flown, rows)).sum())
            dangers += float(unsafe(flown).sum())
            if earned < bound:
                return earned, dangers
        if last == horizon:
            return earned, dangers
        self._model.observe(self._world.measured)
        best = self._explore(None, reference, last, earned, bound)
        for other in self._order:
            if other != self._cast.flying:
                best = max(best, self._explore(other, reference, last, earned, max(bound, best[0])))
        return best[0], best[1] + dangers

    @property
    def _learning(self) -> bool:
        """Whether what the estimator finds matters: to laws, and where sensors stand still or states are foretold."""
        found = self._model.effectiveness
        return self._cast.law is not None or (found is not None and (found.stuck.any or self._model.foretold > 0))

    def _step(self, reference: np.ndarray, learning: bool, seen: bool) -> np.ndarray:
        """Do a cycle of :class:`runtime.loop.Loop` without its question; return the next true state (12,).

        learning: whether the estimator learns on; seen: whether it has this state already.
        """
        measured = self._world.measured
        if self._guard.check_state(measured) & UNUSABLE:
            self._model.restart_history()
            self._policy.restart_history()
            command, _ = self._guard.fallback()
        else:
            if learning and not seen:
                self._model.observe(measured)
            self._cast.step()
            command, _ = self._guard.command(self._policy.steer(self._model.answered(measured), reference))
        self._world.step(command)
        if learning:
            self._model.command(command)
        self._policy.sent(command)
        return self._world.x
