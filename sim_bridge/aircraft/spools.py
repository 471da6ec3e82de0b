"""Identification of the engines' two spools: each follows the auto-throttle's command within rate limits.

    dN/dt = max(down, min(up, gain * (command - N)))

``command``, ``up`` and ``down`` are sums of tables. Which of the three acts is not recorded: starting from a
coarse guess, samples are sorted by the branch that acts, each branch is fitted by least squares to its samples,
and so on until the sorting stands still.
"""

from __future__ import annotations

import numpy as np

from sim_bridge.aircraft.coefficients import Axis, Spool, Term, evaluate, regressors
from sim_bridge.aircraft.recordings import Recording, standard_atmosphere
from sim_bridge.aircraft.variables import ALTITUDE_REFERENCE, MACH_REFERENCE
from task.state import STATE

SPAN = 10
"""Half the span over which a speed is differentiated [samples]: the recordings are coarsely rounded."""
STRIDE = 5
"""Every how many samples one is used."""
ROUNDS = 40
"""Most rounds of sorting and fitting."""
OUTLIER = 1.5
"""Residuals larger than this are left out of the next round [%/s]: the derivative spans a switch there."""
RIDGE = 1e-3
"""Weight of the guess against a sample."""

SPEED_ERROR = [-2.2, -1.95, -1.75, -1.5, -1.25, -1.0, -0.85, -0.7, -0.6, -0.5, -0.4]
"""Breakpoints of the auto-throttle [m/s]: full thrust to idle."""
SPEED_ERROR_COARSE = [-2.2, -1.75, -1.25, -0.85, -0.6, -0.4]
SPEED_ERROR_MACH = [-2.0, -1.2, -0.5]
CORE_UP = [48.0, 54.0, 60.0, 66.0, 70.0, 78.0, 86.0, 92.0]
"""Core speeds at which the acceleration limit bends [%]."""
CORE_DOWN = [50.0, 60.0, 70.0, 80.0, 92.0]
"""Core speeds at which the deceleration limit bends [%]."""
CORE_DOWN_COARSE = [50.0, 60.0, 92.0]


def _term(name: str, variable: str, breakpoints: list[float], guess: list[float] | None, *factors: str) -> Term:
    return Term(
        name=name,
        axes=[Axis(variable=variable, breakpoints=breakpoints)],
        values=guess or [0.0] * len(breakpoints),
        factors=list(factors),
    )


def _command(guess: list[float], mach: bool) -> list[Term]:
    terms = [
        _term("throttle", "speed_error", SPEED_ERROR, guess),
        _term("throttle_set_speed", "speed_error", SPEED_ERROR_COARSE, None, "set_speed_offset"),
        _term("throttle_altitude", "speed_error", SPEED_ERROR_COARSE, None, "altitude_offset"),
    ]
    return [*terms, _term("throttle_mach", "speed_error", SPEED_ERROR_MACH, None, "mach_offset")] if mach else terms


def n2_guess() -> Spool:
    """Return the structure and a coarse guess of the core's dynamics."""
    return Spool(
        gain=1.4,
        command=_command([92, 91, 88, 83, 76, 68, 63, 56, 51, 50, 50], mach=False),
        rate_up=[_term("accelerating", "n2", CORE_UP, [4, 5, 6, 7, 8, 8.5, 9, 9.5])],
        rate_down=[_term("decelerating", "n2", CORE_DOWN, [0, -2, -7, -13, -19])],
    )


def n1_guess() -> Spool:
    """Return the structure and a coarse guess of the fan's dynamics."""
    return Spool(
        gain=1.6,
        command=_command([97, 96, 92, 80, 70, 56, 50, 44, 41, 40, 40], mach=True),
        rate_up=[_term("accelerating", "n2", CORE_UP, [4, 6, 9, 11, 12, 12.5, 13, 13.5])],
        rate_down=[
            _term("decelerating", "n2", CORE_DOWN, [0, -1, -10, -19, -30]),
            _term("decelerating_set_speed", "n2", CORE_DOWN_COARSE, None, "set_speed_offset"),
            _term("decelerating_altitude", "n2", CORE_DOWN_COARSE, None, "altitude_offset"),
        ],
    )


def samples(recording: Recording, set_speed: float) -> dict[str, np.ndarray]:
    """Return the spools' variables, speeds ``n1`` and ``n2`` [%] and their rates [%/s], each (N,)."""
    x = recording.x
    middle = slice(SPAN, len(x) - SPAN, STRIDE)
    mach = x[:, STATE.V] / standard_atmosphere(x[:, STATE.h]).speed_of_sound

    def rate(speed: np.ndarray) -> np.ndarray:
        return ((speed[2 * SPAN :] - speed[: -2 * SPAN]) / (2 * SPAN * recording.dt))[::STRIDE]

    return {
        "n1": recording.n1[middle],
        "n2": recording.n2[middle],
        "n1_rate": rate(recording.n1),
        "n2_rate": rate(recording.n2),
        "speed_error": x[middle, STATE.V] - set_speed,
        "mach_offset": mach[middle] - MACH_REFERENCE,
        "altitude_offset": (x[middle, STATE.h] - ALTITUDE_REFERENCE) / 1e4,
        "set_speed_offset": np.full(len(x[middle]), (set_speed - 90.0) / 60.0),
    }


def rate(spool: Spool, speed: np.ndarray, data: dict[str, np.ndarray]) -> np.ndarray:
    """Return dN/dt [%/s] of a spool at speeds (N,) [%]."""
    wanted = spool.gain * (evaluate(spool.command, data) - speed)
    return np.maximum(evaluate(spool.rate_down, data), np.minimum(evaluate(spool.rate_up, data), wanted))


def _towards(present: np.ndarray, columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the least-squares solution of columns @ values = y, held to ``present`` by a weak ridge."""
    if not len(y):
        return present
    scale = (columns**2).mean(axis=0) + 1e-6
    hessian = columns.T @ columns + RIDGE * len(y) * np.diag(scale)
    return present + np.linalg.solve(hessian, columns.T @ (y - columns @ present))


def _with_values(terms: list[Term], values: np.ndarray) -> list[Term]:
    ends = np.cumsum([len(term.values) for term in terms])[:-1]
    return [
        Term(name=term.name, axes=term.axes, factors=term.factors, values=part.tolist())
        for term, part in zip(terms, np.split(values, ends), strict=True)
    ]


def identify_spool(guess: Spool, speed: np.ndarray, y: np.ndarray, data: dict[str, np.ndarray]) -> Spool:
    """Return the spool fitted to rates y (N,) [%/s] at speeds (N,) [%]."""
    branches = (guess.command, guess.rate_up, guess.rate_down)
    columns = [np.concatenate([regressors(term, data) for term in terms], axis=1) for terms in branches]
    command, up, down = (np.concatenate([term.values for term in terms]) for terms in branches)
    gain = guess.gain
    before = np.full(len(y), -1)
    kept = np.ones(len(y), dtype=bool)
    for _ in range(ROUNDS):
        wanted = gain * (columns[0] @ command - speed)
        limited = np.minimum(columns[1] @ up, wanted)
        lowest = columns[2] @ down
        branch = np.where(limited < lowest, 2, np.where(limited < wanted, 1, 0))
        if (branch == before).all():
            break
        if before[0] >= 0:
            kept = np.abs(np.maximum(lowest, limited) - y) < OUTLIER
        before = branch
        asking, rising, falling = (kept & (branch == b) for b in range(3))
        with_speed = np.concatenate([columns[0][asking], -speed[asking, None]], axis=1)
        scaled = _towards(np.append(gain * command, gain), with_speed, y[asking])
        gain, command = float(scaled[-1]), scaled[:-1] / scaled[-1]
        up = _towards(up, columns[1][rising], y[rising])
        down = _towards(down, columns[2][falling], y[falling])
    return Spool(
        gain=gain,
        command=_with_values(guess.command, command),
        rate_up=_with_values(guess.rate_up, up),
        rate_down=_with_values(guess.rate_down, down),
    )
