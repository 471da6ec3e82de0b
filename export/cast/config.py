"""Configuration of a breeding run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from export.cast.cases import EASY, Case
from export.mirrors import ODD
from export.network import Layer
from task.config import Settings, load_toml
from task.errors import UserError
from task.state import N_ACTION, N_OBSERVATION

Count = Annotated[int, Meta(ge=1)]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Range = tuple[float, float]
"""Least and largest."""

CONFIGS = Path(__file__).parent


def _check_ranges(settings: Settings, least: dict[str, float]) -> None:
    """Raise ValueError unless every range named in ``least`` is in order and does not begin below what it says."""
    for name, bound in least.items():
        low, high = getattr(settings, name)
        if not bound <= low <= high:
            raise ValueError(f"{name}: expected two numbers in order, from {bound:g} on, got [{low:g}, {high:g}]")


class SearchSettings(Settings, frozen=True):
    """CMA-ES for one case (thesis section 8.5 names it in the place of the genetic algorithm)."""

    population: Annotated[int, Meta(ge=4)] = 13
    """Policies of one iteration; 4 + 3 ln(24) by the usual rule."""
    sigma: Positive = 0.3
    """First standard deviation of each parameter, in units of its start's magnitude plus ``floor``."""
    floor: Positive = 1.0
    """What a parameter that starts at zero is given for its magnitude."""
    symmetric: bool = False
    """Search only among policies of one layer that treat left and right alike, as the healthy aircraft does."""
    iterations: Count = 40
    """Of one round."""
    rounds: Count = 1
    """Rounds follow each other, each from the mean of the one before with fresh covariance; a round is what resumes."""
    references: Count = 2
    """Trials of one iteration, common to its policies, drawn anew for the next."""
    tuning: Count = 6
    """Trials on which the round's start and its mean are compared; the better one stays."""


class TrialSettings(Settings, frozen=True):
    """The flights that breeding uses, and what they cost."""

    duration: Annotated[float, Meta(ge=0.1, le=600.0)] = 14.0
    """Length [s]."""
    period: Annotated[float, Meta(ge=0.1, le=3600.0)] = 24.0
    """Length of the evaluation reference whose beginning is flown [s]: its steps come every fifth of it."""
    onset: Range = (2.0, 6.0)
    """Earliest and latest onset of a hard case's faults [s]; the main member flies until they are answered."""
    decision: NonNegative = 0.5
    """From the onset until the member under test takes over [s]."""
    lost: Positive = 100.0
    """Cost of a flight that is lost at its end, and twice that at its start [% nMAE]."""
    smooth: float = -4.0
    """Sm that costs nothing [rad Hz] (eq. 16)."""
    smooth_weight: NonNegative = 0.01
    """Cost of each rad Hz below ``smooth`` [% nMAE]."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        _check_ranges(self, {"onset": 0.0})
        if self.onset[1] >= self.duration:
            raise ValueError(f"onset: expected it before the end at {self.duration:g} s, got {self.onset[1]:g}")


class RobustSettings(Settings, frozen=True):
    """What the single robust policy is bred over: every trial draws its own aircraft."""

    altitude: Range = (1000.0, 6000.0)
    """Of the trim [m]."""
    speed: Range = (85.0, 150.0)
    """Of the trim [m/s]."""
    latency: Range = (0.0, 0.05)
    """[s]"""
    effectiveness: Range = (0.3, 1.5)
    """Of each surface, uniform in its logarithm [-]."""
    trims: Count = 12
    """Trims that the trials choose from: finding one costs more than a flight's first second."""
    noisy: bool = True
    """Every other trial has the noise of R3's sensors."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        _check_ranges(self, {"altitude": 0.0, "speed": 1.0, "latency": 0.0, "effectiveness": 0.01})


class CastSettings(Settings, frozen=True):
    """One breeding run."""

    name: str
    seed: Annotated[int, Meta(ge=0)] = 0
    layers: tuple[Layer, ...] = (Layer(units=3, activation="tanh"),)
    """Shape of every member."""
    input_scale: tuple[float, ...] = (1.0,) * N_OBSERVATION
    """Inside the network (docs/architecture.md)."""
    main: SearchSettings = SearchSettings()
    """Search of the main member, from random parameters."""
    specialist: SearchSettings = SearchSettings()
    """Search of each case's specialist."""
    robust: SearchSettings = SearchSettings()
    """Search of the single robust policy."""
    randomised: RobustSettings = RobustSettings()
    trial: TrialSettings = TrialSettings()
    gains: tuple[float, ...] = (3.0, 1.0, 0.4, 0.15)
    """Levels about trim at which the main member and its mirrors stand as possible starts of a specialist."""
    tuning: Count = 3
    """Trials of each case on which all candidates are compared."""
    within: Annotated[float, Meta(ge=1.0)] = 1.3
    """A case is covered by a member whose cost on the tuning trials is at most so many times the specialist's."""
    least_gain: Positive = 0.005
    """A member beyond those must lower the mean logarithm of the best cost over all cases by so much."""
    members: Annotated[int, Meta(ge=8, le=50)] = 50
    """Most members of the cast."""
    bred_for: tuple[str, ...] = ("F4", "F5", "R1", "R2")
    """Cases of the thesis that get a specialist too; they begin with the flight."""
    cases: tuple[Case, ...] = ()
    """The hard cases."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        names = [case.name for case in (*EASY, *self.cases)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"cases: expected unique names, got {', '.join(twice)} twice")
        unknown = sorted(set(self.bred_for) - {case.name for case in EASY})
        if unknown:
            raise ValueError(f"bred_for: expected cases of the thesis, got {', '.join(unknown)}")
        last = self.layers[-1] if self.layers else None
        if last is None or last.units != N_ACTION or last.layer_norm != "none" or last.activation not in ODD:
            raise ValueError(
                f"layers: expected a last layer of {N_ACTION} units, {' or '.join(ODD)}, without layer_norm, of which "
                f"mirrors and levels can be made, got {last}"
            )
        if len(self.layers) > 1 and any(s.symmetric for s in (self.main, self.specialist, self.robust)):
            raise ValueError(f"symmetric: expected a network of one layer, got {len(self.layers)}; leave it out")
        if len(self.input_scale) != N_OBSERVATION or not all(map(math.isfinite, self.input_scale)):
            raise ValueError(f"input_scale: expected {N_OBSERVATION} finite numbers, got {self.input_scale}")


def config_path(name_or_path: str) -> Path:
    """Return where a configuration is, by the name of one that ships (``citation``) or by path; raise UserError."""
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return path
    path = CONFIGS / f"{name_or_path}.toml"
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in CONFIGS.glob("*.toml")))
        raise UserError(f"no cast '{name_or_path}'; expected one of {known}, or a path to a .toml")
    return path


def load(name_or_path: str) -> CastSettings:
    """Return a configuration by name or path; raise UserError."""
    return load_toml(config_path(name_or_path), CastSettings, "cast configuration")
