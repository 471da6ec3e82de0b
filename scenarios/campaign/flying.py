"""One flight in process: the runtime's own session against the aircraft, or members and laws by themselves.

Nothing here reads the clock or a global state: a flight is a function of its cell, its row and the population.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from runtime.identification import IncrementalModel
from runtime.laws.catalogue import load_settings, load_solo, make_law
from runtime.laws.solo import Solo
from runtime.link import LOST, OVER, Sample
from runtime.population import Population
from runtime.reference import RecordedReference
from runtime.session import Session, members_of
from scenarios.campaign.alone import Laws
from scenarios.campaign.design import Cell, reference_rows
from scenarios.campaign.members import Members
from scenarios.campaign.mirrored import MIRRORED, load_mirrored
from scenarios.campaign.perfect import PerfectModel
from scenarios.campaign.rows import Row
from scenarios.campaign.scores import Events, Record, score
from scenarios.campaign.trace import Course
from sim_bridge.plant import Plant
from sim_bridge.world import World
from task.limits import DT
from task.state import STATE


class WorldLink:
    """The aircraft's side as a link in lockstep, without sockets; keeps the course of the flight.

    That the aircraft was lost is seen up to ``LOOK`` samples late: what happens in them counts for nothing.
    """

    skipped = repeated = 0

    def __init__(self, world: World, rows: np.ndarray) -> None:
        """Take the aircraft at its start and the reference (N, 3) [rad], which ends the flight."""
        self.ended = ""
        self.course = Course(rows)
        self._world = world
        self._period = round(1e6 * DT)
        self._answered = 0

    def read(self, timeout: float) -> Sample | None:
        """Return the state of the current tick as the sensors see it, again until it is answered; None at the end."""
        if self._answered == len(self.course.rows):
            self.ended = OVER
        elif self._answered == self.course.ticks and self.course.see(self._world.x):
            self.ended = LOST
        return None if self.ended else Sample(self._period * self._answered, 1, self._world.measured.copy())

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Fly one tick."""
        self.course.command[self._answered] = action
        self._answered += 1
        self._world.step(action)

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
        self._plant = Plant()
        self._members = Members(population, self._plant)
        self._folder = tempfile.TemporaryDirectory(prefix="campaign-")
        self._laws = Laws(self._plant)
        self._mirrored: Solo | None = None

    def __enter__(self) -> Flyer:
        return self

    def __exit__(self, *exception: object) -> None:
        self._folder.cleanup()

    def check(self, row: Row) -> None:
        """Raise UserError unless the population has what a row asks of it."""
        if row.law is not None:
            self._law(row.law)
            return
        who, adaptation = self._population, row.configuration(True).adaptation
        members_of(who, adaptation)
        if adaptation.laws:
            who.laws_graph()
        for law in adaptation.laws:
            make_law(law, load_settings(), DT, member=True)
        IncrementalModel(
            adaptation, who.command_lag, who.theta, who.p0, DT, who.rates, who.max_delay, who.learnt_at
        )  # fmt: skip

    def fly(self, cell: Cell, row: Row) -> Record:
        """Fly a row: a law by itself, all else through the runtime's own loop."""
        return self._laws.fly(cell, row.alone, row.name) if row.alone else self.fly_session(cell, row)

    def fly_session(self, cell: Cell, row: Row) -> Record:
        """Fly a row through the runtime's own loop."""
        world = World(cell.flight, self._plant)
        rows = reference_rows(cell, float(world.x[STATE.theta]))
        link = WorldLink(world, rows)
        who = self._population if row.law is None else self._law(row.law)
        log = Path(self._folder.name) / "flight.ulg"
        configuration = row.configuration(cell.preview)
        first = configuration.adaptation.first or self._population.manifest.champion
        events = Events(cell.fault_at, first if row.law is None else "")
        with Session(link, who, RecordedReference(rows), configuration, log, events.hear, overwrite=True) as session:
            if row.model == "aircraft":
                adaptation = configuration.adaptation
                members = len(members_of(self._population, adaptation))
                soft = adaptation.switch == "soft"
                session.imagine_in(
                    lambda policy, cast, model, guard: PerfectModel(
                        world, policy, cast, model, guard, members, soft, row.stage
                    )
                )
            (flown,) = session.fly()
        if flown.failure:
            raise RuntimeError(flown.failure)
        events.check(flown.summary.switches, flown.summary.alarms)
        trace = link.course.trace()
        events.end(len(trace.x) * DT)
        return score(cell, row.name, "", trace, events)

    def fly_members(self, cell: Cell) -> list[Record]:
        """Fly every member from the moment of the fault on; until then the champion flies."""
        return self._members.fly(cell)

    def _law(self, name: str) -> Solo:
        if name != MIRRORED:
            return load_solo(name)
        self._mirrored = self._mirrored or load_mirrored(self._population.rates)
        return self._mirrored
