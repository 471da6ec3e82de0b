"""What the filters have found, in words: each change of it is said once, when it has held for a while."""

from __future__ import annotations

import math

from runtime.advice import JAMMED
from runtime.hypotheses import STRAIGHT, Hypothesis
from runtime.ranges import HIGH, LOW, Range
from runtime.structured import Effectiveness
from task.limits import DT
from task.state import N_ACTION

SURFACES = "elevator", "aileron", "rudder"
DEAD = 0.1
"""A surface with less lambda than this, either way, does nothing [-]."""


def describe(choice: Hypothesis, dt: float) -> str:
    """Return in words what a hypothesis says of the commands; dt is the sample time [s]."""
    if choice.delay:
        return f"commands {1e3 * dt * choice.delay:.0f} ms late"
    if choice.order != STRAIGHT:
        return "aileron and rudder crossed"
    if choice.rate < math.inf:
        return f"surfaces no faster than {math.degrees(choice.rate):.0f} deg/s"
    if choice.bandwidth < math.inf:
        return f"surfaces lag, corner at {choice.bandwidth:g} Hz"
    if choice.uncommanded is not None:
        return f"{SURFACES[choice.uncommanded]} moves by itself"
    if choice.limited is not None:
        return f"{SURFACES[choice.limited]} stops short of its commands"
    return "commands are followed as they should"


def describe_range(surface: int, found: Range) -> str:
    """Return in words where a surface stops, as far as that is known."""
    low, high = (math.degrees(end) for end in found.ends)
    name = SURFACES[surface]
    if found.known[LOW] and found.known[HIGH]:
        if math.radians(high - low) < JAMMED:
            return f"{name} stands still at {0.5 * (low + high):.1f} deg"
        return f"{name} stops at {low:.1f} and {high:.1f} deg"
    if found.limited:
        return f"{name} stops at {low if found.known[LOW] else high:.1f} deg"
    return f"{name} stops short of its commands"


def describe_effect(surface: int, effectiveness: float) -> str:
    """Return in words how a surface works; effectiveness is its lambda."""
    name = SURFACES[surface]
    if effectiveness < -DEAD:
        return f"{name} works backwards ({effectiveness:.2f})"
    if effectiveness <= DEAD:
        return f"{name} does nothing ({effectiveness:.2f})"
    if abs(effectiveness - 1.0) <= Findings.CHANGE:
        return f"{name} works as it should ({effectiveness:.2f})"
    return f"{name} works {effectiveness:.2f} times as well"


class _Fact:
    """Numbers that were said, and for how many looks in a row others have been there."""

    def __init__(self, said: tuple[float, ...]) -> None:
        self.said = self._seen = said
        self._held = 0

    def held(self, now: tuple[float, ...], change: float) -> int:
        """Take the numbers of a look; return for how many looks they have been others than said, and steady."""
        if _apart(now, self.said) <= change:
            self._held = 0
        else:
            self._held = self._held + 1 if _apart(now, self._seen) <= change else 1
        self._seen = now
        return self._held

    def forget(self) -> None:
        """Count anew: there was nothing to see."""
        self._held = 0


def _apart(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


class Findings:
    """Looks at the filters ten times a second, and says what is new and has held.

    Once a sample: :meth:`look`. Nothing of a flight depends on it.
    """

    PERIOD, HOLD, PAUSE = 0.1, 0.5, 0.3
    """Time between two looks, for which something must have held, and at least between two lines [s]."""
    CHANGE = 0.3
    """A lambda that differs less from what was said is no news [-]."""
    SURE_SD = 0.15
    """A lambda that is known less well than this says nothing [-]."""
    SDS = 3.0
    """And it must differ by so many standard deviations."""
    END_CHANGE = math.radians(1.5)
    """An end of a range that differs less from what was said is no news [rad]."""

    def __init__(self, found: Effectiveness, dt: float = DT) -> None:
        self._found, self._dt = found, dt
        self._period = max(round(self.PERIOD / dt), 1)
        self._needed = round(self.HOLD / self.PERIOD)
        self._samples = self._pause = 0
        self._commands = _Fact((0.0, 0.0, 0.0))
        self._effects = [_Fact((1.0,)) for _ in range(N_ACTION)]

    def look(self) -> str:
        """Look again where it is time to; return what is new, in words, or nothing."""
        self._samples += 1
        if self._samples % self._period:
            return ""
        self._pause -= 1
        news = self._news() if self._found.known else ""
        return f"found: {news}" if news else ""

    def suspected(self) -> str:
        """Return in words what is believed from this sample on."""
        return f"suspected: {self._believed()}"

    def _believed(self) -> str:
        found, surface = self._found, self._found.limited
        if surface is not None and found.ranges:
            return describe_range(surface, found.ranges.of[surface])
        return describe(found.hypotheses[found.evidence.believed], self._dt)

    def _news(self) -> str:
        """Return the first thing that is new; what else there is waits for the next line."""
        found, may_say = self._found, self._pause <= 0
        limited, moving = found.limited, found.uncommanded
        ends = found.ranges.of[limited].ends if limited is not None and found.ranges else (0.0, 0.0)
        now: tuple[float, ...] = (float(found.evidence.believed), *ends)  # another hypothesis is 1 away or more
        news = ""
        if self._commands.held(now, self.END_CHANGE) >= self._needed and may_say:
            self._commands.said = now
            news = self._believed()
        for surface, (effect, sd) in enumerate(zip(found.effectiveness.tolist(), found.sd.tolist(), strict=True)):
            fact = self._effects[surface]
            if surface in (limited, moving) or not sd < self.SURE_SD:  # the filter's place holds something else
                fact.forget()
            elif fact.held((effect,), max(self.CHANGE, self.SDS * sd)) >= self._needed and may_say and not news:
                fact.said = (effect,)
                news = describe_effect(surface, effect)
        if news:
            self._pause = round(self.PAUSE / self.PERIOD)
        return news
