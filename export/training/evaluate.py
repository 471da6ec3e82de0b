"""How well every actor flies: nMAE and smoothness on references that training has not seen."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from export.network import Network
from export.training.flights import Fleet, draw_references
from sim_bridge.plant import Plant
from task.metrics import nmae
from task.state import N_REFERENCE

DURATION = 80.0
"""Length of an evaluation flight [s] (thesis section III.E)."""


class Scores(NamedTuple):
    """Of P actors on E references; each (P, E)."""

    nmae: np.ndarray
    """[%], over the part that was flown."""
    smoothness: np.ndarray
    """Sm of eq. 16 [rad Hz]."""
    returns: np.ndarray
    lost: np.ndarray
    """The flight ended before its time."""

    def ranking(self) -> np.ndarray:
        """Return each actor's mean nMAE [%], infinite where it lost a flight; shape (P,)."""
        return np.where(self.lost.any(axis=1), np.inf, self.nmae.mean(axis=1))


def evaluation_references(fleet: Fleet, seed: int, count: int, duration: float = DURATION) -> np.ndarray:
    """Return ``count`` references (count, T + 1, 3) [rad] of the evaluation family from one seed."""
    return draw_references(np.random.default_rng(seed), count, duration, fleet.theta_trim, "evaluation")


def evaluate(
    fleet: Fleet,
    network: Network,
    parameters: np.ndarray,
    references: np.ndarray,
    prepare: Callable[[Plant], None] | None = None,
) -> Scores:
    """Fly actors (P, K) on references (E, T + 1, 3); ``prepare`` breaks each aircraft after its reset."""
    flights = fleet.fly(network, parameters, references, prepare=prepare)
    errors = flights.observation[1:, ..., :N_REFERENCE]
    score = np.empty(flights.length.shape)
    for i, n in np.ndenumerate(flights.length):
        score[i] = nmae(errors[(slice(n), *i)].astype(float))
    return Scores(score, flights.smoothness(np.array(network.action_scale)), flights.returns(), flights.lost)
