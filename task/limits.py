"""Limits of the commands a policy may give (thesis section III.A)."""

from __future__ import annotations

import numpy as np

DT = 0.01
"""Sample time of the task [s]: 100 Hz."""

DEFLECTION_LIMIT = float(np.deg2rad(10.0))
"""Largest absolute deflection that a policy may command on any surface [rad]."""

ACTION_LOW = np.full(3, -DEFLECTION_LIMIT)
"""Lower bound of the action [rad], shape (3,)."""
ACTION_HIGH = np.full(3, DEFLECTION_LIMIT)
"""Upper bound of the action [rad], shape (3,)."""
