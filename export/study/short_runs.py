"""Which short runs the study makes, and what they share."""

from __future__ import annotations

from typing import Any

from export.study.short import varied
from export.training.config import TrainingConfig

FRAMES = 250_000
"""Stored frames of a short SERL(10) run; the thesis's has 1.02 million."""
UPDATES_PER_FRAME = 0.01
"""Critic updates per frame: evolution nearly alone. The thesis has 1."""
TD3_FRAMES = 80_000
"""Frames of a short TD3 run, at the updates per frame of ``td3``."""
SEEDS = (1, 2)
OPERATORS = ("gaussian", "proximal", "safe")
NO_CAPS: dict[str, Any] = {"lambda_s": 0.0, "lambda_t": 0.0}


def operator(mutation: str, seed: int) -> TrainingConfig:
    """Return SERL(10) with one of the mutation operators."""
    return _serl10(f"serl10-{mutation}", seed, genetic={"mutation": mutation})


def smooth_fitness(seed: int) -> TrainingConfig:
    """Return SERL(10) whose fitness includes Sm (eq. 16)."""
    return _serl10("serl10-smooth", seed, genetic={"smooth_fitness": True})


def without_caps(seed: int) -> TrainingConfig:
    """Return SERL(10) whose TD3 actor is not regularised (eq. 15)."""
    return _serl10("serl10-nocaps", seed, td3=NO_CAPS)


def td3(caps: bool, seed: int) -> TrainingConfig:
    """Return TD3 alone, with or without CAPS (eq. 15)."""
    return varied("td3", "td3-caps" if caps else "td3-nocaps", TD3_FRAMES, seed, td3={} if caps else NO_CAPS)


def _serl10(name: str, seed: int, **changes: dict[str, Any]) -> TrainingConfig:
    learner = {"updates_per_frame": UPDATES_PER_FRAME} | changes.pop("td3", {})
    return varied("serl10", name, FRAMES, seed, td3=learner, **changes)
