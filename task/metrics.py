"""How well and how smoothly a flight was flown (thesis section III.E and eq. 16)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from task.limits import DT
from task.state import REFERENCE

Ranges = Literal["experiments", "text"]

_DEGREE = np.pi / 180.0
ATTITUDE_RANGE = 20.0 * _DEGREE
"""What errors in theta and phi are divided by in the published experiments [rad]."""
C_SM = 8000.0
"""C_Sm of eq. 16 with S_aa = |A|^2 dt; see :func:`smoothness`."""


def channel_nmae(error: np.ndarray, ranges: Ranges = "experiments") -> np.ndarray:
    """Return the normalised mean absolute error of theta, phi, beta, shape (3,), as fractions.

    error: (T, 3) tracking errors [rad]. ``experiments``, the default and the definition behind the
    thesis's numbers, divides by 20 deg, 20 deg and max(|mean beta error|, 1 deg): a constant sideslip
    is divided by itself, hence the floor of 1/3 for a jammed rudder. ``text`` divides by the
    half-ranges printed in section III.E: 25 deg, 25 deg, 1 deg.
    """
    mae = np.abs(error).mean(axis=0)
    if ranges == "experiments":
        beta = max(abs(float(error[:, REFERENCE.beta].mean())), _DEGREE)
        scale = np.array([ATTITUDE_RANGE, ATTITUDE_RANGE, beta])
    else:
        scale = np.array([25.0, 25.0, 1.0]) * _DEGREE
    return mae / scale


def nmae(error: np.ndarray, ranges: Ranges = "experiments") -> float:
    """Return the mean over channels of :func:`channel_nmae`, in percent. error: (T, 3) [rad]."""
    return 100.0 * float(channel_nmae(error, ranges).mean())


def smoothness(actions: np.ndarray, dt: float = DT) -> float:
    """Return Sm of eq. 16 [rad Hz] for deflections (T, m) [rad]; higher (less negative) is smoother.

    Sm = -C_Sm/T sqrt(2/n sum_a sum_{k=1}^{n/2} S_aa[k] f_k) with S_aa[k] = |A[k]|^2 dt and C_Sm = 8000 s.
    Eq. 16 prints |A[k]|^2 / n and C_Sm = 10, which is some 7000 times smaller at T = 80 s than the figures
    of the thesis (SERL(50) about -5, TD3 about -1500); this is the scale of its published runs.
    """
    n = actions.shape[0]
    if n < 2:
        return 0.0
    spectrum = np.abs(np.fft.rfft(actions, axis=0)[1:]) ** 2 * dt
    frequency = np.fft.rfftfreq(n, dt)[1:]
    weighted = float((spectrum * frequency[:, None]).sum())
    return -C_SM / (n * dt) * float(np.sqrt(2.0 / n * weighted))
