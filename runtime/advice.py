"""What classical laws are told of the aircraft, beyond what becomes of their commands.

Which surfaces are reversed, and up to which angle of attack the elevator still holds the nose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from runtime.structured import Effectiveness
from task.limits import DEFLECTION_LIMIT
from task.state import ACTION

SIGNED, SIGNED_SD = 0.1, 3.0
"""A sign is known for sure when lambda is beyond the first by so many standard deviations [-]."""
JAMMED = 0.01
"""A surface with no more range than this does not move [rad]."""
WORKS = 1.0
"""An elevator that pitches less than this holds nothing [rad/s2 per rad]; the healthy one at 90 m/s does 12.5."""
NOSE_UP = math.radians(3.0)
"""A moment that so much of the elevator makes up for is no error of the model [rad]."""
ELEVATOR_FOR_ALPHA = 1.0
"""Elevator that each degree of angle of attack may ask for [-]. An aircraft whose centre of gravity is 0.9 m aft asks
for 0.8; one that is stable asks for nothing, and is kept from what it could do."""
STEEPEST = math.radians(3.0)
"""An angle of attack that cannot be held is left no faster than if it were this far away [rad]."""

LOWEST = 0.0
"""No angle of attack below this is asked for, whatever the elevator holds [rad]: a stable aircraft needs the more of it
the lower its nose is, and a limit that went on below would push the nose down without end."""


def sure_signs(found: Effectiveness, low: Sequence[float], high: Sequence[float]) -> list[float | None]:
    """Return lambda (3,), None where its sign is not known for sure; a jammed surface has none.

    low, high (3,): least and greatest deflection of each surface, as they are believed [rad].
    """
    return [
        each if abs(each) - SIGNED_SD * sd > SIGNED and up - down > JAMMED else None
        for each, sd, down, up in zip(found.effectiveness.tolist(), found.sd.tolist(), low, high, strict=True)
    ]


def highest_alpha(found: Effectiveness, reserve: float) -> float:
    """Return the angle of attack [rad] at which all of the elevator but ``reserve`` [rad] holds the nose down.

    Infinite while no moment is believed that a healthy aircraft would not have, the elevator does not work, or a sensor
    stands still. Behind its neutral point an aircraft needs the more nose-down elevator the higher its nose is; where
    the elevator ends, the nose goes on. What is needed now is what acts, and what would stop the pitching:

        alpha + (limit - reserve - (u - q' / (dq'/du))) / ELEVATOR_FOR_ALPHA

    but no further below alpha than ``STEEPEST``, and not below ``LOWEST``.
    """
    if reserve == 0.0 or not found.known or found.stuck.any:
        return math.inf
    effect = found.elevator_effect
    if effect > -WORKS or found.nose_up < -effect * NOSE_UP:
        return math.inf
    needed = found.acted.item(ACTION.de) - found.pitching / effect
    left = (DEFLECTION_LIMIT - reserve - needed) / ELEVATOR_FOR_ALPHA
    return max(found.alpha + max(left, -STEEPEST), LOWEST)
