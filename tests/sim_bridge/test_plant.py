"""The plant: trims, the command lag, starts that remember nothing, wind, actions out of this world."""

import numpy as np
import pytest

from sim_bridge.air import Air
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.faults import CGShift
from sim_bridge.plant import Plant
from sim_bridge.schedule import FaultSchedule
from task.errors import UserError
from task.limits import DT
from task.state import ACTION, STATE


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant()


def fly(plant: Plant, steps: int, action: np.ndarray | None = None, **start) -> np.ndarray:
    plant.reset(**start)
    action = plant.trim.action if action is None else action
    return np.array([plant.step(action).copy() for _ in range(steps)])


@pytest.mark.parametrize(
    ("condition", "elevator_deg"), [(NOMINAL, -1.419), (R1, 0.727), (R2, -5.744)], ids=["nominal", "R1", "R2"]
)
def test_trim_is_the_references(plant: Plant, condition: FlightCondition, elevator_deg: float) -> None:
    x = plant.reset(condition)
    assert np.rad2deg(plant.trim.action[ACTION.de]) == pytest.approx(elevator_deg, abs=0.05)
    assert x[STATE.V] == pytest.approx(condition.speed, abs=1e-9)
    assert x[STATE.h] == pytest.approx(condition.altitude, abs=1e-6)
    assert x[STATE.theta] - x[STATE.alpha] == pytest.approx(condition.flight_path, abs=1e-12)


@pytest.mark.parametrize("condition", [NOMINAL, R1, R2, FlightCondition(flight_path=0.0, heading=2.0)])
def test_trimmed_flight_goes_straight_on(plant: Plant, condition: FlightCondition) -> None:
    start = plant.reset(condition).copy()
    x = fly(plant, 100, condition=condition)[-1]
    # The auto-throttle closes at the set speed, as in the reference: a trim is not quite a rest.
    assert np.abs(x[[STATE.p, STATE.q, STATE.r]]).max() < 5e-3
    assert abs(x[STATE.V] - start[STATE.V]) < 1.0
    assert x[STATE.h] - start[STATE.h] == pytest.approx(condition.speed * np.sin(condition.flight_path), abs=0.3)
    assert x[STATE.psi] == pytest.approx(condition.heading, abs=1e-6)
    along = np.hypot(x[STATE.xe], x[STATE.ye])
    assert along == pytest.approx(condition.speed * np.cos(condition.flight_path), rel=5e-3)
    assert np.arctan2(x[STATE.ye], x[STATE.xe]) == pytest.approx(condition.heading, abs=1e-6)


def test_condition_out_of_reach_is_one_clear_line(plant: Plant) -> None:
    with pytest.raises(UserError, match=r"speed 20 m/s.*cannot be trimmed there; stay near") as error:
        plant.reset(FlightCondition(speed=20.0))
    assert "\n" not in str(error.value)
    assert np.isfinite(plant.reset()).all()


@pytest.mark.parametrize("surface", list(ACTION))
def test_command_first_moves_the_increment_after_the_next(plant: Plant, surface: ACTION) -> None:
    """docs/architecture.md: a[k] first moves x[k+2] - x[k+1]."""
    rate = {ACTION.de: STATE.q, ACTION.da: STATE.p, ACTION.dr: STATE.r}[surface]
    flown = []
    for deflection in (0.0, 0.05):
        plant.reset()
        states = [plant.x.copy()]
        for k in range(6):
            action = plant.trim.action.copy()
            if k >= 3:
                action[surface] += deflection
            states.append(plant.step(action).copy())
        flown.append(np.array(states))
    difference = np.abs(np.diff(flown[1][:, rate]) - np.diff(flown[0][:, rate]))
    # Row j is x[j+1] - x[j]; the command of step 3 moves row 4 first, and by a whole sample's worth.
    assert (difference[:4] == 0.0).all()
    slope = {ACTION.de: 12.5, ACTION.da: 22.3, ACTION.dr: 3.8}[surface]
    assert difference[4] == pytest.approx(slope * 0.05 * DT, rel=0.1)


def test_signs_of_the_surfaces(plant: Plant) -> None:
    for surface, rate in ((ACTION.de, STATE.q), (ACTION.da, STATE.p), (ACTION.dr, STATE.r)):
        plant.reset()
        action = plant.trim.action.copy()
        action[surface] += 0.02
        for _ in range(10):
            x = plant.step(action)
        assert x[rate] < 0.0, f"{surface.name} > 0: nose down, roll left, nose left"


def test_starts_remember_nothing(plant: Plant) -> None:
    fresh = fly(Plant(), 300)
    schedule = FaultSchedule((CGShift(aft=0.5),))
    plant.reset(R2, air=Air(wind_north=8.0, turbulence="severe"), seed=3)
    for k in range(300):
        schedule.apply(plant, k * DT)
        plant.step(np.array([0.1, -0.1, 0.2]))
    assert (fly(plant, 300) == fresh).all()


def test_instances_do_not_disturb_each_other() -> None:
    alone = fly(Plant(), 200, np.array([-0.02, 0.01, 0.0]))
    one, other = Plant(), Plant()
    one.reset()
    other.reset(R1)
    together = []
    for k in range(200):
        together.append(one.step(np.array([-0.02, 0.01, 0.0])).copy())
        other.step(np.array([0.05 * np.sin(k), 0.0, 0.0]))
    assert (np.array(together) == alone).all()


def test_state_array_is_reused(plant: Plant) -> None:
    x = plant.reset()
    assert plant.step(plant.trim.action) is x
    assert plant.x is x


def test_any_start(plant: Plant) -> None:
    x = np.array([0.1, -0.05, 0.02, 100.0, 0.05, 0.03, 0.5, 0.1, -2.0, 3000.0, 12.0, -7.0])
    assert plant.reset(x=x) == pytest.approx(x, abs=1e-6)
    assert plant.time == 0.0
    plant.step(plant.trim.action)
    assert plant.time == pytest.approx(DT)


def test_heading_is_continuous(plant: Plant) -> None:
    x = plant.reset().copy()
    x[STATE.psi], x[STATE.r] = 2.0 * np.pi - 0.005, 0.1
    plant.reset(x=x)
    psi = np.array([plant.step(plant.trim.action)[STATE.psi] for _ in range(100)])
    assert psi[-1] > 2.0 * np.pi
    assert np.abs(np.diff(psi)).max() < 0.01


@pytest.mark.parametrize(
    "action", [[np.nan] * 3, [np.inf, 0.0, 0.0], [0.0, -1e300, 0.0], [0.0, 0.0, 1e9], [1.5, 1.5, 1.5]], ids=str
)
def test_no_action_makes_it_raise_or_outlives_a_reset(plant: Plant, action: list[float]) -> None:
    before = fly(plant, 50)
    plant.reset()
    for _ in range(500):
        plant.step(np.array(action))
    assert (fly(plant, 50) == before).all()


def test_lost_flight_shows_in_the_state(plant: Plant) -> None:
    plant.reset()
    for _ in range(50):
        x = plant.step(np.array([0.0, 1e200, np.inf]))
    assert not np.isfinite(x).all()


def test_steady_wind_carries_and_does_nothing_else(plant: Plant) -> None:
    still = fly(plant, 500)
    windy = fly(plant, 500, air=Air(wind_north=6.0, wind_east=-9.0))
    assert plant.wind == pytest.approx([6.0, -9.0, 0.0], abs=1e-9)
    attitude = [STATE.p, STATE.q, STATE.r, STATE.phi, STATE.theta, STATE.psi, STATE.h]
    assert windy[:, attitude] == pytest.approx(still[:, attitude], abs=1e-5)
    carried = windy[-1, [STATE.xe, STATE.ye]] - still[-1, [STATE.xe, STATE.ye]]
    assert carried == pytest.approx(500 * DT * np.array([6.0, -9.0]), abs=1e-2)
    assert windy[0, STATE.V] == pytest.approx(np.hypot(still[0, STATE.V] + 6.0, 9.0), abs=0.05)


def test_turbulence_is_seeded_and_graded(plant: Plant) -> None:
    spread = []
    for level in ("light", "moderate", "severe"):
        one = fly(plant, 1000, air=Air(turbulence=level), seed=5)
        assert (fly(plant, 1000, air=Air(turbulence=level), seed=5) == one).all()
        assert (fly(plant, 1000, air=Air(turbulence=level), seed=6) != one).any()
        spread.append(one[:, STATE.p].std())
    assert 0.0 < spread[0] < spread[1] < spread[2]


def test_yaw_damper_damps(plant: Plant) -> None:
    swing = []
    for on in (True, False):
        x = plant.reset().copy()
        x[STATE.beta] = 0.05
        plant.reset(x=x)
        plant.effects.set_yaw_damper(on)
        swing.append(np.abs([plant.step(plant.trim.action)[STATE.r] for _ in range(1000)][600:]).max())
    assert swing[0] < 0.5 * swing[1]


def test_elevator_stops(plant: Plant) -> None:
    plant.reset()
    plant.step(np.array([1.0, 0.0, 0.0]))
    plant.step(np.array([1.0, 0.0, 0.0]))
    assert np.rad2deg(plant.surfaces[ACTION.de]) == pytest.approx(15.0, abs=1e-6)
    plant.step(np.array([-1.0, 0.0, 0.0]))
    assert np.rad2deg(plant.surfaces[ACTION.de]) == pytest.approx(-20.0, abs=1e-6)
