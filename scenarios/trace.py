"""What a flight leaves behind, as arrays: the aircraft's truth and the runtime's decisions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class FlightTrace:
    """The true flight at 100 Hz; T samples may be fewer than planned when the aircraft was lost."""

    time: np.ndarray
    """(T,) simulated time [s]."""
    x: np.ndarray
    """(T, 12) true state in the order of ``task.state.STATE``."""
    reference: np.ndarray
    """(T, 3) theta, phi, beta [rad]."""
    command: np.ndarray
    """(T, 3) commanded deflections [rad]."""
    surfaces: np.ndarray
    """(T, 3) true deflections [rad]."""
    planned_samples: int
    """How many samples the flight was to have."""
    fault_at: float | None = None
    """When the first fault begins [s]; None without one."""


class Play(NamedTuple):
    """One imagined comparison of the cast: what each member would earn."""

    time: float
    """When the answer was applied [s]."""
    returns: np.ndarray
    """(P + 1,) predicted returns, the incumbent last."""


class Switch(NamedTuple):
    """A change of the cast."""

    time: float
    """[s]"""
    member: int
    """Index of the member that takes over."""


@dataclass(frozen=True)
class AdaptationTrace:
    """What the runtime thought and decided."""

    time: np.ndarray
    """(T,) simulated time of each cycle [s]."""
    active: np.ndarray
    """(T,) index of the member that flies, or that a soft switch moves towards."""
    innovation: np.ndarray
    """(T, S) one-step prediction error of the identified increments, in SI units per sample."""
    members: list[str]
    """(P,) names of the cast."""
    innovation_names: list[str] = field(default_factory=list)
    """(S,) which state each innovation belongs to."""
    plays: list[Play] = field(default_factory=list)
    switches: list[Switch] = field(default_factory=list)
