"""The identified aircraft as data: sums of tables and products, read from ``coefficients.json``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from task.config import Settings, load_json

COEFFICIENTS = Path(__file__).parent / "coefficients.json"
"""The committed coefficients, as :mod:`sim_bridge.aircraft.identify` writes them."""

AXES = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
"""Force and moment coefficients in body axes."""


class Axis(Settings, frozen=True):
    """One independent variable of a table."""

    variable: str
    """Name in :data:`sim_bridge.aircraft.variables.VARIABLES`."""
    breakpoints: list[float]
    """Increasing values of it, in its unit; the table is held constant outside."""


class Term(Settings, frozen=True):
    """One named contribution: a constant, or a table in one or two variables, times a product of variables."""

    name: str
    """Name of the contribution; becomes the name of a JSBSim function."""
    values: list[float]
    """One number, or the table row by row."""
    axes: list[Axis] = []
    """None, one or two independent variables; linear between breakpoints."""
    factors: list[str] = []
    """Variables that multiply it."""


class Body(Settings, frozen=True):
    """Mass and reference geometry (stated by the reference model)."""

    mass: float
    """[kg]"""
    wing_area: float
    """[m2]"""
    span: float
    """[m]"""
    chord: float
    """[m]"""
    ixx: float
    """[kg m2]"""
    iyy: float
    """[kg m2]"""
    izz: float
    """[kg m2]"""
    ixz: float
    """Product of inertia, positive as in sum(m x z) [kg m2]."""


class Spool(Settings, frozen=True):
    """One shaft of the engines: dN/dt = max(down, min(up, gain * (command - N)))."""

    command: list[Term]
    """Speed that the auto-throttle asks for [%]."""
    gain: float
    """Rate of the speed per difference to the commanded one [1/s]."""
    rate_up: list[Term]
    """Fastest acceleration [%/s]."""
    rate_down: list[Term]
    """Fastest deceleration, negative [%/s]."""


class Engine(Settings, frozen=True):
    """The reference's hidden auto-throttle and its engines' speeds."""

    n1: Spool
    """Fan."""
    n2: Spool
    """Core."""


class YawDamper(Settings, frozen=True):
    """The reference's hidden yaw damper: rudder += gain * r * tau s / (tau s + 1)."""

    gain: float
    """[rad per rad/s]"""
    washout: float
    """Time constant tau [s]."""


class Icing(Settings, frozen=True):
    """How ice changes the reference; a fault sets how much drag it adds and where lift begins to be lost."""

    drag: float
    """Drag coefficient that the recorded ice added [-]; for comparison, the fault sets its own."""
    lift_slope: float
    """Lift lost per radian above the largest clean angle of attack [1/rad]."""
    lift_slope_knee: float
    """Further lift lost per radian above the knee [1/rad]."""
    knee: float
    """Angle of attack where the clean lift curve steepens [rad]."""
    pitching_moment: float
    """Change of Cm per unit of lift coefficient lost [-]."""


class Limits(Settings, frozen=True):
    """Stops of the control surfaces [rad]."""

    elevator_min: float
    elevator_max: float


class Coefficients(Settings, frozen=True):
    """The whole aircraft."""

    provenance: str
    """Where the numbers come from, in words."""
    body: Body
    aerodynamics: dict[str, list[Term]]
    """Terms of CX, CY, CZ, Cl, Cm and Cn; thrust is a part of CX, CZ and Cm."""
    engine: Engine
    yaw_damper: YawDamper
    limits: Limits
    icing: Icing


def load(path: Path = COEFFICIENTS) -> Coefficients:
    """Read coefficients; raise UserError when the file is missing or malformed."""
    return load_json(path, Coefficients, "coefficients file")


def hat_basis(values: np.ndarray, breakpoints: list[float]) -> np.ndarray:
    """Return the weights of linear interpolation, shape (N, K), clamped at the ends."""
    knots = np.asarray(breakpoints)
    inside = np.clip(values, knots[0], knots[-1])
    left = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
    fraction = (inside - knots[left]) / (knots[left + 1] - knots[left])
    basis = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    basis[rows, left] = 1.0 - fraction
    basis[rows, left + 1] = fraction
    return basis


def regressors(term: Term, data: dict[str, np.ndarray]) -> np.ndarray:
    """Return the columns that multiply ``term.values``, shape (N, len(values)), from variables of shape (N,)."""
    scale = np.ones_like(next(iter(data.values())))
    for factor in term.factors:
        scale = scale * data[factor]
    columns = np.ones((len(scale), 1))
    for axis in term.axes:
        basis = hat_basis(data[axis.variable], axis.breakpoints)
        columns = (columns[:, :, None] * basis[:, None, :]).reshape(len(scale), -1)
    return columns * scale[:, None]


def evaluate(terms: list[Term], data: dict[str, np.ndarray]) -> np.ndarray:
    """Return the sum of ``terms`` for variables of shape (N,)."""
    return np.sum([regressors(term, data) @ np.asarray(term.values) for term in terms], axis=0)
