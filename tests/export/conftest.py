"""What tests of the exported graphs share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from export.prior import Prior
from task.actuators import ACTUATOR, HEALTHY
from task.limits import DT
from task.model import embed_reduced
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


@pytest.fixture(scope="module")
def nominal_model(short_prior: Prior) -> np.ndarray:
    """Return Theta of the healthy aircraft, (13, 10), kinematics exact."""
    return embed_reduced(short_prior.theta)


@pytest.fixture(scope="module")
def full_model(nominal_model: np.ndarray) -> np.ndarray:
    """Return a model of all ten states whose attitude follows the rates, as least squares would find it."""
    model = nominal_model.copy()
    model[:3, 6:9] = DT * np.eye(3)
    model[6:9, 6:9] = 0.02 * np.eye(3)
    model[3:5, 9] = 0.01, -0.3
    return model
