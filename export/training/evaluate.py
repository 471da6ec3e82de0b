"""How well, how smoothly and how safely every actor flies, on references that training has not seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from export.network import Network
from export.training.flights import Fleet, Flights, draw_references
from task.metrics import ATTITUDE_RANGE, nmae
from task.state import N_REFERENCE, REFERENCE

DURATION = 80.0
"""Length of an evaluation flight [s] (thesis section III.E)."""
SATURATED = 0.999
"""A command from this part of its bound on counts as saturated; tanh never reaches the bound itself."""


class Scores(NamedTuple):
    """Of P actors on E references; each (P, E) but ``mae``; over the part that was flown."""

    nmae: np.ndarray
    """[%]."""
    smoothness: np.ndarray
    """Sm of eq. 16 [rad Hz]."""
    returns: np.ndarray
    lost: np.ndarray
    """The flight ended before its time."""
    mae: np.ndarray
    """(P, E, 3) mean absolute error of theta, phi, beta [rad]."""
    unsafe: np.ndarray
    """Samples beyond the bounds of eq. 14."""
    saturated: np.ndarray
    """Part of the samples with a command at its bound, 0 to 1."""
    length: np.ndarray
    """Samples flown."""

    def ranking(self) -> np.ndarray:
        """Return each actor's mean nMAE [%], infinite where it lost a flight; shape (P,)."""
        return np.where(self.lost.any(axis=1), np.inf, self.nmae.mean(axis=1))


def attitude_nmae(scores: Scores) -> np.ndarray:
    """Return the nMAE of theta and phi alone (P, E) [%], by the ranges of the published experiments."""
    mae = scores.mae[..., [REFERENCE.theta, REFERENCE.phi]]
    return 100.0 * mae.mean(axis=-1) / ATTITUDE_RANGE


def evaluation_references(fleet: Fleet, seed: int, count: int, duration: float = DURATION) -> np.ndarray:
    """Return ``count`` references (count, T + 1, 3) [rad] of the evaluation family from one seed."""
    return draw_references(np.random.default_rng(seed), count, duration, fleet.theta_trim, "evaluation")


def score(network: Network, flights: Flights) -> Scores:
    """Return the scores of flights that were flown."""
    errors = flights.observation[1:, ..., :N_REFERENCE]
    shape = flights.length.shape
    error, saturated = np.empty(shape), np.empty(shape)
    mae = np.empty((*shape, N_REFERENCE))
    for i, n in np.ndenumerate(flights.length):
        flown = (slice(n), *i)
        e = errors[flown].astype(float)
        error[i], mae[i] = nmae(e), np.abs(e).mean(axis=0)
        saturated[i] = (np.abs(flights.u[flown]) >= SATURATED).any(axis=1).mean()
    return Scores(
        nmae=error,
        smoothness=flights.smoothness(np.array(network.action_scale)),
        returns=flights.returns(),
        lost=flights.lost,
        mae=mae,
        unsafe=(flights.unsafe & flights.flown()).sum(axis=0),
        saturated=saturated,
        length=flights.length,
    )


def evaluate(fleet: Fleet, network: Network, parameters: np.ndarray, references: np.ndarray) -> Scores:
    """Fly actors (P, K) on references (E, T + 1, 3) [rad] and score them."""
    return score(network, fleet.fly(network, parameters, references))
