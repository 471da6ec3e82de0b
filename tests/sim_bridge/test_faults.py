"""Faults: levels over time, each mechanism on the plant, combinations, and the nominal aircraft once they end."""

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_bridge import presets
from sim_bridge.faults import AnyFault, CGShift, Crossed, Effectiveness, Engine, Gust, Icing, Jam, Mixing, Saturation
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from sim_bridge.sensors import Sensors, SensorSettings
from task.config import Settings, convert
from task.errors import UserError
from task.limits import DT
from task.state import ACTION, STATE

EVERY_KIND: list[dict[str, Any]] = [
    {"kind": "effectiveness", "surface": "elevator", "factor": -0.3},
    {"kind": "mixing", "matrix": [[1, 0, 0], [0, 0.5, 0.5], [0, 0.5, 0.5]]},
    {"kind": "crossed"},
    {"kind": "jam", "surface": "rudder", "angle_deg": 5.0},
    {"kind": "jam", "surface": "aileron"},
    {"kind": "saturation", "surface": "aileron", "min_deg": -1.0, "max_deg": 1.0},
    {"kind": "rate_limit", "surface": "elevator", "rate_deg_s": 5.0},
    {"kind": "bandwidth", "surface": "elevator", "hz": 1.0},
    {"kind": "latency", "seconds": 0.1},
    {"kind": "latency", "seconds": 0.05, "surface": "rudder"},
    {"kind": "oscillation", "surface": "elevator", "amplitude_deg": 1.0, "hz": 1.5},
    {"kind": "cg_shift", "aft": 0.25},
    {"kind": "icing"},
    {"kind": "gust", "down": 3.0, "north": 1.0, "shape": "cosine"},
    {"kind": "engine", "left": 0.0},
    {"kind": "yaw_damper_off"},
    {"kind": "sensor_noise", "signal": "q", "sd": 0.01},
    {"kind": "sensor_bias", "signal": "theta", "bias": 0.01},
    {"kind": "sensor_delay", "seconds": 0.04},
    {"kind": "sensor_stuck", "signal": "alpha"},
]
EFFECTS = (
    "inertia/pointmass-location-X-inches",
    "icing/drag-coefficient",
    "icing/alpha-max-rad",
    "propulsion/left-thrust-fraction",
    "propulsion/right-thrust-fraction",
    "fcs/yaw-damper-on",
    "atmosphere/gust-north-fps",
    "atmosphere/gust-east-fps",
    "atmosphere/gust-down-fps",
)


class Flight(Settings, frozen=True):
    faults: tuple[AnyFault, ...] = ()


def fault(**settings: Any) -> AnyFault:
    return convert({"faults": [settings]}, Flight, "test").faults[0]


@functools.cache
def shared_plant() -> Plant:
    return Plant()


@pytest.fixture(scope="module")
def plant() -> Plant:
    return shared_plant()


def fly(
    plant: Plant, faults: tuple[AnyFault, ...], steps: int, push: tuple[float, float, float] = (0, 0, 0)
) -> np.ndarray:
    schedule = FaultSchedule(faults)
    plant.reset()
    action = plant.trim.action + np.array(push)
    states = []
    for k in range(steps):
        schedule.apply(plant, k * DT)
        states.append(plant.step(action).copy())
    return np.array(states)


def properties(plant: Plant) -> list[float]:
    return [plant._fdm[name] for name in EFFECTS]


def test_level_over_time() -> None:
    timed = CGShift(aft=1.0, start=2.0, end=10.0, ramp=4.0)
    levels = [timed.level(t) for t in (0.0, 1.999, 2.0, 3.0, 6.0, 9.99, 10.0, 13.0, 14.0, 99.0)]
    assert levels == pytest.approx([0.0, 0.0, 0.0, 0.25, 1.0, 1.0, 1.0, 0.25, 0.0, 0.0])
    sudden = CGShift(aft=1.0, start=20.0)
    assert [sudden.level(t) for t in (19.99, 20.0, 1e6)] == [0.0, 1.0, 1.0]


def test_level_is_not_fooled_by_rounded_times() -> None:
    sudden = CGShift(aft=1.0, start=0.3, end=0.7)
    levels = [sudden.level(k * DT) for k in range(100)]
    assert levels.index(1.0) == 30
    assert sum(levels) == 40.0


@settings(max_examples=100, deadline=None)
@given(start=st.floats(0, 5), length=st.floats(0, 5), ramp=st.just(0.0) | st.floats(1e-3, 3), time=st.floats(0, 20))
def test_level_stays_between_nothing_and_all(start: float, length: float, ramp: float, time: float) -> None:
    timed = CGShift(aft=1.0, start=start, end=start + ramp + length, ramp=ramp)
    assert 0.0 <= timed.level(time) <= 1.0
    change = timed.next_change(time)
    assert change >= time
    if np.isfinite(change) and change - time > 1e-6:
        assert timed.level(0.5 * (time + change)) == pytest.approx(timed.level(time), abs=1e-6)


@pytest.mark.parametrize("settings", EVERY_KIND, ids=lambda s: s["kind"])
def test_every_kind_does_something_and_ends_without_a_trace(plant: Plant, settings: dict[str, Any]) -> None:
    def flown(faults: tuple[AnyFault, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return states and the errors of their readings, (120, 12) each, under lively commands."""
        sensors = Sensors(SensorSettings(), np.random.default_rng(0))
        schedule = FaultSchedule(faults)
        plant.reset()
        states, errors = [], []
        for k in range(120):
            schedule.apply(plant, k * DT, sensors)
            errors.append(sensors.measure(plant.x) - plant.x)
            states.append(plant.x.copy())
            plant.step(plant.trim.action + 0.08 * np.sin([0.2 * k, 0.25 * k, 0.3 * k]))
        assert sensors.measure(plant.x) is plant.x
        assert not plant.actuators.active
        return np.array(states), np.array(errors)

    nominal, no_errors = flown(())
    healthy = properties(plant)
    states, errors = flown((fault(**settings, start=0.1, end=0.5, ramp=0.1),))
    assert (states[:12] == nominal[:12]).all(), "nothing before it starts"
    assert (states != nominal).any() or (errors != no_errors).any(), "it changes the flight or the readings"
    assert properties(plant) == healthy


@settings(max_examples=15, deadline=None)
@given(chosen=st.lists(st.sampled_from(EVERY_KIND), min_size=2, max_size=6), data=st.data())
def test_any_combination_flies_and_ends_without_a_trace(chosen: list[dict[str, Any]], data: st.DataObject) -> None:
    plant = shared_plant()
    plant.reset()
    healthy = properties(plant)
    faults = []
    for settings_ in chosen:
        start = data.draw(st.integers(0, 20)) * DT
        ramp = data.draw(st.integers(0, 10)) * DT
        faults.append(fault(**settings_, start=start, end=start + ramp + 0.2, ramp=ramp))
    assert np.isfinite(fly(plant, tuple(faults), 80)).all()
    assert properties(plant) == healthy
    assert not plant.actuators.active


def test_schedule_is_deterministic_and_starts_over(plant: Plant) -> None:
    faults = (Icing(start=0.1, ramp=0.3), Gust(start=0.2, end=0.4, down=5.0, ramp=0.1, shape="cosine"))
    one = fly(plant, faults, 100)
    assert (fly(plant, faults, 100) == one).all()
    schedule = FaultSchedule(faults)
    schedule.apply(plant, 5.0)
    assert schedule.levels[0] == 1.0
    schedule.restart()
    assert schedule.levels == [0.0, 0.0]


def test_ramp_values_reach_the_plant(plant: Plant) -> None:
    schedule = FaultSchedule(
        (CGShift(aft=0.25, start=1.0, ramp=2.0), Gust(down=4.0, start=1.0, ramp=2.0, shape="cosine"))
    )
    plant.reset()
    for time, share in ((0.5, 0.0), (1.5, 0.25), (2.0, 0.5), (3.0, 1.0), (9.0, 1.0)):
        schedule.apply(plant, time)
        shift = plant._fdm["inertia/pointmass-location-X-inches"] * 0.0254 * 0.9
        assert shift == pytest.approx(0.25 * share)
        gust = plant._fdm["atmosphere/gust-down-fps"] * 0.3048
        assert gust == pytest.approx(4.0 * 0.5 * (1.0 - np.cos(np.pi * share)))


def test_cg_shift_moves_the_centre_of_gravity(plant: Plant) -> None:
    fly(plant, (CGShift(aft=0.25),), 3)
    assert plant._fdm["inertia/cg-x-in"] * 0.0254 == pytest.approx(0.25, abs=1e-6)
    pitched = fly(plant, (CGShift(aft=0.25),), 100)[-1, STATE.q]
    assert pitched > 0.02, "aft: the nose rises"


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.3, 2.0])
def test_effectiveness_multiplies_the_first_response(plant: Plant, factor: float) -> None:
    def first_response(faults: tuple[AnyFault, ...]) -> float:
        base, pushed = (fly(plant, faults, 3, (0.0, a, 0.0))[-1, STATE.p] for a in (0.0, 0.05))
        return pushed - base

    ratio = first_response((Effectiveness(surface="aileron", factor=factor),)) / first_response(())
    assert ratio == pytest.approx(factor, abs=0.02)


def test_crossed_is_a_mixing(plant: Plant) -> None:
    matrix = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    push = (0.0, 0.03, -0.02)
    crossed = fly(plant, (Crossed(),), 100, push)
    assert (crossed == fly(plant, (Mixing(matrix=matrix),), 100, push)).all()


def test_factors_multiply_and_limits_take_the_tightest(plant: Plant) -> None:
    halves = tuple(Effectiveness(surface="elevator", factor=0.5) for _ in range(2))
    assert fly(plant, halves, 50)[-1] == pytest.approx(
        fly(plant, (Effectiveness(surface="elevator", factor=0.25),), 50)[-1]
    )
    stops = (
        Saturation(surface="rudder", min_deg=-3.0, max_deg=1.0),
        Saturation(surface="rudder", min_deg=-1.0, max_deg=4.0),
    )
    for push, stop in ((0.5, 1.0), (-0.5, -1.0)):
        fly(plant, stops, 5, (0.0, 0.0, push))
        assert np.rad2deg(plant.surfaces[ACTION.dr]) == pytest.approx(stop)


def test_presets_are_the_thesis_cases(plant: Plant) -> None:
    fly(plant, presets.F3, 5, (0.0, 0.1, 0.0))
    assert np.rad2deg(plant.surfaces[ACTION.da]) == pytest.approx(1.0)
    fly(plant, presets.F4, 5, (-0.2, 0.0, 0.0))
    assert np.rad2deg(plant.surfaces[ACTION.de]) == pytest.approx(-2.5)
    fly(plant, presets.F6, 5, (0.0, 0.0, -0.1))
    assert np.rad2deg(plant.surfaces[ACTION.dr]) == pytest.approx(15.0)
    iced, clean = fly(plant, presets.F1, 500)[-1], fly(plant, (), 500)[-1]
    assert iced[STATE.V] < clean[STATE.V] - 0.5, "ice brakes"
    gust = fly(plant, (Gust(down=4.572),), 50)[-1]
    assert gust[STATE.alpha] > clean[STATE.alpha] + 0.005, "air that sinks takes the aircraft down with it"


def test_jam_where_it_is(plant: Plant) -> None:
    plant.reset()
    schedule = FaultSchedule((Jam(surface="aileron", start=0.05),))
    for k in range(20):
        schedule.apply(plant, k * DT)
        plant.step(np.array([0.0, 0.01 * k, 0.0]))
    assert plant.surfaces[ACTION.da] == pytest.approx(0.04)


def test_a_later_jam_takes_over_from_where_the_first_holds_the_surface(plant: Plant) -> None:
    first = Jam(surface="rudder", angle_deg=15.0, start=0.05)

    def rudder(later: Jam) -> list[float]:
        """Return the rudder [deg] at every step, commanded to 1 deg."""
        plant.reset()
        schedule, found = FaultSchedule((first, later)), []
        for k in range(40):
            schedule.apply(plant, k * DT)
            plant.step(np.radians([0.0, 0.0, 1.0]))
            found.append(float(np.rad2deg(plant.surfaces[ACTION.dr])))
        return found

    stuck = rudder(Jam(surface="rudder", start=0.1))
    assert stuck == pytest.approx([1.0] * 5 + [15.0] * 35), "where it is: at the angle that the first jam gave it"
    growing = rudder(Jam(surface="rudder", angle_deg=-5.0, start=0.1, end=0.25, ramp=0.1))
    assert growing[10] == pytest.approx(15.0), "a jam that only begins to grow does not free the surface"
    assert growing[15] == pytest.approx(5.0)
    assert growing[20:25] == pytest.approx([-5.0] * 5)
    assert growing[30] == pytest.approx(5.0)
    assert growing[36:] == pytest.approx([15.0] * 4)


def test_lost_engine_yaws_towards_it_and_slows(plant: Plant) -> None:
    slow = np.array(
        [fly(plant, (Engine(left=left, right=right),), 400)[-1] for left, right in ((1, 1), (0, 1), (1, 0), (0, 0))]
    )
    assert slow[1, STATE.psi] < -1e-3
    assert slow[2, STATE.psi] == pytest.approx(-slow[1, STATE.psi], rel=1e-2)
    assert slow[3, STATE.V] < slow[1, STATE.V] < slow[0, STATE.V]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"kind": "jam", "surfac": "rudder"}, r"unknown field `surfac`"),
        ({"kind": "melt"}, r"invalid value 'melt'"),
        ({"kind": "gust", "start": 5.0, "end": 4.0}, r"expected at least start \+ ramp = 5 s, got 4"),
        ({"kind": "saturation", "surface": "rudder", "min_deg": 2.0, "max_deg": 1.0}, r"at most max_deg = 1, got 2"),
        ({"kind": "effectiveness", "surface": "rudder", "factor": float("nan")}, r"expected `float` >= -10.0, got nan"),
        ({"kind": "gust", "down": float("inf")}, r"expected `float` <= 100.0 \[m/s\], got inf"),
        ({"kind": "gust", "north": 1e6}, r"expected `float` <= 100.0 \[m/s\], got 1000000.0"),
        ({"kind": "effectiveness", "surface": "rudder", "factor": 1e300}, r"expected `float` <= 10.0, got 1e\+300"),
        ({"kind": "mixing", "matrix": [[1, 0, 0], [0, 11, 0], [0, 0, 1]]}, r"expected `float` <= 10.0"),
        ({"kind": "jam", "surface": "rudder", "angle_deg": -31.0}, r"expected `float` >= -30.0 \[deg\], got -31.0"),
        ({"kind": "rate_limit", "surface": "rudder", "rate_deg_s": 1e-300}, r"expected `float` >= 0.01"),
        ({"kind": "bandwidth", "surface": "rudder", "hz": 1e-300}, r"expected `float` >= 0.01"),
        ({"kind": "oscillation", "surface": "rudder", "amplitude_deg": 1.0, "hz": 51.0}, r"expected `float` <= 50.0"),
        ({"kind": "icing", "drag": 1.1}, r"expected `float` <= 1.0"),
        ({"kind": "engine", "left": 2.1}, r"expected `float` <= 2.0"),
        ({"kind": "sensor_noise", "signal": "q", "sd": 51.0}, r"sd: expected at most 50 rad/s either way, got 51"),
        ({"kind": "sensor_bias", "signal": "h", "bias": -1e6}, r"bias: expected at most 100000 m either way"),
        (
            {"kind": "crossed", "surfaces": ["rudder", "rudder"]},
            r"surfaces: expected two that differ, got rudder",
        ),
        ({"kind": "bandwidth", "surface": "rudder", "hz": 0.0}, r">= 0.01"),
        ({"kind": "cg_shift", "aft": "far"}, r"expected `float`, got `str`"),
        ({"kind": "jam", "surface": "flap"}, r"flap"),
    ],
)
def test_bad_settings_are_refused_in_one_line(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words) as error:
        fault(**settings)
    assert "\n" not in str(error.value)
    assert "faults[0]" in str(error.value)
