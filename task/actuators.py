"""What the actuators make of the commands: each surface moves within a range, and only so fast.

    acting' = clip(clip(command, low, high), acting - rate DT, acting + rate DT)

A jammed surface has low = high; a healthy one the range of ``task.limits`` and no limit of its rate. Range and rate
belong to the command that asks for a surface, ahead of whatever effectiveness then mixes the surfaces.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from task.limits import ACTION_HIGH, ACTION_LOW, DT
from task.state import N_ACTION


class ACTUATOR(IntEnum):
    """Rows of ``actuators`` (3, 3), whose columns are ``task.state.ACTION``; low <= high, rate >= 0."""

    low = 0
    """Least deflection [rad]."""
    high = 1
    """Greatest deflection [rad]."""
    rate = 2
    """Largest rate of deflection [rad/s]; infinite without a limit."""


N_ACTUATOR = len(ACTUATOR)

HEALTHY = np.stack([ACTION_LOW, ACTION_HIGH, np.full(N_ACTION, np.inf)])
"""Actuators (3, 3) that follow every command within ``task.limits`` at once; read-only."""
HEALTHY.setflags(write=False)


def limited(command: np.ndarray, before: np.ndarray, actuators: np.ndarray, dt: float = DT) -> np.ndarray:
    """Return what acts (..., 3) [rad] when ``command`` (..., 3) [rad] is asked for after ``before`` (..., 3) [rad].

    actuators: (3, 3), rows :class:`ACTUATOR`, or (3, ..., 3) for several; dt: time since ``before`` acted [s]. Where
    ``before`` lies beyond the range, the surface returns to it at its rate.
    """
    reach = actuators[ACTUATOR.rate] * dt
    within = command.clip(actuators[ACTUATOR.low], actuators[ACTUATOR.high])
    return within.clip(before - reach, before + reach)
