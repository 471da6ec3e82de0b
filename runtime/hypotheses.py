"""What may have become of the commands on their way to the surfaces, and which of it the evidence is for.

Each hypothesis says which older command acts now (a delay beyond ``command_lag``), on which surface (aileron and
rudder crossed), and how fast surfaces move. How well they work is the filters' affair, so that a hypothesis is right
whatever their effectiveness.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from runtime.config import Adaptation
from task.actuators import ACTUATOR, HEALTHY, limited
from task.state import ACTION, N_ACTION

STRAIGHT = (int(ACTION.de), int(ACTION.da), int(ACTION.dr))
CROSSED = (int(ACTION.de), int(ACTION.dr), int(ACTION.da))
"""Whose command acts as elevator, aileron and rudder."""


class Hypothesis(NamedTuple):
    """What a command meets on its way."""

    delay: int
    """Samples beyond ``command_lag``."""
    order: tuple[int, int, int]
    """Whose command acts as elevator, aileron, rudder."""
    rate: float = math.inf
    """How fast every surface moves at most [rad/s]."""
    bandwidth: float = math.inf
    """How fast every surface closes in on its command, as the corner frequency of a first-order lag [Hz]."""
    uncommanded: int | None = None
    """The surface that moves besides by itself (:mod:`runtime.uncommanded`)."""
    limited: int | None = None
    """The surface whose range is to be found (:mod:`runtime.ranges`)."""


def hypotheses(settings: Adaptation, dt: float) -> tuple[Hypothesis, ...]:
    """Return the healthy one first, then each delay, crossed aileron and rudder, each rate limit and each lag.

    Then, where they are asked for, for each of elevator, aileron and rudder one in which it moves by itself, and one in
    which its range is limited.
    """
    late = sorted({round(delay / dt) for delay in settings.delays} - {0})
    straight = tuple(Hypothesis(delay, STRAIGHT) for delay in (0, *late))
    crossed = (Hypothesis(0, CROSSED),) * settings.crossed
    slow = tuple(Hypothesis(0, STRAIGHT, rate) for rate in sorted(set(settings.rate_limits), reverse=True))
    slow += tuple(Hypothesis(0, STRAIGHT, bandwidth=hz) for hz in sorted(set(settings.bandwidths), reverse=True))
    moving = tuple(Hypothesis(0, STRAIGHT, uncommanded=surface) for surface in STRAIGHT if settings.q_uncommanded)
    limited = tuple(Hypothesis(0, STRAIGHT, limited=surface) for surface in STRAIGHT) * settings.ranges
    return straight + crossed + slow + moving + limited


def actuators(choice: Hypothesis) -> np.ndarray:
    """Return range and rate of the surfaces (3, 3), as in :mod:`task.actuators`."""
    found = HEALTHY.copy()
    found[ACTUATOR.rate] = choice.rate
    return found


class Inputs:
    """The commands of the last samples, and what each hypothesis makes of them: ``u`` (M, 3) [rad]."""

    def __init__(self, choices: tuple[Hypothesis, ...], command_lag: int, dt: float) -> None:
        self._least = command_lag + 1
        length = self._least + max(choice.delay for choice in choices)
        self._commands = np.zeros((length, N_ACTION))
        self._flat = self._commands.reshape(-1)
        self._older, self._newer = self._commands[:-1], self._commands[1:]
        self._where = np.array([
            [(length - self._least - choice.delay) * N_ACTION + of for of in choice.order] for choice in choices
        ])  # fmt: skip
        slow = [i for i, choice in enumerate(choices) if min(choice.rate, choice.bandwidth) < math.inf]
        self._slow = slow[0] if slow else len(choices)
        """Row of the first hypothesis of slow surfaces."""
        limits = [actuators(choices[i]) for i in slow]
        self._gain = np.array([1.0 - math.exp(-2.0 * math.pi * choices[i].bandwidth * dt) for i in slow])[:, None]
        """Share of the way to the command that a surface goes in a sample."""
        self._slow_rows = slice(self._slow, self._slow + len(limits))
        self._actuators = np.array(limits).reshape(-1, len(ACTUATOR), N_ACTION).swapaxes(0, 1)
        self._dt = dt
        self._followed = np.zeros((self._least + 1, len(limits), N_ACTION))
        """What slow surfaces make of the last commands, each from the one before."""
        self._older_followed, self._newer_followed = self._followed[:-1], self._followed[1:]
        self.u, self.before = np.zeros((2, len(choices), N_ACTION))
        """What acts on the last state, and on the one before it."""
        self.restart()

    def restart(self) -> None:
        """Forget the commands."""
        self._sent = 0

    @property
    def known(self) -> bool:
        """Whether the command that acts now without a delay is known; older ones are taken to be the first one."""
        return self._sent >= self._least

    def send(self, action: np.ndarray) -> None:
        """Take the command (3,) [rad] that was sent in answer to the last state."""
        if self._sent == 0:
            self._commands[:] = action
            self._followed[:] = action
        else:
            np.copyto(self._older, self._newer)
            self._commands[-1] = action
            if len(self._actuators[0]):
                np.copyto(self._older_followed, self._newer_followed)
                before = self._followed[-2]
                self._followed[-1] = limited(before + self._gain * (action - before), before, self._actuators, self._dt)
        self._sent += 1

    def followed(self, hypothesis: int, before: int = 0) -> np.ndarray:
        """Return what becomes of the last ``command_lag`` + 1 commands, without their delay: oldest first (L, 3).

        before: 1 for the one before them besides.
        """
        slow = hypothesis - self._slow
        if 0 <= slow < self._followed.shape[1]:
            return self._followed[1 - before :, slow]
        return self._commands[-self._least - before :]

    def take(self) -> np.ndarray:
        """Return ``u``, brought up to date."""
        np.copyto(self.before, self.u)
        np.take(self._flat, self._where, out=self.u, mode="clip")
        self.u[self._slow_rows] = self._followed[1]
        return self.u


class Evidence:
    """Log-likelihoods of the hypotheses with forgetting, and the one that is believed.

    Another hypothesis is believed when it leads the believed one by ``needed`` [nats] for ``HOLD`` samples; by
    ``needed_open`` while the filters are open. All have then started alike, each sample counts for more, and nothing is
    forgotten: what tells crossed surfaces from reversed ones is seen once, before the commands run into their limits.
    """

    HOLD = 3
    SAYS = 1.0
    """The most that one sample says against a hypothesis [nats]: where the model is wrong for a moment, as at the
    stall, all are surprised, and which of them the least is chance."""
    SAYS_OPEN = 2.0
    """The same while the filters are open."""
    ADHERENCE = 2.0
    """How many times ``needed`` it takes to give up a hypothesis that started behind: it explains with more freedom,
    for which each sample counts against it, and has made up for that once."""

    def __init__(self, odds: list[float], memory: float, needed: float, needed_open: float) -> None:
        """``odds``: how far behind each hypothesis is when all are weighed anew [nats]."""
        self._closed, self._open = (memory, needed, self.SAYS), (1.0, needed_open, self.SAYS_OPEN)
        self._odds = odds
        self.reset()

    def reset(self) -> None:
        """Believe in the healthy aircraft; nothing seen."""
        self.believed = 0
        self.forget()

    def forget(self) -> None:
        """Keep what is believed and weigh anew."""
        self.behind = list(self._odds)
        """How far each hypothesis is behind the best [nats]."""
        self.behind[self.believed] = 0.0
        self.best = self.believed
        self._held = 0

    def weigh(self, log_likelihood: list[float], opened: bool = False) -> bool:
        """Take each filter's log-likelihood of a sample; return whether another hypothesis is believed from now on."""
        memory, needed, says = self._open if opened else self._closed
        if self._odds[self.believed]:
            needed *= self.ADHERENCE
        most = max(log_likelihood)
        score = [
            max(new - most, -says) - memory * behind for new, behind in zip(log_likelihood, self.behind, strict=True)
        ]
        top = max(score)
        best = score.index(top)
        self.behind = [min(top - each, needed + says) for each in score]
        self._held = self._held + 1 if best == self.best and self.behind[self.believed] > needed else 0
        self.best = best
        if self._held < self.HOLD:
            return False
        self.believed, self._held = best, 0
        return True

    @property
    def confidence(self) -> float:
        """Share of the believed hypothesis in the likelihood of all, 0 to 1."""
        weights = [math.exp(-behind) for behind in self.behind]
        return weights[self.believed] / sum(weights)
