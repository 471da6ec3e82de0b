"""Everything on the aircraft's side of the link: the plant, what breaks in it, and what its sensors say."""

from __future__ import annotations

import numpy as np

from sim_bridge.flight import Flight
from sim_bridge.plant import Plant
from task.state import STATE


class World:
    """The aircraft of one flight at its current tick; deterministic in the flight and its seed.

    Raises UserError when the aircraft cannot be trimmed to the flight's condition.
    """

    def __init__(self, flight: Flight) -> None:
        self._plant = Plant()
        self.x = self._plant.reset(flight.condition)
        """True state (12,), task.state."""
        self.trim_action = self._plant.trim.action
        """Deflections that hold the start [rad], shape (3,)."""
        self.surfaces = self.trim_action
        """True deflections [rad], shape (3,)."""
        self.origin_altitude = round(float(self.x[STATE.h]), 3)
        """Altitude of the start [m], a whole number of millimetres."""
        self.fault_names: list[str] = []
        self.faults: list[bool] = []
        """Whether each fault acts now."""

    @property
    def measured(self) -> np.ndarray:
        """What the sensors say of x, shape (12,)."""
        return self.x.copy()

    @property
    def wind_n(self) -> np.ndarray:
        """Velocity of the air over the ground, north-east-down [m/s], shape (3,)."""
        return self._plant.wind

    def step(self, command: np.ndarray) -> None:
        """Advance by one tick under a command (3,) [rad]."""
        self.surfaces = command
        self.x = self._plant.step(command)
