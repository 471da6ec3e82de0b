"""Failures that a ground station asks for."""

from __future__ import annotations

import math
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sim_bridge.bridge import Bridge
from sim_bridge.exchange import TICK_US
from sim_bridge.faults import Effectiveness, Engine, Jam, SensorStuck
from sim_bridge.flight import Flight
from sim_bridge.injection import read_injection
from sim_bridge.link import Link
from sim_bridge.world import MOST_INJECTED, World
from task.state import ACTION

ACCEPTED, DENIED, UNSUPPORTED, REJECTED = 0, 2, 3, 1
SERVO, MOTOR, GYRO = 102, 101, 0
OK, OFF, STUCK, GARBAGE, WRONG = range(5)


def order(unit: float, kind: float, instance: float = math.nan, command: int = 420, system: int = 1):
    """Return the command as a client sends it: what it does not use is NaN."""
    return mavlink.MAVLink_command_long_message(system, 1, command, 0, unit, kind, instance, *[math.nan] * 4)


@pytest.mark.parametrize(
    ("command", "faults"),
    [
        (order(SERVO, STUCK, 3), [Jam(start=2.0, surface="rudder")]),
        (order(SERVO, WRONG, 1), [Effectiveness(start=2.0, surface="elevator", factor=-1.0)]),
        (order(MOTOR, OFF, 1), [Engine(start=2.0, left=0.0)]),
        (order(GYRO, STUCK), [SensorStuck(start=2.0, signal=s) for s in "pqr"]),
    ],
)
def test_what_can_be_said_becomes_a_fault(command, faults):
    result, failures = read_injection(command, 2.0)
    assert result == ACCEPTED
    assert list(failures.values()) == faults


@pytest.mark.parametrize(
    ("command", "result"),
    [
        (order(SERVO, GARBAGE, 1), UNSUPPORTED),
        (order(100, OFF), UNSUPPORTED),
        (order(SERVO, OFF, 4), DENIED),
        (order(SERVO, OFF, -1), DENIED),
        (order(math.nan, OFF), DENIED),
        (order(1.5, OFF), DENIED),
        (order(SERVO, STUCK, 1, command=400), UNSUPPORTED),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_breaks(command, result):
    assert read_injection(command, 0.0) == (result, {})


@given(st.tuples(*[st.floats(width=32)] * 3))
def test_no_number_makes_it_raise(parameters):
    assert read_injection(order(*parameters), 1.0).result in (ACCEPTED, DENIED, UNSUPPORTED)


def test_a_part_is_broken_broken_otherwise_and_mended():
    world = World(Flight())
    trim = world.trim_action[ACTION.de]

    def elevator(offset: float, ticks: int = 10) -> np.ndarray:
        """Return where the elevator is under a command this far from trim."""
        rows = []
        for _ in range(ticks):
            world.step(world.trim_action + np.array([offset, 0.0, 0.0]))
            rows.append(world.surfaces[ACTION.de])
        return np.array(rows)

    assert elevator(0.01)[-1] == pytest.approx(trim + 0.01)
    assert world.inject(order(SERVO, STUCK, 1)) == ACCEPTED
    elevator(0.01, ticks=2)
    np.testing.assert_allclose(elevator(-0.03), trim + 0.01, atol=1e-12)
    assert world.inject(order(SERVO, WRONG, 1)) == ACCEPTED
    assert elevator(-0.03)[-1] == pytest.approx(trim - 0.03)
    assert world.fault_levels == [0.0, 1.0]
    assert world.inject(order(SERVO, OK)) == ACCEPTED
    elevator(0.0)
    assert world.fault_levels == [0.0, 0.0]


def test_a_flood_of_failures_has_an_end():
    world = World(Flight())
    results = [world.inject(order(SERVO, STUCK, 1)) for _ in range(MOST_INJECTED + 5)]
    assert results == [ACCEPTED] * MOST_INJECTED + [REJECTED] * 5


def test_what_a_flood_broke_can_be_mended():
    world = World(Flight())
    for _ in range(MOST_INJECTED):
        world.inject(order(SERVO, STUCK, 1))
    assert world.inject(order(SERVO, OK)) == ACCEPTED
    world.step(world.trim_action)
    assert world.fault_levels == [0.0] * MOST_INJECTED
    assert world.inject(order(SERVO, STUCK, 1)) == REJECTED


def test_a_command_over_the_link_is_acknowledged_recorded_and_felt(peer_factory):
    sender = mavlink.MAVLink(None, 255, 190)

    def script(peer, time_us):
        others = [order(SERVO, STUCK, 1, system=2).pack(sender)] if time_us == 5 * TICK_US else []
        failure = [order(SERVO, OFF, 3).pack(sender)] if time_us == 10 * TICK_US else []
        return [*others, *failure, peer.plain(time_us)]

    peer = peer_factory(script=script)
    with Link(peer.link) as link:
        bridge = Bridge(Flight(duration=0.3), link)
        assert bridge.fly().outcome == "complete"
    time.sleep(0.05)
    assert peer.acks == [struct.pack("<HB", 420, ACCEPTED)]
    truth = bridge.truth.arrays()
    assert truth["faults"][:, 0].tolist() == [0.0] * 11 + [1.0] * 20
    assert truth["fault_names"].tolist() == ["effectiveness rudder factor 0"]
