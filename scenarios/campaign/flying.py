"""One flight in process: the runtime's own session, or one member alone in a short loop, against the aircraft.

Nothing here reads the clock or a global state: a flight is a function of its cell, its row and the population.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from runtime.config import Operation
from runtime.guard import UNUSABLE, Guard
from runtime.laws.catalogue import LawName, load_solo
from runtime.laws.solo import Solo
from runtime.link import LOST, OVER, Sample
from runtime.population import BehaviouralPolicy, Population
from runtime.reference import RecordedReference
from runtime.session import Session
from scenarios.campaign.design import Cell, reference_rows
from scenarios.campaign.mirrored import MIRRORED, load_mirrored
from scenarios.campaign.rows import Row
from scenarios.campaign.scores import Events, Record, score
from sim_bridge.flight import Flight
from sim_bridge.plant import Plant
from sim_bridge.world import World
from task.limits import DT
from task.reference import n_samples
from task.reward import terminated
from task.state import STATE

LOOK = 25
"""So often a member that flies alone is looked at whether it is lost [samples]; the loss itself is found exactly."""


class Trace(NamedTuple):
    """What the aircraft did."""

    x: np.ndarray
    """(T, 12) true states until the end or the loss."""
    command: np.ndarray
    """(T, 3) commands [rad]."""
    rows: np.ndarray
    """(N, 3) the reference of the whole flight [rad]."""


class WorldLink:
    """The aircraft's side as a link in lockstep, without sockets; remembers the truth."""

    skipped = repeated = 0

    def __init__(self, flight: Flight, plant: Plant) -> None:
        self.ended = ""
        self._world = World(flight, plant)
        self._ticks = n_samples(flight.duration)
        self._period = round(1e6 * DT)
        self.x = [self._world.x.copy()]
        self.commands: list[np.ndarray] = []

    @property
    def trim_pitch(self) -> float:
        """Pitch of the start [rad]."""
        return float(self.x[0][STATE.theta])

    def read(self, timeout: float) -> Sample | None:
        """Return the state of the current tick as the sensors see it; None at the end."""
        if len(self.commands) >= self._ticks:
            self.ended = OVER
        elif terminated(self._world.x):
            self.ended = LOST
        return None if self.ended else Sample(self._period * len(self.commands), 1, self._world.measured.copy())

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Fly one tick."""
        self.commands.append(action.copy())
        self._world.step(action)
        self.x.append(self._world.x.copy())

    def say(self, text: str, severity: int) -> None:
        """Say nothing: the session hears it too."""

    def diagnosis(self) -> str:
        """Return what there is to say of the link."""
        return "in process"

    def close(self) -> None:
        """Do nothing."""


class Flyer:
    """Flies cells with one population; what flights share is made once. Use it as a context manager."""

    def __init__(self, population: Population) -> None:
        self._population = population
        self._policy = BehaviouralPolicy(population)
        self._plant = Plant()
        self._folder = tempfile.TemporaryDirectory(prefix="campaign-")
        self._laws: dict[str, Solo] = {}

    def __enter__(self) -> Flyer:
        return self

    def __exit__(self, *exception: object) -> None:
        self._folder.cleanup()

    def fly(self, cell: Cell, row: Row) -> Record:
        """Fly a row through the runtime's own loop."""
        link = WorldLink(cell.flight, self._plant)
        rows = reference_rows(cell, link.trim_pitch)
        events = Events(cell.fault_at, self._population.manifest.champion if row.law is None else "")
        who = self._population if row.law is None else self._law(row.law)
        log = Path(self._folder.name) / "flight.ulg"
        configuration = row.configuration(cell.preview)
        with Session(link, who, RecordedReference(rows), configuration, log, events.hear) as session:
            (flown,) = session.fly()
        events.check(flown.summary.switches, flown.summary.alarms)
        trace = Trace(np.array(link.x[: len(link.commands)]), np.array(link.commands), rows)
        return score(cell, row.name, "", trace, events)

    def fly_members(self, cell: Cell) -> list[Record]:
        """Fly every member from the moment of the fault on; until then the champion flies."""
        return [self.fly_member(cell, member) for member in range(len(self._population.members))]

    def fly_member(self, cell: Cell, member: int) -> Record:
        """Fly one member from the moment of the fault on: what a runtime does that changes the cast then and no more.

        The same cycle as :class:`runtime.loop.Loop` in fewer words: measure, ask, limit, step; nothing is identified.
        """
        world, policy, guard = World(cell.flight, self._plant), self._policy, Guard(Operation())
        rows = reference_rows(cell, float(world.x[STATE.theta]))
        samples, switch = len(rows), round(cell.fault_at / DT)
        x, command = np.zeros((samples, len(STATE))), np.zeros((samples, 3))
        np.copyto(policy.parameters, self._population.parameters[self._population.champion])
        flown = samples
        with np.errstate(all="ignore"):
            for k in range(samples):
                x[k] = world.x
                if k % LOOK == 0 and terminated(x[max(k - LOOK, 0) : k + 1]).any():
                    flown = k + 1
                    break
                if k == switch:
                    np.copyto(policy.parameters, self._population.parameters[member])
                measured = world.measured
                if guard.check_state(measured) & UNUSABLE:
                    command[k] = guard.fallback()[0]
                else:
                    command[k] = guard.command(policy.steer(measured, rows[k]))[0]
                world.step(command[k])
        lost = np.flatnonzero(terminated(x[:flown]))
        end = int(lost[0]) if lost.size else samples
        events = Events(cell.fault_at, "")
        return score(cell, "members", self._population.members[member], Trace(x[:end], command[:end], rows), events)

    def _law(self, name: LawName | Literal["pid-mirrored"]) -> Solo:
        if name not in self._laws:
            self._laws[name] = load_mirrored(self._population.rates) if name == MIRRORED else load_solo(name)
        return self._laws[name]
