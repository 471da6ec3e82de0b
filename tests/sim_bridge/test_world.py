"""Plant, faults, sensors and air of one flight, and the file that describes it."""

from __future__ import annotations

import numpy as np
import pytest

from sim_bridge.air import Air
from sim_bridge.conditions import FlightCondition
from sim_bridge.faults import CGShift, Gust, Jam, SensorBias
from sim_bridge.flight import Flight
from sim_bridge.presets import R3_SENSORS
from sim_bridge.world import World
from task.config import load_toml
from task.errors import UserError
from task.state import ACTION, STATE

FULL = """
duration = 30.0
seed = 7
[condition]
altitude = 3000.0
speed = 110.0
flight_path = 0.0
[air]
wind_north = 5.0
turbulence = "light"
[sensors]
noise = { p = 6e-4, theta = 3e-5 }
bias = { theta = 4e-3 }
delay = 0.02
[[faults]]
kind = "jam"
surface = "rudder"
angle_deg = 15.0
start = 10.0
[[faults]]
kind = "cg_shift"
aft = 0.25
start = 20.0
ramp = 2.0
"""


def flown(flight: Flight, ticks: int = 100) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fly at the trim deflections; return true states, measurements and winds."""
    world = World(flight)
    rows = []
    for _ in range(ticks):
        rows.append((world.x.copy(), world.measured.copy(), world.wind_n))
        world.step(world.trim_action)
    x, measured, wind = zip(*rows, strict=True)
    return np.array(x), np.array(measured), np.array(wind)


def test_a_file_says_everything_of_a_flight(tmp_path):
    (tmp_path / "f.toml").write_text(FULL)
    flight = load_toml(tmp_path / "f.toml", Flight)
    assert flight.condition == FlightCondition(altitude=3000.0, speed=110.0, flight_path=0.0)
    assert flight.faults == (Jam(surface="rudder", angle_deg=15.0, start=10.0), CGShift(aft=0.25, start=20.0, ramp=2.0))
    assert (flight.duration, flight.seed, flight.air.turbulence) == (30.0, 7, "light")
    assert flight.sensors.delay == 0.02


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("wibble = 1", "f.toml: object contains unknown field `wibble`"),
        ("[condition]\naltitud = 1.0", r"unknown field `altitud` - at `\$.condition`; known keys: altitude, speed"),
        ('[[faults]]\nkind = "jamm"', r"`\$.faults\[0\].kind`"),
        ('[[faults]]\nkind = "jam"\nsurface = "flap"', r"'flap'.*`\$.faults\[0\].surface`"),
        ('[[faults]]\nkind = "jam"\nsurface = "rudder"\nangle = 3.0', "unknown field `angle`"),
        ('[[faults]]\nkind = "cg_shift"\naft = 0.2\nstart = 5.0\nend = 4.0', "end: expected at least"),
        ("[sensors]\nnoise = { p = -1.0 }", "expected `float` >= 0"),
        ('[air]\nturbulence = "heavy"', "'heavy'"),
        ("seed = -1", "expected `int` >= 0"),
        ("[condition]\nspeed = inf", r"expected `float` <= 400.0 \[m/s\], got inf.*speed"),
        ("[air]\nwind_north = nan", r"expected `float` >= -100.0 \[m/s\], got nan.*wind_north"),
        ("[sensors]\nnoise = { p = inf }", "noise.p: expected at most 5 rad/s either way, got inf"),
        ("duration = nan", "duration"),
    ],
)
def test_a_wrong_file_is_one_line_that_says_where(tmp_path, text, line):
    (tmp_path / "f.toml").write_text(text)
    with pytest.raises(UserError, match=line) as error:
        load_toml(tmp_path / "f.toml", Flight)
    assert "\n" not in str(error.value)


def test_ideal_sensors_in_still_air_say_the_truth():
    x, measured, wind = flown(Flight())
    assert (x == measured).all()
    assert np.abs(wind).max() < 1e-9


def test_noise_is_in_what_is_measured_and_not_in_the_truth():
    quiet = flown(Flight(seed=1))[0]
    x, measured, _ = flown(Flight(seed=1, sensors=R3_SENSORS))
    assert (x == quiet).all()
    error = measured - x
    assert error[:, STATE.q].std() == pytest.approx(6.3e-4, rel=0.3)
    assert error[:, STATE.theta].mean() == pytest.approx(4e-3, rel=0.05)
    assert (error[:, STATE.h] == 0).all()


def test_the_seed_is_all_that_two_flights_share_their_chance_by():
    storm = Flight(sensors=R3_SENSORS, air=Air(turbulence="moderate"), seed=1)
    first, second = flown(storm), flown(storm)
    for a, b in zip(first, second, strict=True):
        assert a.tobytes() == b.tobytes()
    other = flown(Flight(sensors=R3_SENSORS, air=Air(turbulence="moderate"), seed=2))
    assert (first[0][-1] != other[0][-1]).any()
    assert np.abs(first[2]).max() > 0.01


def test_noise_does_not_change_the_turbulence():
    air = Air(turbulence="moderate")
    assert (flown(Flight(air=air))[2] == flown(Flight(air=air, sensors=R3_SENSORS))[2]).all()


def test_faults_act_from_their_tick_on_and_are_named():
    jam = Jam(surface="rudder", angle_deg=5.0, start=0.2)
    bias = SensorBias(signal="theta", bias=0.01, start=0.3, ramp=0.2)
    world = World(Flight(faults=(jam, bias)))
    levels, rudder, error = [], [], []
    for _ in range(60):
        levels.append(list(world.fault_levels))
        rudder.append(world.surfaces[ACTION.dr])
        error.append(world.measured[STATE.theta] - world.x[STATE.theta])
        world.step(world.trim_action)
    assert [level[0] for level in levels] == [0.0] * 20 + [1.0] * 40
    assert levels[40][1] == pytest.approx(0.5)
    np.testing.assert_allclose(error[40], 0.005, atol=1e-12)
    np.testing.assert_allclose(error[:30], 0.0, atol=1e-15)
    assert max(map(abs, rudder[:20])) < 1e-9
    np.testing.assert_allclose(np.degrees(rudder[23:]), 5.0, atol=1e-6)
    assert world.fault_names[0].startswith("jam")
    assert "theta" in world.fault_names[1]


def test_a_steady_wind_and_a_gust_are_what_the_air_does():
    gust = Gust(down=3.0, start=0.5, end=0.8)
    _, _, wind = flown(Flight(air=Air(wind_east=4.0), faults=(gust,)))
    np.testing.assert_allclose(wind[10], [0.0, 4.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(wind[60], [0.0, 4.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(wind[95], [0.0, 4.0, 0.0], atol=1e-6)
