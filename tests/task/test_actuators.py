"""Actuators: range first, then rate, each surface its own."""

from __future__ import annotations

import numpy as np

from task.actuators import ACTUATOR, HEALTHY, limited
from task.limits import DEFLECTION_LIMIT, DT
from task.state import ACTION


def actuators(**of: tuple[float, float, float]) -> np.ndarray:
    table = HEALTHY.copy()
    for surface, limits in of.items():
        table[:, ACTION[surface]] = limits
    return table


def test_healthy_actuators_follow_every_command_that_may_be_given():
    rng = np.random.default_rng(0)
    commands = rng.uniform(-DEFLECTION_LIMIT, DEFLECTION_LIMIT, (50, 3)).astype(np.float32)
    np.testing.assert_array_equal(limited(commands, -commands, HEALTHY.astype(np.float32)), commands)
    np.testing.assert_array_equal(limited(np.full(3, 7.0), np.zeros(3), HEALTHY), np.full(3, DEFLECTION_LIMIT))


def test_range_and_rate_of_each_surface_by_hand():
    table = actuators(de=(-0.02, 0.01, np.inf), da=(-0.1, 0.1, 0.5), dr=(0.03, 0.03, np.inf))
    acting = limited(np.array([0.1, -0.1, -0.1]), np.zeros(3), table)
    np.testing.assert_allclose(acting, [0.01, -0.5 * DT, 0.03], rtol=0, atol=1e-15)
    assert table[ACTUATOR.rate, ACTION.da] == 0.5


def test_the_range_comes_first_and_a_surface_beyond_it_returns_at_its_rate():
    table = actuators(da=(-0.02, 0.02, 1.0))
    beyond = np.array([0.0, 0.05, 0.0])
    assert limited(np.array([0.0, -0.1, 0.0]), beyond, table)[ACTION.da] == 0.05 - DT
    assert limited(np.array([0.0, 0.1, 0.0]), beyond, table)[ACTION.da] == 0.05 - DT


def test_many_at_once_are_each_of_them():
    rng = np.random.default_rng(1)
    table = actuators(de=(-0.01, 0.02, 0.7), da=(-0.1, 0.1, 0.5))
    commands, before = rng.uniform(-0.2, 0.2, (2, 4, 5, 3))
    together = limited(commands, before, table)
    for place in np.ndindex(4, 5):
        np.testing.assert_array_equal(together[place], limited(commands[place], before[place], table))


def test_nobody_changes_what_healthy_means():
    assert not HEALTHY.flags.writeable
