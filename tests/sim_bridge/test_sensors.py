"""Sensors: ideal by default, noise, bias, delay, stuck readings, and what faults add."""

import numpy as np
import pytest

from sim_bridge.presets import R3_SENSORS
from sim_bridge.sensors import Sensors, SensorSettings
from task.state import STATE

IDEAL = SensorSettings()


def sensors(settings: SensorSettings = IDEAL, seed: int = 1) -> Sensors:
    return Sensors(settings, np.random.default_rng(seed))


def states(count: int) -> np.ndarray:
    return np.arange(count)[:, None] + np.linspace(0.0, 0.9, 12)


def test_ideal_sensors_return_the_state_itself() -> None:
    x = states(1)[0]
    assert sensors().measure(x) is x


def test_noise_and_bias_have_the_stated_size() -> None:
    readings = np.array([device.measure(np.zeros(12)).copy() for device in [sensors(R3_SENSORS)] for _ in range(20000)])
    assert readings[:, STATE.q].std() == pytest.approx(6.3e-4, rel=0.03)
    assert readings[:, STATE.q].mean() == pytest.approx(3e-5, abs=2e-5)
    assert readings[:, STATE.theta].std() == pytest.approx(3.2e-5, rel=0.03)
    assert readings[:, STATE.theta].mean() == pytest.approx(4e-3, abs=1e-5)
    assert readings[:, STATE.alpha].std() == pytest.approx(2e-5, rel=0.03)
    assert (readings[:, [STATE.V, STATE.beta, STATE.psi, STATE.h]] == 0.0).all()
    independent = np.corrcoef(readings[:, [STATE.p, STATE.q, STATE.r]].T) - np.eye(3)
    assert np.abs(independent).max() < 0.03


def test_noise_is_seeded_and_one_signal_does_not_change_another() -> None:
    two = SensorSettings(noise={"p": 0.1, "q": 0.1})
    one = SensorSettings(noise={"q": 0.1})
    x = np.zeros(12)
    a, b, c = (sensors(s, seed).measure(x) for s, seed in ((two, 4), (one, 4), (two, 5)))
    assert a[STATE.q] == b[STATE.q] != c[STATE.q]


def test_delay() -> None:
    device = sensors(SensorSettings(delay=0.03))
    readings = [device.measure(x)[STATE.p] for x in states(10)]
    assert readings == [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_a_second_delay_knows_nothing_of_the_first() -> None:
    device = sensors(SensorSettings(bias={"V": 1.0}))  # never ideal
    x = states(40)
    device.impair({}, {}, 0.03, set())
    for k in range(10):
        device.measure(x[k])
    device.impair({}, {}, 0.0, set())
    for k in range(10, 30):
        assert device.measure(x[k])[STATE.p] == k
    device.impair({}, {}, 0.03, set())
    assert [device.measure(x[k])[STATE.p] for k in range(30, 36)] == [30.0, 30.0, 30.0, 30.0, 31.0, 32.0]


def test_stuck_keeps_the_last_value_and_comes_loose() -> None:
    device = sensors(SensorSettings(bias={"q": 0.5}))
    x = states(5)
    before = device.measure(x[0])[STATE.q]
    device.impair({}, {}, 0.0, {int(STATE.q)})
    assert [device.measure(x[k])[STATE.q] for k in (1, 2)] == [before, before]
    assert device.measure(x[3])[STATE.p] == x[3, STATE.p]
    device.impair({}, {}, 0.0, set())
    assert device.measure(x[4])[STATE.q] == x[4, STATE.q] + 0.5


def test_faults_add_to_the_settings_and_leave_them_when_they_end() -> None:
    device = sensors(SensorSettings(noise={"p": 0.3}, bias={"V": 1.0}))
    device.impair({int(STATE.p): 0.4}, {int(STATE.V): 2.0}, 0.0, set())
    readings = np.array([device.measure(np.zeros(12)) for _ in range(5000)])
    assert readings[:, STATE.p].std() == pytest.approx(0.5, rel=0.05)
    assert readings[0, STATE.V] == 3.0
    device.impair({}, {}, 0.0, set())
    readings = np.array([device.measure(np.zeros(12)) for _ in range(5000)])
    assert readings[:, STATE.p].std() == pytest.approx(0.3, rel=0.05)
    assert readings[0, STATE.V] == 1.0
