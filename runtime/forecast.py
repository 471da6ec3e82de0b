"""What is predicted of each member, over several imaginations that asked about the same aircraft."""

from __future__ import annotations

import math

import numpy as np

from runtime.structured import Effectiveness

SAME = 0.1
"""A belief is the same while no effectiveness has moved by more than this [-]."""


class Forecast:
    """Means of predicted returns with forgetting in time; a new belief about the aircraft starts anew.

    One imagination goes on from one moment, with its gust and its noise; a tenth of a second later the same member may
    be predicted to do ten times as well. What several of them say is the member's, what one says may be the gust's.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._mean: np.ndarray | None = None
        self._asked_at = 0.0
        self._effect, self._hypothesis = np.zeros(0), -1

    def take(
        self, returns: np.ndarray, asked_at: float, belief: tuple[np.ndarray, int] | None, memory: float
    ) -> np.ndarray:
        """Return the mean (P + 1,) with ``returns`` (P + 1,) in it.

        asked_at: time of the state that they start from [s]; belief: lambda (3,) and the hypothesis then imagined;
        memory: time constant of the forgetting [s], 0 believes each imagination as it comes.
        """
        effect, hypothesis = belief or (np.zeros(0), -1)
        same = hypothesis == self._hypothesis and bool((np.abs(effect - self._effect) <= SAME).all())
        if self._mean is None or memory == 0.0 or not same:
            self._mean, self._effect, self._hypothesis = returns.copy(), effect, hypothesis
        else:
            weight = 1.0 - math.exp(-(asked_at - self._asked_at) / memory)
            mean = self._mean + weight * (returns - self._mean)
            self._mean = np.where(np.isfinite(mean), mean, returns)
        self._asked_at = asked_at
        return self._mean

    def follow(self, member: int) -> None:
        """Take the incumbent, last in the mean, to be this member from now on."""
        if self._mean is not None:
            self._mean[-1] = self._mean[member]


def belief(found: Effectiveness | None) -> tuple[np.ndarray, int] | None:
    """Return what is imagined of the surfaces: lambda (3,) and the hypothesis; None without a filter."""
    return None if found is None else (found.believed.copy(), found.evidence.believed)
