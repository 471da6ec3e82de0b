"""What every fault is: a level over time, and a change of the aircraft's condition."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import msgspec
import numpy as np

from sim_bridge.actuators import Surface
from sim_bridge.effects import ENGINE_ARM, NO_ALPHA_LIMIT
from task.config import Settings
from task.state import N_ACTION

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]

SAME_TIME = 1e-9
"""Times closer than this are one [s]."""


@dataclass
class Condition:
    """What all faults together make of the aircraft at one moment; starts nominal."""

    surfaces: list[Surface] = field(default_factory=lambda: [Surface() for _ in range(N_ACTION)])
    mixing: np.ndarray = field(default_factory=lambda: np.eye(N_ACTION))
    cg_shift: float = 0.0
    drag: float = 0.0
    alpha_max: float = NO_ALPHA_LIMIT
    gust: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gust_upright: bool = False
    thrust: list[float] = field(default_factory=lambda: [1.0, 1.0])
    engine_arm: float = ENGINE_ARM
    yaw_damper: bool = True
    noise: dict[int, float] = field(default_factory=dict)
    bias: dict[int, float] = field(default_factory=dict)
    delay: float = 0.0
    stuck: set[int] = field(default_factory=set)


class Fault(Settings, frozen=True, kw_only=True, tag_field="kind"):
    """When a fault acts: from ``start``, for good or until ``end``, growing and fading over ``ramp``."""

    start: NotNegative = 0.0
    """When it begins [s]."""
    end: NotNegative | None = None
    """When it begins to go away [s]; none: it stays."""
    ramp: NotNegative = 0.0
    """How long it takes to grow to its magnitude, and to go away again [s]; 0 is sudden."""

    def __post_init__(self) -> None:
        """Check what single fields cannot."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(
                    f"{name}: expected a finite number, got {value}; leave 'end' out for a fault that stays"
                )
        if self.end is not None and self.end < self.start + self.ramp:
            raise ValueError(
                f"end: expected at least start + ramp = {self.start + self.ramp:g} s, got {self.end:g}; "
                "let the fault grow before it goes away"
            )

    def level(self, time: float) -> float:
        """Return how far it has grown at ``time`` [s], 0 to 1."""
        grown = _ramp(time - self.start, self.ramp)
        return grown if self.end is None else grown - _ramp(time - self.end, self.ramp)

    def next_change(self, time: float) -> float:
        """Return the earliest time from ``time`` on at which the level moves: itself while it ramps, inf when done."""
        for edge in (self.start, self.end):
            if edge is None:
                break
            if time < edge - SAME_TIME:
                return edge
            if time < edge + self.ramp - SAME_TIME:
                return time
        return math.inf

    def apply(self, condition: Condition, level: float) -> None:
        """Add to ``condition`` what the fault does at a level in (0, 1]."""
        raise NotImplementedError


def _ramp(elapsed: float, duration: float) -> float:
    """Return 0 before, 1 after, and the straight line between."""
    if elapsed < -SAME_TIME:
        return 0.0
    return 1.0 if elapsed >= duration - SAME_TIME else max(elapsed, 0.0) / duration
