"""Everything on the aircraft's side of the link: the plant, what breaks in it, and what its sensors say."""

from __future__ import annotations

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.faults import describe
from sim_bridge.flight import Flight
from sim_bridge.injection import Part, read_injection
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors
from task.limits import DT
from task.state import STATE

MOST_INJECTED = 100
"""Faults that a flight takes over the link; each has a column in the record."""


class World:
    """The aircraft of one flight at its current tick; deterministic in the flight and its seed.

    Noise and turbulence have streams of their own, so that one does not change with the other. Raises UserError
    when the aircraft cannot be trimmed to the flight's condition.
    """

    def __init__(self, flight: Flight, plant: Plant | None = None) -> None:
        """Begin a flight; ``plant``: an aircraft that flew before and is this flight's alone from now on."""
        noise, turbulence = np.random.SeedSequence(flight.seed).spawn(2)
        self._plant = plant or Plant()
        self._sensors = Sensors(flight.sensors, np.random.default_rng(noise))
        self._schedule = FaultSchedule(flight.faults)
        self._injected: dict[Part, int] = {}
        self._tick = 0
        seed = int(turbulence.generate_state(1)[0]) >> 1  # JSBSim takes a positive 32-bit integer
        self.x = self._plant.reset(flight.condition, air=flight.air, seed=seed)
        """True state (12,), task.state; the array is reused."""
        self.trim_action = self._plant.trim.action
        """Deflections that hold the start [rad], shape (3,)."""
        self.origin_altitude = round(float(self.x[STATE.h]), 3)
        """Altitude of the start [m], a whole number of millimetres."""
        self._most_faults = len(flight.faults) + MOST_INJECTED
        self._arrive()

    def _arrive(self) -> None:
        """Bring faults and measurement to the current tick."""
        self._schedule.apply(self._plant, self._tick * DT, self._sensors)
        self.measured = self._sensors.measure(self.x)
        """What the sensors say of x, shape (12,)."""

    @property
    def fault_names(self) -> list[str]:
        """What each fault is, in words; those that were injected come last."""
        return [describe(fault) for fault in self._schedule.faults]

    @property
    def fault_levels(self) -> list[float]:
        """How far each fault has grown, 0 to 1."""
        return self._schedule.levels

    @property
    def surfaces(self) -> np.ndarray:
        """True deflections [rad], shape (3,)."""
        return self._plant.surfaces

    @property
    def wind_n(self) -> np.ndarray:
        """Velocity of the air over the ground at the aircraft, north-east-down [m/s], shape (3,)."""
        return self._plant.wind

    def step(self, command: np.ndarray) -> None:
        """Advance by one tick under a command (3,) [rad]."""
        self.x = self._plant.step(command)
        self._tick += 1
        self._arrive()

    def inject(self, message: mavlink.MAVLink_command_long_message) -> int:
        """Break, or mend, what a COMMAND_LONG asks for, from the next tick on; return its MAV_RESULT.

        A part has one injected failure at a time: another one takes its place. To mend is always possible.
        """
        start = (self._tick + 1) * DT
        result, failures = read_injection(message, start)
        faults, levels = list(self._schedule.faults), list(self._schedule.levels)
        if len(faults) + sum(fault is not None for fault in failures.values()) > self._most_faults:
            return mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        for part, fault in failures.items():
            if part in self._injected:
                last = self._injected.pop(part)
                faults[last] = msgspec.structs.replace(faults[last], end=start)
            if fault is not None:
                self._injected[part] = len(faults)
                faults.append(fault)
                levels.append(0.0)
        self._schedule = FaultSchedule(faults)
        self._schedule.levels = levels
        return result
