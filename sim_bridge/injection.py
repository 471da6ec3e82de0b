"""MAV_CMD_INJECT_FAILURE as faults: what the standard command can say, at fixed magnitudes.

The command knows a unit, a type of failure and an instance, but no magnitude, angle, ramp or end; a flight's own
description says more. What cannot be mapped is refused as unsupported.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.faults import (
    AnyFault,
    Effectiveness,
    Engine,
    Jam,
    Latency,
    RateLimit,
    SensorNoise,
    SensorStuck,
    SurfaceName,
)
from sim_bridge.sensors import SignalName

SURFACES: tuple[SurfaceName, ...] = ("elevator", "aileron", "rudder")
"""Servo instances 1, 2, 3."""
GYROS: tuple[SignalName, ...] = ("p", "q", "r")
"""Gyroscope instances 1, 2, 3."""
SLOW_DEG_S = 5.0
"""Rate of a slow servo [deg/s]."""
DELAY = 0.1
"""Delay of a delayed servo [s]."""
GARBAGE_SD = 0.05
"""Noise of a gyroscope that delivers garbage [rad/s]."""

SERVO, MOTOR, GYRO = (
    mavlink.FAILURE_UNIT_SYSTEM_SERVO,
    mavlink.FAILURE_UNIT_SYSTEM_MOTOR,
    mavlink.FAILURE_UNIT_SENSOR_GYRO,
)
INSTANCES = {SERVO: 3, MOTOR: 2, GYRO: 3}
"""How many each unit has; the motors are left and right."""


Part = tuple[int, int]
"""A unit and an instance."""


class Injection(NamedTuple):
    """What a command asks for."""

    result: int
    """MAV_RESULT of the acknowledgement."""
    failures: dict[Part, AnyFault | None]
    """Of each part that is meant: what is wrong with it from now on; None when it is well again."""


def read_injection(message: mavlink.MAVLink_command_long_message, start: float) -> Injection:
    """Return what a COMMAND_LONG asks for, from ``start`` [s] of the flight on; never raises."""
    if message.command != mavlink.MAV_CMD_INJECT_FAILURE:
        return Injection(mavlink.MAV_RESULT_UNSUPPORTED, {})
    unit, kind = _whole(message.param1), _whole(message.param2)
    instance = 0 if math.isnan(message.param3) else _whole(message.param3)
    if unit is None or kind is None or instance is None:
        return Injection(mavlink.MAV_RESULT_DENIED, {})
    if unit not in INSTANCES:
        return Injection(mavlink.MAV_RESULT_UNSUPPORTED, {})
    if not 0 <= instance <= INSTANCES[unit]:
        return Injection(mavlink.MAV_RESULT_DENIED, {})
    instances = (instance,) if instance else tuple(range(1, INSTANCES[unit] + 1))
    failures = {(unit, i): _fault(unit, kind, i, start) for i in instances}
    if kind != mavlink.FAILURE_TYPE_OK and None in failures.values():
        return Injection(mavlink.MAV_RESULT_UNSUPPORTED, {})
    return Injection(mavlink.MAV_RESULT_ACCEPTED, failures)


def _whole(value: float) -> int | None:
    """Return a parameter as the integer that it stands for; None when it is none."""
    return int(value) if math.isfinite(value) and value == int(value) else None


def _fault(unit: int, kind: int, instance: int, start: float) -> AnyFault | None:
    """Return the fault of one instance; None when there is none of this type."""
    if unit == MOTOR:
        if kind != mavlink.FAILURE_TYPE_OFF:
            return None
        return Engine(start=start, left=float(instance != 1), right=float(instance != 2))
    if unit == GYRO:
        signal = GYROS[instance - 1]
        if kind == mavlink.FAILURE_TYPE_STUCK:
            return SensorStuck(start=start, signal=signal)
        if kind == mavlink.FAILURE_TYPE_GARBAGE:
            return SensorNoise(start=start, signal=signal, sd=GARBAGE_SD)
        return None
    surface = SURFACES[instance - 1]
    faults: dict[int, AnyFault] = {
        mavlink.FAILURE_TYPE_OFF: Effectiveness(start=start, surface=surface, factor=0.0),
        mavlink.FAILURE_TYPE_STUCK: Jam(start=start, surface=surface),
        mavlink.FAILURE_TYPE_WRONG: Effectiveness(start=start, surface=surface, factor=-1.0),
        mavlink.FAILURE_TYPE_SLOW: RateLimit(start=start, surface=surface, rate_deg_s=SLOW_DEG_S),
        mavlink.FAILURE_TYPE_DELAYED: Latency(start=start, surface=surface, seconds=DELAY),
    }
    return faults.get(kind)
