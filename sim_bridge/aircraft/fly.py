"""Flies recorded manoeuvres open loop: the model from the recorded state, under the recorded deflections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_bridge.aircraft.coefficients import YawDamper
from sim_bridge.aircraft.recordings import Recording, washout
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import AnyFault
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from task.state import N_STATE, STATE

SIGNALS = (STATE.p, STATE.q, STATE.r, STATE.V, STATE.alpha, STATE.beta, STATE.phi, STATE.theta)
"""Compared with the recording."""
WINDOW = 20.0
"""How long the model flies freely before it is put back on the recording [s]."""


def window_starts(recording: Recording, seconds: float = WINDOW) -> list[int]:
    """Return the samples at which whole windows begin, one after the other."""
    length = round(seconds / recording.dt)
    return list(range(0, len(recording.x) - length - 1, length))


def fly_window(
    plant: Plant,
    recording: Recording,
    start: int,
    condition: FlightCondition,
    damper: YawDamper,
    faults: Sequence[AnyFault] = (),
    seconds: float = WINDOW,
) -> np.ndarray:
    """Return the model's states (N, 12) at samples start + 1 .. start + N of the recording.

    The plant reads a command one sample after JSBSim has propagated, so commands (and faults) are given one sample
    early: the recording's deflection of sample k then acts from sample k, as it did in the reference.
    """
    low = washout(recording.x[: start + 1, STATE.r], damper, recording.dt)[start]
    schedule = FaultSchedule(faults)
    plant.reset(
        condition,
        x=recording.x[start],
        action=recording.u[start],
        n1=float(recording.n1[start]),
        n2=float(recording.n2[start]),
        washout=float(low),
    )
    length = round(seconds / recording.dt)
    flown = np.empty((length, N_STATE))
    for k in range(1, length + 1):
        schedule.apply(plant, (start + k) * recording.dt)
        flown[k - 1] = plant.step(recording.u[start + k])
    return flown


def errors(
    plant: Plant,
    recording: Recording,
    condition: FlightCondition,
    damper: YawDamper,
    faults: Sequence[AnyFault] = (),
) -> list[np.ndarray]:
    """Return model minus recording for each window, arrays (N, 8) in the order of SIGNALS."""
    result = []
    for start in window_starts(recording):
        flown = fly_window(plant, recording, start, condition, damper, faults)
        result.append((flown - recording.x[start + 1 : start + 1 + len(flown)])[:, SIGNALS])
    return result


def deviation(recordings: list[Recording]) -> np.ndarray:
    """Return the standard deviation (8,) of each signal over all samples of all given recordings together."""
    return np.concatenate([recording.x[:, SIGNALS] for recording in recordings]).std(axis=0)


def relative_rmse(windows: list[np.ndarray], scale: np.ndarray) -> np.ndarray:
    """Return the root mean square error (8,) over all windows in percent of ``scale`` (8,)."""
    return 100.0 * np.sqrt((np.concatenate(windows) ** 2).mean(axis=0)) / scale
