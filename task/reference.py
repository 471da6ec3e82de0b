"""Cosine-smoothed reference signals for theta, phi and beta (thesis sections III.A and III.E)."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from task.limits import DT
from task.state import N_REFERENCE, REFERENCE

_DEGREE = np.pi / 180.0


class Family(NamedTuple):
    """How random references of one kind are drawn; ``levels`` None draws them uniformly."""

    theta: float
    """Largest pitch step about trim [rad]."""
    phi: float
    """Largest roll angle [rad]."""
    blocks: int
    """The duration T is cut in this many blocks, each with its own level."""
    smoothing: float
    """Width of the cosine between two levels, as a fraction of T."""
    levels: int | None
    """Number of evenly spaced values that the levels are drawn from."""


FAMILIES: dict[str, Family] = {
    "evaluation": Family(12 * _DEGREE, 10 * _DEGREE, 5, 1 / 10, 6),
    "training": Family(25 * _DEGREE, 45 * _DEGREE, 5, 1 / 6, None),
    "aggressive": Family(15 * _DEGREE, 40 * _DEGREE, 10, 1 / 20, None),
}
"""``evaluation`` and ``training`` are the thesis's; ``aggressive`` banks four times as far, twice as often."""

FamilyName = Literal["evaluation", "training", "aggressive"]

BASE_THETA = np.array([0.0, 12.0, 3.0, -4.0, -8.0, 2.0]) * _DEGREE
BASE_PHI = np.array([2.0, -2.0, 2.0, 10.0, 2.0, -6.0]) * _DEGREE
"""Levels of the fixed base case [rad]."""


def n_samples(duration: float, dt: float = DT) -> int:
    """Return how many samples a flight of ``duration`` [s] has."""
    return round(duration / dt)


def cosine_steps(levels: np.ndarray, duration: float, smoothing: float, dt: float = DT) -> np.ndarray:
    """Return a sequence of cosine-smoothed steps, shape (duration/dt,).

    levels: (K,) values; step i begins at i * duration/(K-1) and takes ``smoothing`` seconds. The signal
    starts from zero, so that the flight begins at trim. The last of the K levels begins as the
    signal ends, as in the thesis's base case of six levels at T/5 spacing.
    """
    t = np.arange(n_samples(duration, dt)) * dt
    spacing = duration / max(len(levels) - 1, 1)
    signal = np.zeros_like(t)
    before = 0.0
    for i, level in enumerate(levels):
        progress = np.clip((t - i * spacing) / smoothing, 0.0, 1.0)
        signal += (level - before) * 0.5 * (1.0 - np.cos(np.pi * progress))
        before = float(level)
    return signal


def _assemble(theta: np.ndarray, phi: np.ndarray, theta_trim: float) -> np.ndarray:
    reference = np.zeros((theta.shape[0], N_REFERENCE))
    reference[:, REFERENCE.theta] = theta + theta_trim
    reference[:, REFERENCE.phi] = phi
    return reference


def base_reference(duration: float, theta_trim: float, dt: float = DT) -> np.ndarray:
    """Return the thesis's fixed base case, shape (T, 3) [rad]; theta_trim [rad] is added to theta."""
    smoothing = duration * FAMILIES["evaluation"].smoothing
    return _assemble(
        cosine_steps(BASE_THETA, duration, smoothing, dt), cosine_steps(BASE_PHI, duration, smoothing, dt), theta_trim
    )


def random_reference(
    rng: np.random.Generator, duration: float, theta_trim: float, family: FamilyName = "evaluation", dt: float = DT
) -> np.ndarray:
    """Draw one reference of a family, shape (T, 3) [rad]: theta (about theta_trim), phi, beta = 0."""
    kind = FAMILIES[family]

    def draw(amplitude: float) -> np.ndarray:
        count = kind.blocks + 1
        if kind.levels is None:
            levels = rng.uniform(-amplitude, amplitude, count)
        else:
            levels = rng.choice(np.linspace(-amplitude, amplitude, kind.levels), count)
            levels[0] = 0.0  # the published evaluation references begin with a block at trim
        return cosine_steps(levels, duration, duration * kind.smoothing, dt)

    theta = draw(kind.theta)
    phi = draw(kind.phi)
    return _assemble(theta, phi, theta_trim)
