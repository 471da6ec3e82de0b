"""Actuators: latency, bandwidth, rate, stops, jam, oscillation, mixing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_bridge.actuators import Actuators, Jammed, Surface

DT = 0.01
IDENTITY = np.eye(3)


def elevator(broken: Surface, position: float = 0.0) -> Actuators:
    actuators = Actuators(DT)
    actuators.configure([broken, Surface(), Surface()], IDENTITY, [position, 0.0, 0.0])
    return actuators


def outputs(actuators: Actuators, commands: list[float]) -> list[float]:
    return [actuators.respond([c, 0.0, 0.0], k * DT)[0] for k, c in enumerate(commands)]


def test_healthy_is_inactive() -> None:
    assert not elevator(Surface()).active


@pytest.mark.parametrize("samples", [1, 5, 20])
def test_latency_delays_by_samples_and_holds_until_then(samples: int) -> None:
    commands = [0.01 * (k + 1) for k in range(50)]
    out = outputs(elevator(Surface(latency=samples * DT), position=-0.3), commands)
    assert out[:samples] == [-0.3] * samples
    assert out[samples:] == commands[: 50 - samples]


def test_latency_that_grows_holds_and_one_that_shrinks_skips() -> None:
    actuators = elevator(Surface(latency=2 * DT))
    out = outputs(actuators, [1.0, 2.0, 3.0, 4.0])
    assert out == [0.0, 0.0, 1.0, 2.0]
    actuators.configure([Surface(latency=4 * DT), Surface(), Surface()], IDENTITY, [0.0] * 3)
    assert outputs(actuators, [5.0, 6.0, 7.0, 8.0]) == [2.0, 2.0, 3.0, 4.0]
    actuators.configure([Surface(latency=1 * DT), Surface(), Surface()], IDENTITY, [0.0] * 3)
    assert outputs(actuators, [9.0, 10.0]) == [8.0, 9.0]


def test_bandwidth_is_a_first_order_lag() -> None:
    out = outputs(elevator(Surface(time_constant=0.2)), [1.0] * 40)
    assert out[19] == pytest.approx(1.0 - math.exp(-1.0), abs=1e-9)


def test_rate_limit() -> None:
    out = outputs(elevator(Surface(rate_limit=0.5)), [1.0] * 10)
    assert np.diff([0.0, *out]) == pytest.approx(0.005)


def test_jam_where_it_is_and_at_an_angle() -> None:
    actuators = elevator(Surface(rate_limit=1.0))
    outputs(actuators, [1.0] * 5)
    actuators.configure([Surface(rate_limit=1.0, jams=[Jammed(1.0)]), Surface(), Surface()], IDENTITY, [0.0] * 3)
    assert outputs(actuators, [0.2, -0.4]) == pytest.approx([0.05, 0.05])
    assert outputs(elevator(Surface(jams=[Jammed(1.0, 0.26)])), [1.0, -1.0]) == [0.26, 0.26]
    assert outputs(elevator(Surface(jams=[Jammed(0.5, 0.2)])), [0.0]) == [0.1]


def test_oscillation_adds_or_replaces() -> None:
    wave = [0.1 * math.sin(2.0 * math.pi * 2.0 * k * DT) for k in range(30)]
    swinging = Surface(oscillation=0.1, oscillation_frequency=2.0)
    assert outputs(elevator(swinging), [0.3] * 30) == pytest.approx([0.3 + w for w in wave])
    swinging.oscillation_replaces = True
    assert outputs(elevator(swinging), [0.3] * 30) == pytest.approx(wave)


def test_mixing_crosses_effects_and_leaves_deflections() -> None:
    actuators = Actuators(DT)
    crossed = np.array([[-0.5, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    actuators.configure([Surface() for _ in range(3)], crossed, [0.0] * 3)
    assert actuators.respond([0.2, 0.1, -0.3], 0.0) == pytest.approx([-0.1, -0.3, 0.1])
    assert actuators.deflection == [0.2, 0.1, -0.3]


@settings(max_examples=60, deadline=None)
@given(
    commands=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60),
    latency=st.integers(0, 8),
    lag=st.floats(0.0, 0.5),
    rate=st.floats(0.01, 5.0),
    low=st.floats(-0.5, 0.0),
    high=st.floats(0.0, 0.5),
)
def test_combined_faults_stay_within_stops_and_rate(
    commands: list[float], latency: int, lag: float, rate: float, low: float, high: float
) -> None:
    broken = Surface(latency=latency * DT, time_constant=lag, rate_limit=rate, minimum=low, maximum=high)
    out = np.array([0.0, *outputs(elevator(broken), commands)])
    assert (out >= low).all()
    assert (out <= high).all()
    assert np.abs(np.diff(out)).max() <= rate * DT + 1e-12


@pytest.mark.parametrize("command", [math.nan, math.inf, -math.inf])
def test_any_command_gives_numbers_back(command: float) -> None:
    broken = Surface(latency=0.03, time_constant=0.1, rate_limit=1.0, minimum=-0.1, maximum=0.1)
    assert len(outputs(elevator(broken), [command] * 10)) == 10
