"""What ``bench.structured`` flies: faults, conditions, and a cast of linear laws with a member for each fault."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from export.mirrors import AXES, mirror_name
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from sim_bridge.air import Turbulence
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import (
    AnyFault,
    Bandwidth,
    CGShift,
    Crossed,
    Effectiveness,
    Engine,
    Icing,
    Jam,
    Latency,
    SurfaceName,
)
from task.reference import FamilyName
from task.state import ACTION, N_ACTION, N_OBSERVATION, OBSERVATION

GYRO = 6.3e-4
"""Standard deviation of the gyros' noise in the thesis's case R3 [rad/s]."""
FAULT_AT = 5.0
"""When something breaks [s]."""
HELD_OUT = 1000
"""References of this seed and above were never flown while the preset was tuned."""
TRIM_ELEVATOR = -0.02477
"""Of the nominal flight [rad]."""


class Case(NamedTuple):
    """What breaks, and the member that is right then."""

    faults: tuple[AnyFault, ...]
    right: str


def weaker(elevator: float = 1.0, aileron: float = 1.0, rudder: float = 1.0) -> tuple[AnyFault, ...]:
    """Return the faults that multiply the surfaces' effects."""
    factors: dict[SurfaceName, float] = {"elevator": elevator, "aileron": aileron, "rudder": rudder}
    return tuple(Effectiveness(surface=s, factor=f, start=FAULT_AT) for s, f in factors.items() if f != 1.0)


def late(seconds: float) -> tuple[AnyFault, ...]:
    """Return the fault that delays every command."""
    return (Latency(seconds=seconds, start=FAULT_AT),)


def sluggish(hz: float) -> tuple[AnyFault, ...]:
    """Return the faults that make every actuator a first-order lag."""
    return tuple(Bandwidth(surface=s, hz=hz, start=FAULT_AT) for s in ("elevator", "aileron", "rudder"))


CASES: dict[str, Case] = {
    "none": Case((), "good"),
    "elevator -1": Case(weaker(elevator=-1.0), "good/-e"),
    "aileron -1": Case(weaker(aileron=-1.0), "good/-a"),
    "elevator and aileron -1": Case(weaker(-1.0, -1.0), "good/-ea"),
    "elevator -0.3": Case(weaker(elevator=-0.3), "good/-e"),
    "aileron -0.3": Case(weaker(aileron=-0.3), "good/-a"),
    "rudder -1": Case(weaker(rudder=-1.0), "good/-r"),
    "elevator x0.1": Case(weaker(elevator=0.1), "good"),
    "elevator x2": Case(weaker(elevator=2.0), "good"),
    "crossed aileron and rudder": Case((Crossed(start=FAULT_AT),), "good/x"),
    "late by 50 ms": Case(late(0.05), "slow"),
    "late by 100 ms": Case(late(0.10), "slow"),
    "late by 150 ms": Case(late(0.15), "slow"),
    "elevator -1, late by 100 ms": Case(weaker(elevator=-1.0) + late(0.10), "slow/-e"),
    "actuators at 1 Hz": Case(sluggish(1.0), "slow"),
    "elevator jammed": Case((Jam(surface="elevator", start=FAULT_AT),), "good"),
    "rudder hardover": Case((Jam(surface="rudder", angle_deg=10.0, start=FAULT_AT),), "good"),
    "centre of gravity +0.6 m": Case((CGShift(aft=0.6, start=FAULT_AT),), "good"),
    "centre of gravity +0.9 m": Case((CGShift(aft=0.9, start=FAULT_AT),), "good"),
    "icing": Case((Icing(start=FAULT_AT),), "good"),
    "one engine out": Case((Engine(left=0.0, start=FAULT_AT),), "good"),
}


REVERSALS = [name for name in CASES if " -1" in name or " -0.3" in name]
TURBULENT = ["elevator -1", "aileron -1", "elevator -0.3", "late by 150 ms"]
"""Flown in turbulence too."""


class Condition(NamedTuple):
    """What a flight meets besides its fault."""

    noise: float = 0.0
    turbulence: Turbulence = "none"
    family: FamilyName = "evaluation"
    start: FlightCondition = NOMINAL
    duration: float = 15.0


HEALTHY = {
    "evaluation": Condition(duration=40.0),
    "aggressive": Condition(duration=40.0, family="aggressive"),
    "aggressive, 150 m/s": Condition(duration=40.0, family="aggressive", start=R1),
    "aggressive, 10 000 m": Condition(duration=40.0, family="aggressive", start=R2),
    "light turbulence": Condition(duration=40.0, turbulence="light"),
    "aggressive, light turbulence": Condition(duration=40.0, family="aggressive", turbulence="light"),
    "aggressive, moderate turbulence": Condition(duration=40.0, family="aggressive", turbulence="moderate"),
}
"""Flights in which nothing breaks."""


def laws() -> dict[str, np.ndarray]:
    """Return gains (3, 7) by name: ``good``, ``slow`` for late commands, the mirrors of both, and good's crossed."""
    o, found = OBSERVATION, {}
    for name, gain in (("good", 1.0), ("slow", 0.3)):
        law = np.zeros((N_ACTION, N_OBSERVATION))
        law[ACTION.de, [o.theta_e, o.q]] = -4.0 * gain, 1.5 * gain
        law[ACTION.da, [o.phi_e, o.p]] = -3.0 * gain, 0.6 * gain
        law[ACTION.dr, o.beta_e] = 1.0
        found[name] = law
        for axes in AXES:
            mirrored = law.copy()
            mirrored[list(axes)] *= -1.0
            found[mirror_name(name, axes)] = mirrored
    found["good/x"] = found["good"][[ACTION.de, ACTION.dr, ACTION.da]]
    return found


def trimmed(name: str) -> np.ndarray:
    """Return the command (3,) of a member at no error [rad]."""
    sign = -1.0 if "/-" in name and "e" in name.partition("/-")[2] else 1.0
    return np.array([sign * TRIM_ELEVATOR, 0.0, 0.0])


def linear_cast() -> Population:
    """Return the laws as a population; ``good`` is the champion."""
    network = Network(layers=(Layer(units=N_ACTION, activation="linear"),), action_scale=(1.0,) * N_ACTION)
    known = laws()
    weights, bias = np.stack(list(known.values())), np.stack([trimmed(name) for name in known])
    members = tuple(Member(name=name, scores={}) for name in known)
    description = Description(network=network, members=members, champion="good", training={})
    return Population(description, flatten(network, {"layers.0.weight": weights, "layers.0.bias": bias}))
