"""What tests of the exported graphs share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from task.actuators import ACTUATOR, HEALTHY
from task.state import ACTION


def _tight(rate: float = 0.25) -> np.ndarray:
    actuators = HEALTHY.copy()
    actuators[ACTUATOR.rate, ACTION.de] = rate
    actuators[:, ACTION.da] = -0.012, 0.008, 4.0 * rate
    actuators[:, ACTION.dr] = 0.004, 0.006, np.inf
    return actuators


@pytest.fixture
def tight() -> Callable[..., np.ndarray]:
    """Return what makes a slow elevator, a slow aileron of small range and a rudder that is all but jammed."""
    return _tight
