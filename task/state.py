"""The one table of what each index of the state, action and observation vectors means.

Frames: ``b`` body axes (x forward, y right, z down), ``n`` local north-east-down, ``a`` air path.
V, alpha and beta are inertial: wind is not in them (thesis eq. 9 and the recordings of the aircraft).
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class Signal(NamedTuple):
    """One row of a table: symbol, SI unit, frame and meaning."""

    symbol: str
    unit: str
    frame: str
    meaning: str


class STATE(IntEnum):
    """Indices of the aircraft state x (thesis eq. 9, in the order of the recordings)."""

    p = 0
    q = 1
    r = 2
    V = 3
    alpha = 4
    beta = 5
    phi = 6
    theta = 7
    psi = 8
    h = 9
    xe = 10
    ye = 11


class ACTION(IntEnum):
    """Indices of the action a (thesis eq. 10): absolute surface deflections, zero is not trim."""

    de = 0
    da = 1
    dr = 2


class REFERENCE(IntEnum):
    """Indices of the reference and of the tracking error e (thesis eq. 12)."""

    theta = 0
    phi = 1
    beta = 2


class OBSERVATION(IntEnum):
    """Indices of the agent's observation s (thesis eq. 11)."""

    theta_e = 0
    phi_e = 1
    beta_e = 2
    p = 3
    q = 4
    r = 5
    alpha = 6


N_STATE = len(STATE)
"""Length of the plant's state vector."""
N_IDENTIFIED = 10
"""The first ten states: those the online model identifies (thesis section 8.2)."""
N_ACTION = len(ACTION)
N_REFERENCE = len(REFERENCE)
N_OBSERVATION = len(OBSERVATION)

STATE_TABLE: tuple[Signal, ...] = (
    Signal("p", "rad/s", "b", "roll rate"),
    Signal("q", "rad/s", "b", "pitch rate"),
    Signal("r", "rad/s", "b", "yaw rate"),
    Signal("V", "m/s", "a", "inertial speed; equals true airspeed in still air"),
    Signal("alpha", "rad", "a", "angle of attack"),
    Signal("beta", "rad", "a", "sideslip, positive with the relative wind from the right"),
    Signal("phi", "rad", "n", "roll angle"),
    Signal("theta", "rad", "n", "pitch angle"),
    Signal("psi", "rad", "n", "heading"),
    Signal("h", "m", "n", "altitude above sea level"),
    Signal("xe", "m", "n", "distance north of the start"),
    Signal("ye", "m", "n", "distance east of the start"),
)

ACTION_TABLE: tuple[Signal, ...] = (
    Signal("de", "rad", "b", "elevator, positive trailing edge down: nose down"),
    Signal("da", "rad", "b", "aileron, positive rolls left"),
    Signal("dr", "rad", "b", "rudder, positive trailing edge left: nose left"),
)

TRACKED = (STATE.theta, STATE.phi, STATE.beta)
"""The states that follow a reference, in the order of REFERENCE."""
