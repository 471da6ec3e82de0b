"""A law alone in one cell: the cycle of :class:`runtime.loop.Loop` in fewer words, bit for bit the same.

Nothing is identified, imagined or recorded: what an estimator is changed to does not change these flights.
"""

from __future__ import annotations

import numpy as np

from runtime.config import Operation
from runtime.guard import UNUSABLE, Guard
from runtime.laws.catalogue import load_settings, make_law
from scenarios.campaign.design import Cell, reference_rows
from scenarios.campaign.scores import Events, Record, score
from scenarios.campaign.trace import Course
from sim_bridge.plant import Plant
from sim_bridge.world import World
from task.state import STATE


class Laws:
    """Flies laws; what flights share is made once."""

    def __init__(self, plant: Plant) -> None:
        """Take an aircraft that is nobody else's while a cell is flown."""
        self._plant = plant
        self._settings = load_settings()

    def fly(self, cell: Cell, name: str, row_name: str) -> Record:
        """Fly the law ``name`` from the first sample on; tables call it ``row_name``."""
        world, guard, law = World(cell.flight, self._plant), Guard(Operation()), make_law(name, self._settings)
        course = Course(reference_rows(cell, float(world.x[STATE.theta])))
        with np.errstate(all="ignore"):
            for k, row in enumerate(course.rows):
                if course.see(world.x):
                    break
                seen = world.measured
                if guard.check_state(seen) & UNUSABLE:
                    law.restart_history()
                    command = guard.fallback()[0]
                else:
                    command = guard.command(law.steer(seen, row))[0]
                course.command[k] = command
                law.sent(command)
                world.step(command)
        return score(cell, row_name, "", course.trace(), Events(cell.fault_at, ""))
