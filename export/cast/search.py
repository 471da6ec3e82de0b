"""CMA-ES over the parameters of one policy, on trials drawn anew for each iteration and common to its policies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cma  # type: ignore[import-untyped]
import numpy as np

from export.cast.config import SearchSettings, TrialSettings
from export.cast.flights import Stage, Trial
from export.cast.trials import costs
from export.network import Network

Draw = Callable[[np.random.Generator, int], list[Trial]]
"""Returns so many trials from a stream of chance."""


class Found(NamedTuple):
    """What one round of a search came to."""

    parameters: np.ndarray
    """(K,) float64."""
    start_cost: float
    """Of the round's start on the tuning trials [% nMAE]."""
    cost: float
    """Of what was found on the same trials [% nMAE]."""


class Judge:
    """One network, one opening policy, one stage: what do policies cost on trials?"""

    def __init__(self, stage: Stage, network: Network, settings: TrialSettings) -> None:
        """``opening`` flies every trial until its handover, once it is set."""
        self.stage, self.network, self.settings = stage, network, settings
        self.opening: np.ndarray | None = None

    def __call__(self, parameters: np.ndarray, trials: list[Trial]) -> np.ndarray:
        """Return the cost of each flight [% nMAE], shape (P, E), for parameters (P, K)."""
        flown = self.stage.fly(self.network, parameters, trials, self.opening)
        return costs(flown, trials, self.settings)


def search(
    judge: Judge,
    draw: Draw,
    start: np.ndarray,
    free: np.ndarray,
    settings: SearchSettings,
    seed: np.random.SeedSequence,
    report: Callable[[float], None] = lambda best: None,
) -> Found:
    """Run one round from ``start`` (K,); return its mean, or its start where that does better on the tuning trials.

    free: (K,) bool, the parameters that are searched; the others stay as they are.
    """
    chance, tuning, strategy = seed.spawn(3)
    rng = np.random.default_rng(chance)
    options: dict[str, Any] = {
        "popsize": settings.population,
        "seed": int(strategy.generate_state(1)[0]) >> 1,
        "verbose": -9,
    }
    options["CMA_stds"] = np.abs(start[free]) + settings.floor
    evolution = cma.CMAEvolutionStrategy(start[free], settings.sigma, options)
    policies = np.tile(start, (settings.population, 1))
    for _ in range(settings.iterations):
        asked = evolution.ask()
        policies[:, free] = asked
        cost = judge(policies, draw(rng, settings.references)).mean(axis=1)
        evolution.tell(asked, cost.tolist())
        report(float(cost.min()))
    mean = start.copy()
    mean[free] = evolution.mean
    trials = draw(np.random.default_rng(tuning), settings.tuning)
    before, after = judge(np.stack([start, mean]), trials).mean(axis=1)
    return Found(mean if after < before else start, float(before), float(min(before, after)))
