"""Writes the JSBSim model of the aircraft from its coefficients: readable XML with named functions."""

from __future__ import annotations

from pathlib import Path
from string import Template

from sim_bridge.aircraft.coefficients import Coefficients, Term
from sim_bridge.aircraft.variables import VARIABLES

MODEL_NAME = "citation"
ROOT = Path(__file__).parent / "model"
"""JSBSim's root folder: the aircraft and the planet live below it."""
TEMPLATE = Path(__file__).parent / "citation.template.xml"
"""Everything about the model that is not a number from the identification."""
PLANET = ROOT / "flat_earth.xml"
REST = ROOT / "rest.xml"
"""Initial conditions at rest."""
BALLAST = 0.9
"""Share of the mass that is movable, to shift the centre of gravity."""
THRUST_PREFIX = "thrust"
"""Terms whose name begins so are the engines' and scale with the engines' health."""


def _indent(text: str, depth: int) -> str:
    pad = "  " * depth
    return "\n".join(pad + line for line in text.splitlines())


def _number(value: float) -> str:
    return f"{value:.10g}"


def table(term: Term) -> str:
    """Return a term's table as JSBSim writes one; ten digits."""
    names = [VARIABLES[axis.variable].property for axis in term.axes]
    lines = ["<table>", f'  <independentVar lookup="row">{names[0]}</independentVar>']
    columns = term.axes[1].breakpoints if len(term.axes) == 2 else [0.0]
    if len(term.axes) == 2:
        lines.append(f'  <independentVar lookup="column">{names[1]}</independentVar>')
    lines.append("  <tableData>")
    if len(term.axes) == 2:
        lines.append(" " * 18 + "".join(f" {_number(c):>16}" for c in columns))
    for i, row in enumerate(term.axes[0].breakpoints):
        values = term.values[i * len(columns) : (i + 1) * len(columns)]
        lines.append(f"    {_number(row):>14}" + "".join(f" {_number(v):>16}" for v in values))
    return "\n".join([*lines, "  </tableData>", "</table>"])


def _product(name: str, body: str) -> str:
    return f"<product>\n  <property>{VARIABLES[name].property}</property>\n{_indent(body, 1)}\n</product>"


def total(terms: list[Term]) -> str:
    """Return the sum of terms, each under its name; zero for none.

    Terms that share a factor are summed before they are multiplied by it, and so on inside: JSBSim then reads half
    as many properties in a frame.
    """
    return _nested([(term, term.factors) for term in terms])


def _nested(terms: list[tuple[Term, list[str]]]) -> str:
    """Return the sum of terms times what is left of their factors."""
    parts, groups = [], dict[str, list[tuple[Term, list[str]]]]()
    for term, factors in terms:
        if factors:
            groups.setdefault(factors[0], []).append((term, factors[1:]))
        else:
            value = table(term) if term.axes else f"<value>{_number(term.values[0])}</value>"
            parts.append(f"<!-- {term.name} -->\n{value}")
    parts += [_product(name, _nested(group)) for name, group in groups.items()]
    if len(parts) == 1:
        return parts[0]
    return "<sum>\n" + _indent("\n".join(parts), 1) + "\n</sum>" if parts else "<value>0</value>"


def _function(name: str, body: str, comment: str) -> str:
    return f'<!-- {comment} -->\n<function name="{name}">\n{_indent(body, 1)}\n</function>'


def _used(terms: list[Term]) -> set[str]:
    return {name for term in terms for name in [*term.factors, *(axis.variable for axis in term.axes)]}


def _quantities(coefficients: Coefficients) -> str:
    """Return the functions that compute the variables which JSBSim lacks."""
    used = set().union(*(_used(terms) for terms in coefficients.aerodynamics.values()))
    return "\n".join(
        _function(variable.property, variable.function, f"{variable.meaning} [{variable.unit}]")
        for name, variable in VARIABLES.items()
        if name in used and variable.function and not variable.in_flight_control
    )


def _coefficient_functions(coefficients: Coefficients) -> str:
    """Return, for each axis, the airframe's and (where there is one) the engines' coefficient."""
    parts = []
    for axis, terms in coefficients.aerodynamics.items():
        engine = [term for term in terms if term.name.startswith(THRUST_PREFIX)]
        airframe = [term for term in terms if term not in engine]
        parts.append(_function(f"aero/airframe/{axis}", total(airframe), f"{axis} of the airframe [-]"))
        if engine:
            parts.append(_function(f"aero/engines/{axis}", total(engine), f"{axis} of two healthy engines [-]"))
    return "\n".join(parts)


def citation_xml(coefficients: Coefficients) -> str:
    """Return the aircraft's JSBSim file."""
    body, engine = coefficients.body, coefficients.engine
    fields: dict[str, str] = {
        "name": MODEL_NAME,
        "wing_area": _number(body.wing_area),
        "span": _number(body.span),
        "chord": _number(body.chord),
        "ixx": _number(body.ixx),
        "iyy": _number(body.iyy),
        "izz": _number(body.izz),
        "ixz": _number(body.ixz),
        "fixed_mass": _number(body.mass * (1.0 - BALLAST)),
        "ballast_mass": _number(body.mass * BALLAST),
        "elevator_min": _number(coefficients.limits.elevator_min),
        "elevator_max": _number(coefficients.limits.elevator_max),
        "yaw_damper_gain": _number(coefficients.yaw_damper.gain),
        "yaw_damper_rate": _number(1.0 / coefficients.yaw_damper.washout),
        "quantities": _indent(_quantities(coefficients), 2),
        "coefficients": _indent(_coefficient_functions(coefficients), 2),
        "ice_slope": _number(coefficients.icing.lift_slope),
        "ice_slope_knee": _number(coefficients.icing.lift_slope_knee),
        "ice_knee": _number(coefficients.icing.knee),
        "ice_pitching": _number(coefficients.icing.pitching_moment),
        "set_speed_offset": _indent(VARIABLES["set_speed_offset"].function, 5),
        "altitude_offset": _indent(VARIABLES["altitude_offset"].function, 5),
        "mach_offset": _indent(VARIABLES["mach_offset"].function, 5),
    }
    for name, spool in (("n1", engine.n1), ("n2", engine.n2)):
        fields[f"{name}_gain"] = _number(spool.gain)
        fields[f"{name}_command"] = _indent(total(spool.command), 5)
        fields[f"{name}_rate_down"] = _indent(total(spool.rate_down), 6)
        fields[f"{name}_rate_up"] = _indent(total(spool.rate_up), 7)
    return Template(TEMPLATE.read_text()).substitute(fields)


def build(coefficients: Coefficients, root: Path = ROOT) -> Path:
    """Write the aircraft's JSBSim file below ``root`` and return its path."""
    path = root / "aircraft" / MODEL_NAME / f"{MODEL_NAME}.xml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(citation_xml(coefficients))
    return path
