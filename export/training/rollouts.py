"""The world that a trainer learns in: what it asks of one, and the Citation's."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from export.network import Network
from export.training.config import TaskSettings
from export.training.flights import Fleet, Flights, draw_references
from sim_bridge.conditions import FlightCondition
from task.limits import ACTION_HIGH, DT
from task.reward import CRASH_COST_PER_FRAME, crash_penalty
from task.state import N_OBSERVATION


class Rollouts(Protocol):
    """Flights, or episodes, of many policies side by side; what the policies fly is a task common to all.

    An implementation draws chance from ``rng`` and ``noise`` alone: a run is a function of its seed.
    """

    observation: int
    """Size of the observation s."""
    action_scale: tuple[float, ...]
    """Bound of each action; u is in units of it."""
    ticks: int
    """Most samples that one flight can have."""

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return ``count`` tasks, stacked along the first axis: references, or seeds of episodes."""
        ...

    def fly(self, network: Network, parameters: np.ndarray, tasks: np.ndarray, noise: np.ndarray) -> Flights:
        """Fly P policies (P, K) float32 on E tasks each; E = len(tasks).

        noise: (ticks, E, len(action_scale)) float32, added to the last policy's u, which is then clipped to [-1, 1].
        """
        ...

    def learnt_reward(self, flights: Flights, gamma: float) -> np.ndarray:
        """Return the rewards (T, P, E) float32 that the critics learn from; ``flights.reward`` makes the fitness."""
        ...


def discounted_penalty(frames_left: int, gamma: float) -> float:
    """Return -sum_{i < n} gamma^i C_P: eq. 13 as the critic of eq. 1 would have summed it frame by frame."""
    series = (1.0 - gamma**frames_left) / (1.0 - gamma) if gamma < 1.0 else float(frames_left)
    return -CRASH_COST_PER_FRAME * series


class CitationRollouts:
    """The attitude-tracking task: tasks are references (E, T + 1, 3) [rad]."""

    observation: int = N_OBSERVATION
    action_scale: tuple[float, ...] = tuple(ACTION_HIGH.tolist())

    def __init__(self, settings: TaskSettings, discount_penalty: bool) -> None:
        """Fly ``settings.duration``; ``discount_penalty``: see :class:`export.training.config.TD3Settings`."""
        self.settings = settings
        self.discount_penalty = discount_penalty
        self.ticks = settings.ticks
        self.fleet = Fleet(FlightCondition(altitude=settings.altitude, speed=settings.speed))

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return references of the configured family, (count, T + 1, 3) [rad]."""
        return draw_references(rng, count, self.settings.duration, self.fleet.theta_trim, self.settings.family)

    def fly(self, network: Network, parameters: np.ndarray, tasks: np.ndarray, noise: np.ndarray) -> Flights:
        """Fly from trim; see :meth:`export.training.flights.Fleet.fly`."""
        return self.fleet.fly(network, parameters, tasks, noise)

    def learnt_reward(self, flights: Flights, gamma: float) -> np.ndarray:
        """Return the rewards with the crash penalty of eq. 13 discounted, where that is configured."""
        if not self.discount_penalty:
            return flights.reward
        reward = flights.reward.copy()
        for p, e in np.argwhere(flights.lost):
            n = flights.length[p, e]
            left = len(reward) - int(n)
            reward[n - 1, p, e] += discounted_penalty(left, gamma) - crash_penalty(left * DT)
        return reward
