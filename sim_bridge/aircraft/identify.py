"""Identification of the aircraft from recordings: staged, linear wherever it can be, and repeatable.

1. Aerodynamics and thrust: the recorded motion gives the force and moment coefficients that must have acted
   (:mod:`targets`); each is fitted by penalised least squares (:mod:`regression`) to sums of tables
   (:mod:`structure`).
2. Engine speeds: each spool's rate is fitted to what the auto-throttle asks for and its limits (:mod:`spools`).
3. Ice: what the clean aircraft leaves over of the iced recordings (:mod:`icing`).
4. Taken over as constants: mass, inertia and geometry, which the reference states; the yaw damper and the elevator's
   stops, which were measured on it.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sim_bridge.aircraft import spools
from sim_bridge.aircraft.coefficients import AXES, Body, Coefficients, Engine, Limits, Term, YawDamper, evaluate
from sim_bridge.aircraft.icing import identify_icing
from sim_bridge.aircraft.recordings import ELEVATOR_LIMITS, FOLDER, Recording, load_case
from sim_bridge.aircraft.regression import NormalEquations, Unknown, solve
from sim_bridge.aircraft.targets import force_samples, moment_samples
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition

TRIMS: dict[str, FlightCondition] = {"h2000_v90": NOMINAL, "h2000_v150": R1, "h10000_v90": R2}
"""Healthy recordings: the folder's name and the condition that the flights start from."""

BODY = Body(mass=4500.0, wing_area=30.0, span=15.9, chord=2.09, ixx=11187.8, iyy=22854.8, izz=31974.8, ixz=1930.1)
"""As the reference model states them."""
YAW_DAMPER = YawDamper(gain=1.0, washout=4.0)
"""Measured on the reference with its rudder jammed."""
PENALTY = 1e-4
"""Weight of the tables' curvature, chosen by flying manoeuvres that were left out."""


class Evidence(NamedTuple):
    """What one recording contributes to the identification."""

    recording: Recording
    aerodynamics: dict[str, NormalEquations]
    """By axis."""
    spools: dict[str, np.ndarray]
    """Samples of the engine speeds."""


def gather(recording: Recording, unknowns: dict[str, list[Unknown]]) -> Evidence:
    """Return the evidence of one healthy recording."""
    equations = {}
    for samples in (force_samples, moment_samples):
        data, targets = samples(recording, BODY, YAW_DAMPER)
        for axis, y in targets.items():
            equations[axis] = NormalEquations.of(unknowns[axis], data, y)
    return Evidence(recording, equations, spools.samples(recording, TRIMS[recording.case].speed))


def aerodynamics(
    evidence: list[Evidence], unknowns: dict[str, list[Unknown]], penalty: float = PENALTY
) -> dict[str, list[Term]]:
    """Return the fitted terms of each axis."""
    result = {}
    for axis in AXES:
        total = evidence[0].aerodynamics[axis]
        for item in evidence[1:]:
            total = total + item.aerodynamics[axis]
        result[axis] = solve(unknowns[axis], total, penalty)
    return result


def engine(evidence: list[Evidence]) -> Engine:
    """Return the fitted spools."""
    data = {key: np.concatenate([item.spools[key] for item in evidence]) for key in evidence[0].spools}
    return Engine(
        n1=spools.identify_spool(spools.n1_guess(), data["n1"], data["n1_rate"], data),
        n2=spools.identify_spool(spools.n2_guess(), data["n2"], data["n2_rate"], data),
    )


def identify(evidence: list[Evidence], unknowns: dict[str, list[Unknown]], iced: list[Recording]) -> Coefficients:
    """Return the aircraft that the evidence, and iced recordings for the ice alone, determine."""
    clean = aerodynamics(evidence, unknowns)
    return Coefficients(
        provenance=f"Identified from {len(evidence)} recordings of the reference model "
        "by sim_bridge.aircraft.identify; do not edit.",
        body=BODY,
        aerodynamics=clean,
        engine=engine(evidence),
        yaw_damper=YAW_DAMPER,
        limits=Limits(elevator_min=ELEVATOR_LIMITS[0], elevator_max=ELEVATOR_LIMITS[1]),
        icing=identify_icing(iced, clean, BODY, YAW_DAMPER),
    )


def gather_all(unknowns: dict[str, list[Unknown]], folder: Path = FOLDER) -> list[Evidence]:
    """Return the evidence of every healthy recording below ``folder``."""
    return [gather(recording, unknowns) for case in TRIMS for recording in load_case(case, folder)]


def unexplained(evidence: list[Evidence], found: Coefficients) -> dict[str, float]:
    """Return, by axis, the share of the coefficient's variance that the fit leaves unexplained [%]."""
    left: dict[str, list[np.ndarray]] = {axis: [] for axis in AXES}
    whole: dict[str, list[np.ndarray]] = {axis: [] for axis in AXES}
    for item in evidence:
        for samples in (force_samples, moment_samples):
            data, targets = samples(item.recording, BODY, YAW_DAMPER)
            for axis, y in targets.items():
                left[axis].append(y - evaluate(found.aerodynamics[axis], data))
                whole[axis].append(y)
    return {axis: 100.0 * float(np.concatenate(left[axis]).var() / np.concatenate(whole[axis]).var()) for axis in AXES}
