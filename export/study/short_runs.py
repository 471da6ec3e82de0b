"""Which short runs the study makes, and what they share."""

from __future__ import annotations

from export.study.short import varied
from export.training.config import TrainingConfig

OPERATORS = ("gaussian", "proximal", "safe")


def operator(mutation: str, seed: int) -> TrainingConfig:
    """Return SERL(10) with one of the mutation operators."""
    return varied("serl10", f"serl10-{mutation}", seed, genetic={"mutation": mutation})


def smooth_fitness(seed: int) -> TrainingConfig:
    """Return SERL(10) whose fitness includes Sm (eq. 16)."""
    return varied("serl10", "serl10-smooth", seed, genetic={"smooth_fitness": True})


def without_caps(seed: int) -> TrainingConfig:
    """Return SERL(10) whose TD3 actor is not regularised (eq. 15)."""
    return varied("serl10", "serl10-nocaps", seed, td3={"lambda_s": 0.0, "lambda_t": 0.0})


def td3(caps: bool, seed: int) -> TrainingConfig:
    """Return TD3 alone, with or without CAPS (eq. 15)."""
    weights = {} if caps else {"lambda_s": 0.0, "lambda_t": 0.0}
    return varied("td3", "td3-caps" if caps else "td3-nocaps", seed, td3=weights)
