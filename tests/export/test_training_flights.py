"""Flights side by side against one aircraft in a plain loop; rewards and endings in numbers; the environment."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from export.network import forward, unflatten
from export.training.config import ActorSettings
from export.training.environment import AttitudeEnv
from export.training.evaluate import evaluate, evaluation_references
from export.training.flights import Fleet, Flights, draw_references
from export.training.networks import actor_network, initialise
from sim_bridge.plant import Plant
from task.limits import DT
from task.metrics import nmae, smoothness
from task.observation import observation
from task.reward import crash_penalty, terminated, tracking_reward, unsafe
from task.state import ACTION, OBSERVATION, STATE

NETWORK = actor_network(ActorSettings(width=8, hidden=1, input_scale=(8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0)))


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet()


def actors(count: int, gain: float = 1.0) -> np.ndarray:
    return gain * initialise(NETWORK, count, torch.Generator().manual_seed(0)).numpy()


def references(fleet: Fleet, count: int, duration: float) -> np.ndarray:
    return draw_references(np.random.default_rng(0), count, duration, fleet.theta_trim, "training")


def alone(parameters: np.ndarray, reference: np.ndarray, noise: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """One actor, one aircraft, one step at a time."""
    plant = Plant()
    x = plant.reset()
    tensors = unflatten(NETWORK, parameters[None])
    limit = NETWORK.action_scale[0]
    seen, commands, rewards, danger = [observation(x, reference[0])], [], [], []
    T = len(reference) - 1
    for k in range(T):
        a = forward(NETWORK, tensors, seen[-1][None].astype(np.float32))[0]
        if noise is not None:
            a = np.clip(a + limit * noise[k], -limit, limit)
        x = plant.step(a)
        seen.append(observation(x, reference[k + 1]))
        commands.append(a)
        rewards.append(float(tracking_reward(seen[-1][:3])))
        danger.append(bool(unsafe(x)))
        if terminated(x):
            rewards[-1] += float(crash_penalty((T - k - 1) * DT))
            break
    return {"s": np.array(seen), "a": np.array(commands), "r": np.array(rewards), "unsafe": np.array(danger)}


def test_flights_side_by_side_equal_flights_alone(fleet: Fleet) -> None:
    parameters, wanted = actors(3), references(fleet, 2, 3.0)
    noise = np.random.default_rng(1).normal(0.0, 0.3, (300, 2, 3)).astype(np.float32)
    flights = fleet.fly(NETWORK, parameters, wanted, noise)
    for p in range(3):
        for e in range(2):
            one = alone(parameters[p], wanted[e], noise[:, e] if p == 2 else None)
            n = len(one["a"])
            assert flights.length[p, e] == n
            np.testing.assert_allclose(flights.observation[: n + 1, p, e], one["s"], atol=2e-4)
            np.testing.assert_allclose(flights.u[:n, p, e] * NETWORK.action_scale, one["a"], atol=2e-4)
            assert flights.returns()[p, e] == pytest.approx(one["r"].sum(), abs=0.05)


def test_two_flights_of_the_same_are_bit_identical(fleet: Fleet) -> None:
    parameters, wanted = actors(2), references(fleet, 2, 2.0)
    first, second = fleet.fly(NETWORK, parameters, wanted), fleet.fly(NETWORK, parameters, wanted)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def hard_over(de: float, da: float) -> np.ndarray:
    """An actor that always commands the same deflections, in units of the bound."""
    parameters = np.zeros((1, actors(1).shape[1]), dtype=np.float32)
    bias = parameters[:, -3:]
    bias[:, ACTION.de], bias[:, ACTION.da] = np.arctanh([de, da])
    return parameters


def test_a_lost_flight_ends_pays_and_leaves_the_others_alone(fleet: Fleet) -> None:
    wanted = references(fleet, 1, 20.0)
    good = fleet.fly(NETWORK, actors(1, 0.0), wanted)
    both = fleet.fly(NETWORK, np.concatenate([hard_over(0.0, 0.95), actors(1, 0.0)]), wanted)
    n = int(both.length[0, 0])
    assert both.lost[0, 0]
    assert n < 2000
    roll = wanted[0, n, 1] - both.observation[n, 0, 0, 1]
    assert abs(roll) > np.deg2rad(75.0)
    assert abs(wanted[0, n - 1, 1] - both.observation[n - 1, 0, 0, 1]) <= np.deg2rad(75.0)
    last = tracking_reward(both.observation[n, 0, 0, :3]) - 2.0 * (2000 - n)
    assert both.reward[n - 1, 0, 0] == pytest.approx(float(last), rel=1e-5)
    assert not both.flown()[n:, 0, 0].any()
    assert both.unsafe[:n, 0, 0].sum() > 0
    np.testing.assert_array_equal(both.observation[:, 1], good.observation[:, 0])
    assert both.returns()[0, 0] < -2.0 * (2000 - n)


def test_reward_in_numbers() -> None:
    """30 deg of theta alone costs a third; sideslip counts four times; more than 30 deg costs no more."""
    assert tracking_reward(np.deg2rad([30.0, 0.0, 0.0])) == pytest.approx(-1.0 / 3.0)
    assert tracking_reward(np.deg2rad([0.0, -3.0, 0.0])) == pytest.approx(-1.0 / 30.0)
    assert tracking_reward(np.deg2rad([0.0, 0.0, 3.0])) == pytest.approx(-4.0 / 30.0)
    assert tracking_reward(np.deg2rad([90.0, 90.0, 90.0])) == pytest.approx(-1.0)
    assert crash_penalty(20.0) == pytest.approx(-4000.0)


def test_fleet_flies_broken_aircraft_where_asked(fleet: Fleet) -> None:
    wanted = references(fleet, 1, 3.0)
    whole = fleet.fly(NETWORK, actors(1), wanted)
    broken = fleet.fly(NETWORK, actors(1), wanted, prepare=lambda plant: plant.effects.set_cg_shift(0.25))
    again = fleet.fly(NETWORK, actors(1), wanted)
    assert np.abs(whole.observation - broken.observation).max() > 1e-3
    np.testing.assert_array_equal(whole.observation, again.observation)


def test_scores_are_those_of_the_task(fleet: Fleet) -> None:
    wanted = evaluation_references(fleet, 3, 2, duration=4.0)
    scores = evaluate(fleet, NETWORK, actors(2), wanted)
    for p in range(2):
        for e in range(2):
            one = alone(actors(2)[p], wanted[e])
            assert scores.nmae[p, e] == pytest.approx(nmae(one["s"][1:, :3]), rel=1e-3)
            assert scores.smoothness[p, e] == pytest.approx(smoothness(one["a"]), rel=1e-2)
    lost = evaluate(fleet, NETWORK, hard_over(0.0, 0.95), evaluation_references(fleet, 3, 1, duration=20.0))
    assert lost.lost.all()
    assert np.isinf(lost.ranking()).all()


def test_references_are_seeded_and_hold_their_last_sample(fleet: Fleet) -> None:
    first, second = evaluation_references(fleet, 5, 2), evaluation_references(fleet, 5, 2)
    np.testing.assert_array_equal(first, second)
    assert first.shape == (2, 8001, 3)
    np.testing.assert_array_equal(first[:, -1], first[:, -2])
    assert not np.array_equal(first, evaluation_references(fleet, 6, 2))


def test_published_references_keep_to_their_levels() -> None:
    drawn = draw_references(np.random.default_rng(0), 40, 20.0, 0.05, "published")
    theta, phi = drawn[..., 0] - 0.05, drawn[..., 1]
    assert np.abs(theta).max() <= np.deg2rad(30.0) + 1e-9
    assert np.rad2deg(np.abs(theta).max()) == pytest.approx(30.0, abs=0.1)
    assert np.rad2deg(np.abs(phi).max()) == pytest.approx(20.0, abs=0.1)
    assert not drawn[..., 2].any()
    held = theta[:, 399]  # the first level, reached after 20/6 s and held until 4 s
    steps = held / np.deg2rad(60.0 / 9.0) + 4.5
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_account_of_flights() -> None:
    reward = np.full((4, 1, 2), -1.0, dtype=np.float32)
    flights = Flights(
        np.zeros((5, 1, 2, 7), dtype=np.float32),
        np.zeros((4, 1, 2, 3), dtype=np.float32),
        reward,
        np.zeros((4, 1, 2), dtype=bool),
        np.array([[4, 2]]),
        np.array([[False, True]]),
    )
    np.testing.assert_array_equal(flights.returns(), [[-4.0, -2.0]])
    np.testing.assert_array_equal(flights.smoothness(np.ones(3)), [[0.0, 0.0]])


def test_environment_passes_gymnasiums_checker() -> None:
    check_env(AttitudeEnv(duration=1.0), skip_render_check=True)


def test_environment_flies_as_the_fleet_does(fleet: Fleet) -> None:
    parameters, wanted = actors(1), references(fleet, 1, 3.0)
    flights = fleet.fly(NETWORK, parameters, wanted)
    environment = AttitudeEnv(duration=3.0)
    seen, _ = environment.reset(options={"reference": wanted[0, :-1]})
    tensors = unflatten(NETWORK, parameters)
    total, over = 0.0, False
    while not over:
        action = forward(NETWORK, tensors, seen[None])[0]
        seen, reward, lost, truncated, info = environment.step(action)
        total += reward
        over = lost or truncated
    assert truncated
    assert not lost
    assert total == pytest.approx(flights.returns()[0, 0], abs=0.05)
    np.testing.assert_allclose(info["x"][STATE.theta] + seen[0], info["reference"][0], atol=1e-6)


def test_environment_ends_a_lost_flight_with_the_penalty() -> None:
    environment = AttitudeEnv()
    environment.reset(seed=1)
    steps, lost = 0, False
    while not lost:
        _, reward, lost, truncated, info = environment.step(np.array([0.0, 1.0, 0.0]))
        steps += 1
    assert not truncated
    assert abs(info["x"][STATE.phi]) > np.deg2rad(75.0)
    assert reward == pytest.approx(-2.0 * (2000 - steps), abs=1.0)
    assert info["unsafe"]


@pytest.mark.parametrize("apart", [False, True])
def test_groups_of_aircraft_fly_as_all_at_once(apart: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet()
    fleet.apart = apart
    parameters = initialise(NETWORK, 5, torch.Generator().manual_seed(3)).numpy()
    references = draw_references(np.random.default_rng(1), 2, 0.5, fleet.theta_trim, "training")
    noise = np.full((50, 2, 3), 0.1, dtype=np.float32)
    whole = fleet.fly(NETWORK, parameters, references, noise)
    monkeypatch.setattr("export.training.flights.IN_STEP", 4)
    grouped = fleet.fly(NETWORK, parameters, references, noise)
    for one, other in zip(whole, grouped, strict=True):
        np.testing.assert_array_equal(one, other)
    rate = np.float32(fleet.plants[7].x[STATE.p])
    assert not apart or rate == whole.observation[-1, 3, 1, OBSERVATION.p]
