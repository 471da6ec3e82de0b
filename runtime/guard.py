"""The last gate: what may be believed of a state, and what may be sent to the aircraft."""

from __future__ import annotations

import math

import numpy as np

from runtime.config import Operation
from task.limits import DEFLECTION_LIMIT
from task.state import N_ACTION, N_STATE, STATE


class Health:
    """Flags of what is wrong in a cycle; 0 is well. The log holds the bits.

    Plain integers: an operation on an IntFlag costs a microsecond, and each cycle has a dozen.
    """

    OK = 0
    STATE_NOT_FINITE = 1
    STATE_IMPLAUSIBLE = 2
    STATE_MISSING = 4
    ACTION_NOT_FINITE = 8
    ACTION_LIMITED = 16
    HOLDING = 32
    """The last good command is held, or fades to trim."""
    GAP = 64
    """Samples are missing before this one."""
    DEFECT = 128
    """The runtime itself failed at this sample: what was learnt is forgotten."""
    STATE_JUMPS = 256
    """The state cannot follow the last one, :class:`runtime.continuity.Continuity`."""
    COASTING = 512
    """What is answered is what the model foretells, since no state can be used."""


UNUSABLE = Health.STATE_NOT_FINITE | Health.STATE_IMPLAUSIBLE
"""With one of these no policy is shown the state."""
DOUBTFUL = UNUSABLE | Health.STATE_JUMPS
"""With one of these the model's word counts more than the state, where there is a model."""

MEANING = {
    Health.STATE_NOT_FINITE: "the state is not finite",
    Health.STATE_IMPLAUSIBLE: "the state is beyond what any aircraft does",
    Health.STATE_JUMPS: "the state jumps by what no rate turns it, or stands still",
    Health.STATE_MISSING: "no state came",
    Health.ACTION_NOT_FINITE: "the policy's command is not finite",
    Health.ACTION_LIMITED: "the policy's command was beyond the limits",
    Health.COASTING: "flying on what the model foretells",
    Health.HOLDING: "holding the last good command, then trim",
    Health.GAP: "samples are missing",
    Health.DEFECT: "the runtime failed, and learns anew",
}
"""Flag: in words."""

NAMES = {flag: name.lower() for name, flag in vars(Health).items() if name.isupper() and flag}
"""Flag: its name in the summary."""

PLAUSIBLE = np.full(N_STATE, np.finfo(float).max)
"""Largest absolute value of each state that is believed, in SI units: rates 20 rad/s, 1000 m/s, angles within a turn,
altitude 50 km. Far outside any flight: it catches units and garbage, not manoeuvres.
Heading and position have no bound: a heading may count the turns that were flown."""
PLAUSIBLE[[STATE.p, STATE.q, STATE.r]] = 20.0
PLAUSIBLE[STATE.V] = 1000.0
PLAUSIBLE[[STATE.alpha, STATE.beta, STATE.phi, STATE.theta]] = 2.0 * np.pi
PLAUSIBLE[STATE.h] = 5e4


def plausible(x: np.ndarray) -> bool:
    """Return whether the first states (N,) are what any aircraft may be in, and finite."""
    return bool((np.abs(x) <= PLAUSIBLE[: len(x)]).all())


class Guard:
    """Passes good commands and replaces bad ones: first the last good command, then a fade to trim.

    Trim is the running mean of the good commands; zero deflection until there is one. Nothing here raises.
    """

    TOLERANCE = 1e-6
    """A command beyond its limit by less than this [rad] is rounding of float32, limited without a flag."""

    def __init__(self, settings: Operation) -> None:
        self._settings = settings
        self._share = settings.dt / max(settings.trim_time, settings.dt)
        self._held = np.zeros(N_ACTION)
        self._out = np.zeros(N_ACTION)
        self._magnitude = np.zeros(N_STATE)
        self._inside = np.zeros(N_STATE, dtype=bool)
        self.reset()

    def reset(self) -> None:
        """Start a new flight: nothing is held."""
        self._good = 0
        self._without = 0
        self._held[:] = 0.0
        self._trim = [0.0] * N_ACTION

    @property
    def has_command(self) -> bool:
        """Whether there was a good command in this flight."""
        return self._good > 0

    def check_state(self, x: np.ndarray) -> int:
        """Return what is wrong with a state (12,); OK when it may be used."""
        np.abs(x, out=self._magnitude)
        np.less_equal(self._magnitude, PLAUSIBLE, out=self._inside)
        if self._inside.all():
            return Health.OK
        return Health.STATE_IMPLAUSIBLE if np.isfinite(x).all() else Health.STATE_NOT_FINITE

    def command(self, action: np.ndarray) -> tuple[np.ndarray, int]:
        """Return the command (3,) [rad] to send for the policy's ``action``, finite and in limits, and what was wrong.

        The array is reused at the next call.
        """
        asked = action.tolist()
        if not all(map(math.isfinite, asked)):
            out, health = self.fallback()
            return out, health | Health.ACTION_NOT_FINITE
        sent = [min(max(a, -DEFLECTION_LIMIT), DEFLECTION_LIMIT) for a in asked]
        self._good += 1
        self._without = 0
        self._held[:] = self._out[:] = sent
        share = max(self._share, 1.0 / self._good)
        self._trim = [trim + share * (a - trim) for trim, a in zip(self._trim, sent, strict=True)]
        beyond = any(abs(a - b) > self.TOLERANCE for a, b in zip(asked, sent, strict=True))
        return self._out, Health.ACTION_LIMITED if beyond else Health.OK

    def fallback(self) -> tuple[np.ndarray, int]:
        """Return the command (3,) [rad] for one more sample without a good one; the array is reused."""
        self._without += 1
        beyond_hold = self._without * self._settings.dt - self._settings.hold_time
        fade = min(max(beyond_hold / max(self._settings.fade_time, self._settings.dt), 0.0), 1.0)
        np.copyto(self._out, self._held)
        self._out += fade * (self._trim - self._held)
        return self._out, Health.HOLDING


def describe(health: int) -> str:
    """Return the flags in words, most telling first."""
    return "; ".join(text for flag, text in MEANING.items() if flag & health) or "well"
