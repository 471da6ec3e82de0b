"""Applies a flight's faults as time goes by; nearly free while nothing changes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim_bridge.fault import SAME_TIME, Condition
from sim_bridge.faults import AnyFault
from sim_bridge.plant import Plant
from sim_bridge.sensors import Sensors


class FaultSchedule:
    """The faults of one flight; training in process and the bridge use the same one. Deterministic.

    Whenever a level changes, everything is built up again from nominal by the faults that act, so that what has
    ended leaves no trace, whatever the order.
    """

    def __init__(self, faults: Sequence[AnyFault] = ()) -> None:
        """Take the faults of one flight."""
        self.faults = tuple(faults)
        self.restart()

    def restart(self) -> None:
        """Begin a flight: plant and sensors have been reset, nothing acts yet."""
        self.levels = [0.0] * len(self.faults)
        """How far each fault has grown, 0 to 1, in the order given."""
        self._next = -math.inf if self.faults else math.inf

    def apply(self, plant: Plant, time: float, sensors: Sensors | None = None) -> None:
        """Bring plant and sensors to ``time`` [s] since the reset, before the step that begins there.

        Like a command, an effect first moves the increment after the next (docs/architecture.md).
        """
        if time < self._next - SAME_TIME:
            return
        levels = [fault.level(time) for fault in self.faults]
        self._next = min(fault.next_change(time) for fault in self.faults)
        if levels == self.levels:
            return
        self.levels = levels
        condition = Condition()
        for fault, level in zip(self.faults, levels, strict=True):
            if level > 0.0:
                fault.apply(condition, level)
        effects = plant.effects
        effects.set_cg_shift(condition.cg_shift)
        effects.set_icing(condition.drag, condition.alpha_max)
        north, east, down = condition.gust.tolist()
        effects.set_gust(north, east, down, condition.gust_upright)
        left, right = condition.thrust
        effects.set_thrust(left, right, condition.engine_arm)
        effects.set_yaw_damper(condition.yaw_damper)
        plant.actuators.configure(condition.surfaces, condition.mixing, plant.surfaces.tolist())
        if sensors is not None:
            sensors.impair(condition.noise, condition.bias, condition.delay, condition.stuck)
