"""The way from a commanded deflection to the deflection that the air feels.

For each surface, in this order: latency, bandwidth, rate limit, stops, jam, oscillation; then the mixing of all
three into their effect. Nothing of this is in the nominal aircraft, whose surfaces follow their commands at once.
The reference's yaw damper adds to the rudder behind all of it and keeps working when the rudder jams.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from task.state import N_ACTION

FREE_STOP = math.radians(30.0)
"""Where a ramp to tighter stops begins [rad]: beyond any command."""


class Jammed(NamedTuple):
    """One jam of a surface."""

    share: float
    """0 free .. 1 jammed."""
    angle: float | None = None
    """[rad]; None: where it was when the jam began."""
    since: float = 0.0
    """When it began [s]; tells a surface's jams apart."""


@dataclass
class Surface:
    """What is wrong with one surface's actuator; the defaults are a healthy one."""

    latency: float = 0.0
    """[s]"""
    time_constant: float = 0.0
    """Of a first-order lag [s]."""
    rate_limit: float = math.inf
    """[rad/s]"""
    minimum: float = -math.inf
    """Stop [rad]."""
    maximum: float = math.inf
    """Stop [rad]."""
    jams: list[Jammed] = field(default_factory=list)
    """Each takes the surface away from where those before it leave it."""
    oscillation: float = 0.0
    """Amplitude [rad]."""
    oscillation_frequency: float = 0.0
    """[Hz]"""
    oscillation_start: float = 0.0
    """Time of its zero phase [s]."""
    oscillation_replaces: bool = False
    """The oscillation replaces the deflection (a solid failure) instead of adding to it (a liquid one)."""


_HEALTHY = Surface()


@dataclass
class _Memory:
    """What one actuator remembers."""

    position: float
    """Output of lag, rate limit and stops [rad]."""
    held: dict[float, float] = field(default_factory=dict)
    """Deflection at which each jam found it [rad], by the time at which the jam began [s]."""
    waiting: list[float] = field(default_factory=list)
    """Commands on their way, oldest first."""


class Actuators:
    """Three actuators; inactive, and free of cost, until a fault touches them."""

    def __init__(self, dt: float) -> None:
        """Start healthy; dt [s] is the time between two calls of :meth:`respond`."""
        self._dt = dt
        self._deflection = [0.0] * N_ACTION
        self.clear()

    def clear(self) -> None:
        """Make everything healthy and forget the past."""
        self.active = False
        """Whether anything is wrong: only then must commands pass through :meth:`respond`."""
        self._surfaces = [Surface() for _ in range(N_ACTION)]
        self._mixing = np.eye(N_ACTION).tolist()
        self._memory: list[_Memory] = []

    @property
    def deflection(self) -> list[float]:
        """Physical deflections [rad] after the last :meth:`respond`, before the mixing."""
        return self._deflection

    def configure(self, surfaces: list[Surface], mixing: np.ndarray, position: list[float]) -> None:
        """Set what is wrong from now on.

        mixing (3, 3): effect of each deflection (column) as elevator, aileron and rudder (row). position (3,):
        where the surfaces are now [rad]; only used when the actuators were healthy until now.
        """
        was_active = self.active
        self.active = any(surface != _HEALTHY for surface in surfaces) or not np.array_equal(mixing, np.eye(N_ACTION))
        if not self.active:
            self.clear()
            return
        if not was_active:
            self._memory = [_Memory(p) for p in position]
            self._deflection = list(position)
        for surface, memory, deflection in zip(surfaces, self._memory, self._deflection, strict=True):
            memory.held = {jam.since: memory.held.get(jam.since, deflection) for jam in surface.jams}
        self._surfaces, self._mixing = surfaces, mixing.tolist()

    def respond(self, command: list[float], time: float) -> list[float]:
        """Return the effective deflections (3,) [rad] of commands (3,) [rad] given at ``time`` [s]; advances by dt."""
        self._deflection = [
            self._move(surface, memory, value, time)
            for surface, memory, value in zip(self._surfaces, self._memory, command, strict=True)
        ]
        elevator, aileron, rudder = self._deflection
        return [row[0] * elevator + row[1] * aileron + row[2] * rudder for row in self._mixing]

    def _move(self, surface: Surface, memory: _Memory, command: float, time: float) -> float:
        value = self._arrived(surface, memory, command)
        if surface.time_constant > 0.0:
            keep = math.exp(-self._dt / surface.time_constant)
            value = keep * memory.position + (1.0 - keep) * value
        step = surface.rate_limit * self._dt
        value = min(max(value, memory.position - step), memory.position + step)
        value = min(max(value, surface.minimum), surface.maximum)
        memory.position = value
        for jam in surface.jams:
            angle = memory.held[jam.since] if jam.angle is None else jam.angle
            value += jam.share * (angle - value)
        if surface.oscillation > 0.0:
            wave = math.sin(2.0 * math.pi * surface.oscillation_frequency * (time - surface.oscillation_start))
            value = surface.oscillation * wave + (0.0 if surface.oscillation_replaces else value)
        return value

    def _arrived(self, surface: Surface, memory: _Memory, command: float) -> float:
        """Return the command that arrives now.

        A delay that begins or grows repeats the oldest command on its way until the queue is as long as the delay;
        one that shrinks skips to the newer ones.
        """
        waiting = memory.waiting
        length = round(surface.latency / self._dt)
        if length == 0:
            waiting.clear()
            return command
        if not waiting:
            waiting.append(memory.position)
        waiting.append(command)
        missing = length + 1 - len(waiting)
        if missing > 0:
            waiting[:0] = [waiting[0]] * missing
        del waiting[: -length - 1]
        return waiting[0]
