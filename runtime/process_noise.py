"""How far each filter's state may move within a sample: what Q of the Kalman filters is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from runtime.config import Adaptation
from runtime.rate_filter import LAMBDA, MOTION, B, N, W
from runtime.uncommanded import UNIT
from task.rates import KNEE
from task.state import N_ACTION

LOW_KNEE = math.radians(-3.0)
"""Angle of attack below which the model errs too. Soon after an alarm what surfaces do errs more."""


class ProcessNoise:
    """Quiet or open: rates and lambda have a fixed drift each; the bias takes what the air and the model's error do.

    The filters are those of :class:`runtime.structured.Effectiveness`: the hypotheses, ending with those in which a
    surface moves by itself and those that look for a range, then an agile one for each surface.
    """

    UNKNOWN = 0.25
    """Drift of the bias where the model lacks an angle, each sample (variance) [rad2/s4]."""

    def __init__(self, settings: Adaptation, moving: int, limited: int, agile: int, dt: float) -> None:
        """Take the first row of surfaces that move by themselves, of those with a range, and of the agile ones."""
        self._settings, self._dt = settings, dt
        self._moving, self._limited, self._agile = moving, limited, agile
        self._motion = (settings.q_uncommanded / UNIT) ** 2
        self._quiet = self._drifts(settings.q_rate, settings.q_effectiveness)
        self._open = self._drifts(settings.q_rate_open, settings.q_effectiveness_open)
        self._least_bias = np.square(settings.q_bias).tolist()
        self.opened = False
        """Whether the filters are open."""
        self.restart()

    def restart(self) -> None:
        """Begin after a gap: the model's last prediction is no neighbour."""
        self._predicted: list[float] = []

    def _drifts(self, rate: float, effectiveness: float) -> np.ndarray:
        q = np.zeros((self._agile + N_ACTION, N))
        q[:, W], q[:, LAMBDA] = rate**2, effectiveness**2
        # A range changes at once or not at all, and nothing else with it or with a surface that moves.
        q[self._limited : self._agile, LAMBDA] = self._settings.q_effectiveness**2
        np.fill_diagonal(q[self._moving : self._limited, LAMBDA], 0.0)
        q[self._moving : self._limited, MOTION] = self._motion
        agile = q[self._agile :, LAMBDA]
        np.fill_diagonal(agile, max(effectiveness, self._settings.q_effectiveness_agile) ** 2)
        return q

    def fill(
        self,
        q: np.ndarray,
        levels: list[float],
        predicted: list[float],
        alpha: float,
        calm: bool,
        lacking: Sequence[bool],
        uncommanded: int | None,
    ) -> None:
        """Set the variances (M, 11) that the next prediction adds.

        levels: of turbulence on p, q, r; predicted: what the healthy model moves them by in this sample [rad/s]; alpha:
        angle of attack [rad]; calm: whether no alarm was lately; lacking: whether angle of attack and sideslip stand
        still; uncommanded: the surface that is believed to move by itself, or None.
        """
        settings = self._settings
        q[:] = self._open if self.opened else self._quiet
        share = (settings.model_error_open if self.opened else settings.model_error) / self._dt
        low = LOW_KNEE - alpha if calm else 0.0
        near_stall = (1.0 + settings.stall_error * max(alpha - KNEE, low, 0.0)) ** 2
        q[:, B] = [
            least * level * near_stall + (share * (new - old)) ** 2
            for least, level, new, old in zip(
                self._least_bias, levels, predicted, self._predicted or predicted, strict=True
            )
        ]
        self._predicted = predicted
        if uncommanded is not None:
            q[self._agile :, LAMBDA.start + uncommanded], q[self._agile :, MOTION] = 0.0, self._motion
        no_alpha, no_beta = lacking
        if no_alpha or no_beta:
            q[:, B] += self.UNKNOWN * np.array((no_beta, no_alpha, no_beta))
