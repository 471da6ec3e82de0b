"""What is kept of one flight: figures from the moment of the fault on, from the aircraft's true states."""

from __future__ import annotations

import math
from typing import Protocol

import msgspec
import numpy as np

from scenarios.campaign.design import Cell
from task.limits import DT
from task.metrics import channel_nmae, smoothness
from task.observation import tracking_error
from task.state import REFERENCE, STATE

NAN = float("nan")
STALL = math.radians(12.0)
"""Angle of attack beyond which a wing counts as stalled [rad]: here the aircraft's tables end.

Up to Mach 0.37 lift is greatest at 11 deg or below; faster it still grows here, and nothing is known of it beyond.
Attitude can be held there too, by an aircraft that falls.
"""
OF_THE_CELL = (
    "suite", "fault", "group", "index", "half", "moment", "references", "trim", "sensors", "air", "preview", "fault_at",
)  # fmt: skip
"""What a record repeats of its cell."""


class Flown(Protocol):
    """States (T, 12), commands (T, 3) and the reference (N, 3) of a flight; lost when T < N."""

    @property
    def x(self) -> np.ndarray:
        """True states."""

    @property
    def command(self) -> np.ndarray:
        """Commands [rad]."""

    @property
    def rows(self) -> np.ndarray:
        """Reference [rad]."""


class Record(msgspec.Struct, kw_only=True):
    """One flight. Times count from the moment of the fault; figures are taken from it to the end or the loss."""

    suite: str
    fault: str
    group: str
    index: int
    half: str
    moment: str
    references: str
    trim: str
    sensors: str
    air: str
    preview: bool
    fault_at: float
    """As in the cell (``scenarios.campaign.design``)."""
    row: str
    """The way of adapting."""
    member: str = ""
    """Who flies from the fault on, in flights of single members."""
    survived: bool
    lost_after: float = NAN
    """When the aircraft was lost [s]; negative before the fault, NaN when it was not."""
    nmae: float = NAN
    """Mean over theta, phi, beta of the normalised mean absolute error [%]; NaN when lost before the fault."""
    nmae_theta: float = NAN
    nmae_phi: float = NAN
    nmae_beta: float = NAN
    """The same, each channel on its own [%]."""
    beta_deg: float = NAN
    """Mean absolute sideslip error [deg]."""
    smoothness: float = NAN
    """Sm of eq. 16 [rad Hz]."""
    largest_step: float = NAN
    """Largest change of a command from one sample to the next [deg]."""
    stalled: float = NAN
    """For how long the angle of attack was beyond ``STALL`` [s]."""
    switches: int = 0
    """Changes of the cast from the fault on."""
    switches_before: int = 0
    alarms: int = 0
    """Alarms from the fault on, as said by the runtime: a change of what it believes is one too."""
    alarms_before: int = 0
    alarm: float = NAN
    """The first alarm from the fault on [s]."""
    switched_at: list[float] = []
    """When the cast was changed [s]; the first entry is the flight's start."""
    switched_to: list[str] = []
    """Towards whom."""


class Events:
    """Hears the runtime's lines: alarms, other hypotheses that are suspected with them, and changes of the cast."""

    def __init__(self, fault_at: float, champion: str) -> None:
        """Take the moment of the fault [s] and who flies first; nobody when there is no cast."""
        self._fault_at = fault_at
        self.alarms: list[float] = []
        """Times from the fault [s]."""
        self.switched_at = [-fault_at]
        self.switched_to = [champion]

    def hear(self, line: str) -> None:
        """Take a line of ``runtime.loop.Loop.say``."""
        at, _, text = line.partition(" s: ")
        if text.startswith(("alarm", "suspected")):
            self.alarms.append(self._since(at))
        elif " switch to " in text:
            self.switched_at.append(self._since(at))
            self.switched_to.append(text.split(" switch to ")[1].partition(": ")[0])

    def _since(self, at: str) -> float:
        return round(float(at) - self._fault_at, 2)

    def check(self, switches: int, alarms: int) -> None:
        """Raise when not all that the session counted was heard: then its lines read differently now.

        More alarms may be heard than counted: a change of what is believed is said as one too.
        """
        heard = (len(self.switched_at) - 1, len(self.alarms))
        if heard[0] != switches or heard[1] < alarms:
            raise RuntimeError(f"heard of {heard} switches and alarms, the runtime counted {(switches, alarms)}")

    def end(self, at: float) -> None:
        """Forget what came at ``at`` [s] of the flight or later: the aircraft was lost by then."""
        after = round(at - self._fault_at, 2)
        self.alarms = [a for a in self.alarms if a < after]
        kept = max(sum(a < after for a in self.switched_at), 1)  # who flew first flew
        self.switched_at, self.switched_to = self.switched_at[:kept], self.switched_to[:kept]


def score(cell: Cell, row: str, member: str, flown: Flown, events: Events) -> Record:
    """Return the figures of one flight."""
    first, ticks = round(cell.fault_at / DT), len(flown.x)
    lost = ticks < len(flown.rows)
    record = Record(
        **{name: getattr(cell, name) for name in OF_THE_CELL}, row=row, member=member,
        survived=not lost, lost_after=round(ticks * DT - cell.fault_at, 2) if lost else NAN,
    )  # fmt: skip
    record.switches = sum(at >= 0.0 for at in events.switched_at)
    record.switches_before = len(events.switched_at) - 1 - record.switches
    after = [at for at in events.alarms if at >= 0.0]
    record.alarms, record.alarms_before = len(after), len(events.alarms) - len(after)
    record.alarm = min(after, default=NAN)
    if events.switched_to[0]:
        record.switched_at, record.switched_to = events.switched_at, events.switched_to
    if ticks <= first:
        return record
    error = tracking_error(flown.x[first:], flown.rows[first:ticks])
    command = flown.command[max(first - 1, 0) : ticks]
    channels = 100.0 * channel_nmae(error)
    record.nmae = float(channels.mean())
    record.nmae_theta, record.nmae_phi, record.nmae_beta = (float(c) for c in channels)
    record.beta_deg = math.degrees(float(np.abs(error[:, REFERENCE.beta]).mean()))
    record.smoothness = smoothness(command)
    record.largest_step = math.degrees(float(np.abs(np.diff(command, axis=0)).max(initial=0.0)))
    record.stalled = DT * float((flown.x[first:, STATE.alpha] > STALL).sum())
    return record
