"""A PID whose surfaces are mirrored by the estimator of the surfaces' effectiveness: the decision without a cast."""

from __future__ import annotations

from typing import Literal

import numpy as np

from runtime.laws.catalogue import load_settings
from runtime.laws.law import Law
from runtime.laws.pid import PID
from runtime.laws.solo import COMMAND_LAG, Solo
from runtime.presets import PRESETS
from runtime.structured import Effectiveness
from task.errors import UserError
from task.rates import RateModel
from task.state import N_ACTION

MIRRORED: Literal["pid-mirrored"] = "pid-mirrored"
SURE = 1.0
"""A surface is taken for reversed when its effectiveness is below zero by so many standard deviations [-]."""
BELOW = -0.05
"""... and by this much more [-]."""
AGREE = 3
"""Samples in a row that must say so."""


class MirroredPID(Law):
    """PID whose command on surface j has its sign turned while s_j lambda_j + SURE sd_j < BELOW says that it is wrong.

    s_j is the sign that is flown now, lambda_j and sd_j the estimate of ``runtime.structured``.
    """

    name = MIRRORED

    def __init__(self, rates: RateModel) -> None:
        settings = load_settings()
        super().__init__(settings.airframe)
        self._pid = PID(settings.airframe, settings.pid)
        self._estimate = Effectiveness(PRESETS["structured"], rates, COMMAND_LAG)
        self._signs = np.ones(N_ACTION)
        self._wrong = np.zeros(N_ACTION, dtype=int)

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft."""
        super().reset()
        self._pid.reset()
        self._estimate.reset()
        self._signs[:] = 1.0
        self._wrong[:] = 0

    def restart_history(self) -> None:
        """Forget the last samples."""
        super().restart_history()
        self._pid.restart_history()
        self._estimate.restart_history()

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad]."""
        estimate = self._estimate
        estimate.observe(x)
        wrong = self._signs * estimate.effectiveness + SURE * estimate.sd < BELOW
        self._wrong = np.where(wrong, self._wrong + 1, 0)
        self._signs[self._wrong >= AGREE] *= -1.0
        self._wrong[self._wrong >= AGREE] = 0
        np.multiply(self._pid.steer(x, reference), self._signs, out=self._action)
        return self._action

    def sent(self, command: np.ndarray) -> None:
        """Tell the estimate what was sent."""
        self._estimate.command(command)


def load_mirrored(rates: RateModel | None) -> Solo:
    """Return the law as one that flies alone, with the rate model of a population. Raises UserError without one."""
    if rates is None:
        raise UserError(f"{MIRRORED}: the population brings no rate model; export it again, or leave this row out")
    return Solo(MirroredPID(rates), "")
