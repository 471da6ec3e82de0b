"""How effective each surface still is, found in flight by recursive least squares."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from runtime.identification import RecursiveLeastSquares
from runtime.laws.law import Airframe, Positive
from task.config import Settings
from task.state import N_ACTION

MOTIONS = 5
"""p, q, r, alpha, beta: the states whose increments change the moments."""


class EstimateSettings(Settings, frozen=True, kw_only=True):
    """How the effectiveness is followed."""

    p0: Positive
    """Scale of the identity that P starts from [1/unit^2]; the increments are of the order of 1e-4."""
    kappa: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
    """Forgetting factor of eqs 8.5-8.6, each sample; it rests while trace(P) is above where it began."""
    least: Positive
    """Least magnitude of a surface's effectiveness over nominal that the law believes [-]: it divides by it."""
    most: Positive
    """Largest magnitude that it believes [-]."""


class Effectiveness:
    """Each surface's effectiveness over nominal, lambda (3,), from filtered increments.

    d(omega_dot)[k] = F d(p, q, r, alpha, beta)[k-1] + (qbar/qbar0) G du, estimated as a whole; lambda_j is the
    estimate of surface j's main entry of G over its nominal value, held away from zero.
    """

    def __init__(self, airframe: Airframe, settings: EstimateSettings, sign_free: bool) -> None:
        nominal = np.array(airframe.effectiveness)
        theta0 = np.zeros((MOTIONS + N_ACTION, N_ACTION))
        theta0[MOTIONS:] = nominal.T
        p0 = settings.p0 * np.eye(MOTIONS + N_ACTION)
        self._rls = RecursiveLeastSquares(theta0, p0, settings.kappa, float(np.trace(p0)))
        self._settings, self._sign_free = settings, sign_free
        self._axes = [int(np.argmax(np.abs(nominal[:, j]))) for j in range(N_ACTION)]
        self._nominal = [float(nominal[axis, j]) for j, axis in enumerate(self._axes)]
        self._z = np.zeros(MOTIONS + N_ACTION)
        self._motions, self._commands = self._z[:MOTIONS], self._z[MOTIONS:]
        self.reset()

    def reset(self) -> None:
        """Start a new flight: a healthy aircraft."""
        self._rls.reset()
        self.multipliers = [1.0] * N_ACTION
        """lambda (3,) of elevator, aileron, rudder [-], within the bounds of the settings."""

    def update(self, motion: np.ndarray, command: np.ndarray, pressure_ratio: float, acceleration: np.ndarray) -> None:
        """Learn from one sample: increments of the motion (5,), command (3,) [rad] and acceleration (3,) [rad/s2]."""
        np.copyto(self._motions, motion)
        np.multiply(command, pressure_ratio, out=self._commands)
        self._rls.update(self._z, acceleration)
        least, most = self._settings.least, self._settings.most
        for j, (axis, nominal) in enumerate(zip(self._axes, self._nominal, strict=True)):
            found = float(self._rls.Theta[MOTIONS + j, axis]) / nominal
            sign = -1.0 if self._sign_free and found < 0.0 else 1.0
            self.multipliers[j] = sign * min(max(sign * found, least), most)
