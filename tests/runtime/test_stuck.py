"""Sensors that stand still."""

import numpy as np
import pytest

from runtime.structured import Effectiveness
from runtime.stuck import Stuck
from task.limits import DT
from task.state import STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, state, watch


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("signal", [STATE.p, STATE.q, STATE.r])
def test_a_stuck_gyro_is_no_dead_surface_and_the_attitude_tells_the_rate_instead(noise, signal):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    pulling = aircraft.command
    aircraft.command = lambda: np.add(pulling(), (0.02, 0.0, 0.0))  # attitudes stay small
    watch(found, aircraft, 500)
    aircraft.stuck = {int(signal): None}
    watch(found, aircraft, 400)
    assert [i for i, stuck in enumerate(found.stuck.signals) if stuck] == [signal]
    np.testing.assert_allclose(found.believed, 1.0, atol=0.15)
    np.testing.assert_allclose(found.rates, aircraft.w, atol=0.02)
    x = aircraft.read()
    mended = found.mended(x)
    assert mended[signal] == found.rates[signal]
    assert (np.delete(mended, signal) == np.delete(x, signal)).all()
    aircraft.stuck = {}
    watch(found, aircraft, 100)
    assert not found.stuck.any
    assert found.mended(x) is x
    aircraft.effect = np.array([-1.0, -1.0, 1.0])
    watch(found, aircraft, 100)
    np.testing.assert_allclose(found.effectiveness[:2], -1.0, atol=0.2)


def test_symmetric_flight_is_no_stuck_sensor_and_an_angle_of_attack_that_stands_still_is():
    stuck = Stuck(DT)
    for k in range(20):  # roll, yaw and sideslip at rest, though the model has them move
        assert not stuck.look(state((0.0, 0.01 * k, 0.0), alpha=0.05 + 1e-3 * k).tolist(), [1e-3, 1e-3, 1e-3], 1e-4)
    told = [
        stuck.look(state((1e-3 * k, 0.1 + 1e-6 * k, 1e-3 * k), beta=k).tolist(), [0.0] * 3, 1e-4) for k in range(20)
    ]
    assert told.index(True) == 5  # 0.1 rad/s turn the body by 5 mrad in five samples
    assert stuck.signals == [False, False, False, True, False]
