"""Flying on what the model says while no state can be used: dead reckoning with the commands that were sent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from runtime.foretelling import foretell
from runtime.guard import plausible


class Coasting(NamedTuple):
    """Where the aircraft is believed to be, some samples after its last usable state.

    x (10,), dx (10,): state and last increment; model (13, 10) and exact_kinematics: as in :mod:`task.model`; delay:
    of the commands, beyond the ``command_lag`` [samples]; samples: so many since the last usable state.
    """

    x: np.ndarray
    dx: np.ndarray
    model: np.ndarray
    exact_kinematics: bool
    delay: int
    samples: int = 0

    def step(self, commands: np.ndarray, command_lag: int, dt: float) -> Coasting | None:
        """Go on by a sample; None where the model has left what any aircraft does.

        commands (>= command_lag + 2 + delay, 3): the last ones sent, oldest first [rad]; dt: [s].
        """
        x, dx = self._ahead(commands, 1, command_lag + self.delay, dt)
        if not (plausible(x) and np.isfinite(dx).all()):
            return None
        return self._replace(x=x, dx=dx, samples=self.samples + 1)

    def answered(self, commands: np.ndarray, ahead: int, command_lag: int, dt: float) -> np.ndarray:
        """Return the state (10,) ``ahead`` samples from here, when an answer acts; commands and the rest as above."""
        return self._ahead(commands, ahead, command_lag, dt)[0] if ahead else self.x

    def _ahead(self, commands: np.ndarray, ahead: int, lag: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
        return foretell(self.x, self.dx, commands, ahead, lag, self.model, self.exact_kinematics, dt)
