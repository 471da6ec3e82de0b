"""Where the aircraft will be when the command that is sent now begins to act.

Late commands are a delay between a decision and its effect. What acts meanwhile was sent before, and is known; so the
state at the end of the delay can be foretold, and who answers that state flies an aircraft whose commands are in time
(the predictor of O. J. M. Smith, 1957, for a state that is measured). What the model lacks and what the air does in the
meantime is seen a delay later, as without it.
"""

from __future__ import annotations

import numpy as np

from task.model import predict_increment


def foretell(
    x: np.ndarray,
    dx: np.ndarray,
    commands: np.ndarray,
    delay: int,
    command_lag: int,
    model: np.ndarray,
    exact_kinematics: bool,
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the state (10,) ``delay`` samples ahead, and its last increment (10,).

    x (10,), dx (10,): state and last increment; commands (>= command_lag + 1 + delay, 3): the last ones sent, oldest
    first [rad]; each moves the aircraft ``command_lag`` + 1 + ``delay`` samples after the state that it answers; model
    (13, 10) and exact_kinematics as in :mod:`task.model`; dt: [s].
    """
    x, dx, model = x.astype(float), dx.astype(float), model.astype(float)
    waiting = np.diff(commands[-command_lag - 1 - delay :].astype(float), axis=0)
    for da in waiting[:delay]:
        dx = predict_increment(x, dx, da, model, exact_kinematics, dt)
        x = x + dx
    return x, dx
