"""Every member of a cast in one cell: until the fault the champion flies, the member from then on.

That is what a runtime does which changes the cast in that moment and no more: the cycle of :class:`runtime.loop.Loop`
in fewer words, measure, ask, limit, step; nothing is identified, recorded or gated without need. Bit for bit the same.

One aircraft after the other: side by side, with one forward pass for all, a dozen aircraft fall out of a core's cache
(``export.training.flights``), which costs more than that pass saves.
"""

from __future__ import annotations

import numpy as np

from runtime.config import Operation
from runtime.guard import PLAUSIBLE, UNUSABLE, Guard
from runtime.population import BehaviouralPolicy, Population
from scenarios.campaign.design import Cell, reference_rows
from scenarios.campaign.scores import Events, Record, score
from scenarios.campaign.trace import Course, Trace
from sim_bridge.plant import Plant
from sim_bridge.world import World
from task.limits import DEFLECTION_LIMIT, DT
from task.state import N_ACTION, STATE


class Members:
    """Flies the members of one population; what flights share is made once."""

    def __init__(self, population: Population, plant: Plant) -> None:
        """Take the population and an aircraft that is nobody else's while a cell is flown."""
        self._population = population
        self._policy = BehaviouralPolicy(population)
        self._plant = plant

    def fly(self, cell: Cell, only: list[int] | None = None) -> list[Record]:
        """Fly every member, or ``only`` some, given by their indices; return their flights in that order."""
        names, champion = self._population.members, self._population.champion
        first = self._trace(cell, champion, np.zeros((0, N_ACTION)))
        opening = first.command[: round(cell.fault_at / DT)]
        records = []
        for member in range(len(names)) if only is None else only:
            shared = member == champion or cell.fault_at >= len(first.x) * DT
            trace = first if shared else self._trace(cell, member, opening)
            records.append(score(cell, "members", names[member], trace, Events(cell.fault_at, "")))
        return records

    def _trace(self, cell: Cell, member: int, opening: np.ndarray) -> Trace:
        """Fly one member after the commands ``opening`` (k, 3) [rad], which the champion gives until the fault.

        The last gate has hardly ever anything to say: it is left out, and the flight is flown again with it when it
        would have spoken.
        """
        course, untouched = self._course(cell, member, opening, None)
        trace = course.trace()
        if not untouched[: len(trace.x)].all():
            trace = self._course(cell, member, opening[:0], Guard(Operation()))[0].trace()
        return trace

    def _course(self, cell: Cell, member: int, opening: np.ndarray, guard: Guard | None) -> tuple[Course, np.ndarray]:
        """Return a flight, and what the last gate has nothing to say to beyond the limits: (N, 15) bool."""
        world, policy, switch = World(cell.flight, self._plant), self._policy, round(cell.fault_at / DT)
        np.copyto(policy.parameters, self._population.parameters[self._population.champion])
        course = Course(reference_rows(cell, float(world.x[STATE.theta])))
        command, given = course.command, len(opening)
        measured, asked = np.zeros_like(course.x), np.zeros_like(command)
        command[:given] = opening
        with np.errstate(all="ignore"):
            for k, row in enumerate(course.rows):
                if course.see(world.x):
                    break
                if k == switch:
                    np.copyto(policy.parameters, self._population.parameters[member])
                if k >= given:
                    seen = world.measured
                    if guard is None:
                        measured[k] = seen
                        asked[k] = action = policy.steer(seen, row)
                        command[k] = [min(max(a, -DEFLECTION_LIMIT), DEFLECTION_LIMIT) for a in action.tolist()]
                    elif guard.check_state(seen) & UNUSABLE:
                        command[k] = guard.fallback()[0]
                    else:
                        command[k] = guard.command(policy.steer(seen, row))[0]
                world.step(command[k])
        return course, np.concatenate([np.abs(measured) <= PLAUSIBLE, np.isfinite(asked)], axis=1)
