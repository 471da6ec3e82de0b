"""Which laws there are, and their settings as tuned for the Citation (``bench/tune_laws.py``)."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

from runtime.laws.effectiveness import Effectiveness, EstimateSettings
from runtime.laws.indi import INDI, INDIGains
from runtime.laws.law import Airframe, Law
from runtime.laws.own import load_own
from runtime.laws.pid import PID, PIDGains
from runtime.laws.solo import Solo
from task.config import Settings, load_json, read_bytes
from task.errors import UserError
from task.law_names import LAWS, LawName, own_digest, own_law, why_no_law
from task.limits import DT
from task.reward import UNSAFE_ALPHA

BANK_ERROR_LIMIT = math.radians(30.0)
"""A bank error beyond which the protected law rolls by sideslip when its aileron is at its end [rad]."""

SETTINGS = Path(__file__).parent / "citation.json"

__all__ = ["LAWS", "SETTINGS", "LawName", "LawSettings", "load_settings", "load_solo", "make_law"]


class LawSettings(Settings, frozen=True, kw_only=True):
    """Everything that decides the laws."""

    airframe: Airframe
    """What all of them know of the healthy aircraft."""
    pid: PIDGains
    """Gains of the three PID loops."""
    indi: INDIGains
    """Gains of INDI, with and without the estimate."""
    estimate: EstimateSettings
    """How the effectiveness is followed."""


def load_settings(path: Path = SETTINGS) -> LawSettings:
    """Read the settings. Raises UserError for a file that is missing or malformed."""
    return load_json(path, LawSettings, "settings of the laws")


def make_law(name: str, settings: LawSettings, dt: float = DT, member: bool = False) -> Law:
    """Return a law at the start of a flight, a shipped one or one's own (``task.law_names``).

    dt: sample time of the loop [s]; member: whether it is to be one of a cast. Raises UserError.
    """
    if own := own_law(name):
        return load_own(name, own, settings.airframe, dt, member)
    if wrong := why_no_law(name):
        raise UserError(f"law: {wrong}")
    if name == "pid":
        return PID(settings.airframe, settings.pid, dt)
    estimate, protected = None, name == "indi-rls-protected"
    if name != "indi":
        estimate = Effectiveness(settings.airframe, settings.estimate, sign_free=name != "indi-rls")
    limits = (UNSAFE_ALPHA, BANK_ERROR_LIMIT) if protected else (math.inf, math.inf)
    return INDI(settings.airframe, settings.indi, estimate, name, dt, *limits)


def load_solo(name: str, dt: float = DT, path: Path = SETTINGS) -> Solo:
    """Return a law that flies alone, with the settings of ``path``. Raises UserError."""
    law = make_law(name, load_settings(path), dt)
    files = read_bytes(path, "settings of the laws") + own_digest(name).encode()
    return Solo(law, hashlib.sha256(files).hexdigest())
