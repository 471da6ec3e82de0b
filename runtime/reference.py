"""The references that the flight follows: from a file, with the future known, or live from the link."""

from __future__ import annotations

import io
from collections import deque
from pathlib import Path
from typing import Protocol

import numpy as np

from task.config import read_bytes
from task.errors import UserError
from task.limits import DT
from task.state import N_REFERENCE, REFERENCE, STATE

LONGEST = 86400.0
"""Time of the last row of a reference file at most [s]."""
COLUMNS = ("t", *(signal.name for signal in REFERENCE))
"""Columns of a reference file: time [s], then theta, phi, beta [rad]."""


class Reference(Protocol):
    """What the loop asks for. ``t`` is the time of the state in seconds since the flight began."""

    def start(self, x: np.ndarray) -> None:
        """Begin a flight at the state x (12,)."""

    def at(self, t: float) -> np.ndarray:
        """Return theta, phi, beta [rad], shape (3,), for time t."""

    def preview(self, t: float, samples: int) -> np.ndarray | None:
        """Return the reference at t and the samples after it, shape (samples, 3) float32; None if nobody knows them."""


class RecordedReference:
    """A reference known beforehand, one row (3,) a sample from t = 0; its last row is held."""

    def __init__(self, rows: np.ndarray, dt: float = DT) -> None:
        self._rows = np.ascontiguousarray(rows, dtype=float)
        self._dt = dt

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return (len(self._rows) - 1) * self._dt

    def start(self, x: np.ndarray) -> None:
        """Do nothing: the file says it all."""

    def _row(self, t: float) -> int:
        return min(max(round(t / self._dt), 0), len(self._rows) - 1)

    def at(self, t: float) -> np.ndarray:
        """Return the row at t, shape (3,) [rad]."""
        return self._rows[self._row(t)]

    def preview(self, t: float, samples: int) -> np.ndarray:
        """Return the rows from t on, shape (samples, 3) float32; the last one is repeated."""
        first = self._row(t)
        known = self._rows[first : first + samples]
        out = np.empty((samples, N_REFERENCE), dtype=np.float32)
        out[: len(known)] = known
        out[len(known) :] = known[-1]
        return out


class LiveReference:
    """The newest set-point from the link, held until the next; before a flight's first, level at the pitch found."""

    def __init__(self) -> None:
        self._now = np.zeros(N_REFERENCE)
        self._told = False

    def set(self, theta: float, phi: float) -> None:
        """Take a set-point [rad]; beta is asked to be zero. One that is not finite is ignored."""
        if np.isfinite(theta) and np.isfinite(phi):
            self._now[REFERENCE.theta], self._now[REFERENCE.phi] = theta, phi
            self._told = True

    def release(self) -> None:
        """End a flight: what was asked of it is not asked of the next one."""
        self._now[:], self._told = 0.0, False

    def start(self, x: np.ndarray) -> None:
        """Begin a flight: hold the pitch of x (12,) with wings level unless a set-point came since the last one."""
        if not self._told:
            self._now[REFERENCE.theta] = x[STATE.theta]

    def at(self, t: float) -> np.ndarray:
        """Return the set-point, shape (3,) [rad]; the array is reused."""
        return self._now

    def preview(self, t: float, samples: int) -> None:
        """Return None: nobody knows the next set-point."""


class Trend:
    """What a reference is taken to do that nobody knows beforehand: it goes on as it moves now, and slows down.

        r(t + s) = r(t) + r'(t) T (1 - exp(-s / T))

    A ramp that ended now would be a step of its rate: members with high gains are imagined to swing after it, and the
    one that follows ramps best looks worst. r' of an axis is the least of its slopes over three times ``WINDOW``, where
    all have one sign, and else zero: a set-point that steps has no slope.
    """

    WINDOW = 0.1
    """Over which a slope is taken [s]."""
    WINDOWS = 3

    def __init__(self, time: float, dt: float = DT) -> None:
        """Take the time constant T [s], 0 to hold what is asked for now, and the time between two samples [s]."""
        self._time, self._dt = time, dt
        self._window = max(round(self.WINDOW / dt), 1)
        self._past: deque[np.ndarray] = deque(maxlen=self.WINDOWS * self._window + 1 if time else 1)
        self._tick = -1

    def see(self, tick: int, now: np.ndarray) -> None:
        """Take the reference (3,) [rad] of a sample; after a gap slopes are looked for anew."""
        if tick != self._tick + 1:
            self._past.clear()
        self._tick = tick
        self._past.append(now.copy())

    def ahead(self, samples: int) -> np.ndarray:
        """Return the reference seen last and ``samples`` - 1 after it, shape (samples, 3) float32 [rad]."""
        out = np.tile(self._past[-1], (samples, 1))
        if self._time and len(self._past) == self._past.maxlen:
            at = np.array(self._past)[:: self._window]
            slopes = np.diff(at, axis=0) / (self._window * self._dt)
            one_sign = np.abs(np.sign(slopes).sum(axis=0)) == self.WINDOWS
            rate = np.where(one_sign, np.sign(slopes[-1]) * np.abs(slopes).min(axis=0), 0.0)
            out += np.outer(-self._time * np.expm1(-self._dt / self._time * np.arange(samples)), rate)
        return out.astype(np.float32)


def _read_table(path: Path) -> np.ndarray:
    """Return the numbers of a file, shape (N, 4)."""
    data = read_bytes(path, "reference")
    if path.suffix == ".npy":
        try:
            table = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
        except (ValueError, EOFError, OSError, MemoryError) as error:
            raise UserError(f"{path}: not a NumPy array of numbers: {' '.join(str(error).split())}") from None
        if table.dtype.kind not in "biuf":
            raise UserError(f"{path}: expected numbers, got an array of {table.dtype}; save it as float64")
        return table.astype(float)
    lines = [line.strip() for line in data.decode("utf-8-sig", errors="replace").splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if lines and lines[0][0].isalpha():
        header = tuple(name.strip() for name in lines[0].split(","))
        if header != COLUMNS:
            raise UserError(f"{path}: expected columns {','.join(COLUMNS)}, got {','.join(header)}")
        lines = lines[1:]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            rows.append([float(cell) for cell in line.split(",")])
        except ValueError:
            raise UserError(f"{path}: row {number} is not {len(COLUMNS)} numbers: {line[:60]!r}") from None
        if len(rows[-1]) != len(COLUMNS):
            raise UserError(f"{path}: row {number}: expected {len(COLUMNS)} numbers, got {len(rows[-1])}")
    return np.array(rows, dtype=float)


def load_reference(path: Path, dt: float = DT) -> RecordedReference:
    """Read a reference from CSV (columns t,theta,phi,beta; header optional) or NPY (N, 4).

    t [s] must rise and start at or before 0; angles in rad. Rows are interpolated onto the loop's samples. Raises
    UserError for a file that is missing, empty, malformed, not finite, not rising, or in other units by the look of it.
    """
    table = _read_table(path)
    if table.ndim != 2 or table.shape[0] == 0 or table.shape[1] != len(COLUMNS):
        raise UserError(f"{path}: expected shape (N, {len(COLUMNS)}) = {','.join(COLUMNS)}, got {table.shape}")
    if not np.isfinite(table).all():
        raise UserError(f"{path}: row {int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0]) + 1} is not finite")
    t, angles = table[:, 0], table[:, 1:]
    if np.any(np.diff(t) <= 0.0):
        raise UserError(f"{path}: time must rise; row {int(np.flatnonzero(np.diff(t) <= 0.0)[0]) + 2} does not")
    if t[0] > 0.0:
        raise UserError(f"{path}: expected the first row at t = 0 s, got {t[0]:g} s")
    if not 0.0 <= t[-1] <= LONGEST:
        raise UserError(
            f"{path}: expected the last row between t = 0 s and {LONGEST:g} s, a day, got {t[-1]:g} s; "
            "are these seconds?"
        )
    if np.abs(angles).max() > np.pi:
        raise UserError(
            f"{path}: an angle of {np.abs(angles).max():g} rad is more than half a turn; are these degrees?"
        )
    grid = np.arange(round(t[-1] / dt) + 1) * dt
    return RecordedReference(np.column_stack([np.interp(grid, t, column) for column in angles.T]), dt)
