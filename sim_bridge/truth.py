"""Records what truly happened in a flight: states, commands, surfaces, wind and faults, tick by tick."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from task.errors import UserError
from task.files import atomic
from task.state import N_ACTION, N_STATE


class Truth:
    """Arrays of one flight, preallocated, written as one ``.npz`` without pickle.

    ============ ================= =====================================================================
    array        shape             what
    ============ ================= =====================================================================
    time_us      (n + 1,) int64    simulated time [us]; row k is tick k
    x            (n + 1, 12)       true state (task.state), before sensors
    surfaces     (n + 1, 3)        true deflections of elevator, aileron, rudder [rad]
    wind_n       (n + 1, 3)        velocity of the air over the ground, north-east-down [m/s]
    faults       (n + 1, F)        how far each fault has grown, 0 (absent) to 1
    fault_names  (F,) text         what they are
    command      (n, 3)            command in force over [k, k + 1), as received [rad]
    echo_us      (n,) int64        time of the state that this command answers [us]; -1 for none
    ============ ================= =====================================================================

    capacity: most ticks n; fault_names: one for each fault of the flight.
    """

    def __init__(self, capacity: int, fault_names: list[str]) -> None:
        self._time_us = np.zeros(capacity + 1, dtype=np.int64)
        self._x = np.zeros((capacity + 1, N_STATE))
        self._surfaces = np.zeros((capacity + 1, N_ACTION))
        self._wind_n = np.zeros((capacity + 1, 3))
        self._faults = np.zeros((capacity + 1, len(fault_names)))
        self._fault_names = np.array(fault_names, dtype=np.str_)
        self._command = np.zeros((capacity, N_ACTION))
        self._echo_us = np.full(capacity, -1, dtype=np.int64)
        self._states = 0
        self._commands = 0

    @property
    def ticks(self) -> int:
        """Commands recorded, n."""
        return self._commands

    def name_faults(self, names: list[str]) -> None:
        """Take the names of all faults when some have been added; those were absent until now."""
        if added := len(names) - self._faults.shape[1]:
            self._fault_names = np.array(names, dtype=np.str_)
            self._faults = np.pad(self._faults, ((0, 0), (0, added)))

    def state(self, time_us: int, x: np.ndarray, surfaces: np.ndarray, wind_n: np.ndarray, faults: list[float]) -> None:
        """Record the state of the next tick."""
        k = self._states
        self._time_us[k] = time_us
        self._x[k] = x
        self._surfaces[k] = surfaces
        self._wind_n[k] = wind_n
        self._faults[k] = faults
        self._states = k + 1

    def command(self, action: np.ndarray, echo_us: int) -> None:
        """Record the command that acts from the last recorded state on."""
        k = self._commands
        self._command[k] = action
        self._echo_us[k] = echo_us
        self._commands = k + 1

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what has been recorded, by name."""
        states, commands = self._states, self._commands
        return {
            "time_us": self._time_us[:states],
            "x": self._x[:states],
            "surfaces": self._surfaces[:states],
            "wind_n": self._wind_n[:states],
            "faults": self._faults[:states],
            "fault_names": self._fault_names,
            "command": self._command[:commands],
            "echo_us": self._echo_us[:commands],
        }

    def save(self, path: Path) -> None:
        """Write the file, whole or not at all; equal flights give equal bytes. Raises UserError."""
        write_whole(path, lambda file: np.savez(file, **self.arrays()))  # type: ignore[arg-type]


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file whole or not at all, whatever interrupts it. Raises UserError."""
    with atomic(path) as file:
        write(file)


def prepare(path: Path) -> None:
    """Make the folder of an output and see that it can be written, before anything flies. Raises UserError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: cannot make the folder {path.parent}: {error.strerror}") from None
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise UserError(f"{path}: cannot be written; expected a file in a folder that can be written to")
