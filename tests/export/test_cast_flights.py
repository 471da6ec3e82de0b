"""Flights in which something breaks and somebody takes over."""

import numpy as np
import pytest

from export.cast.cases import EASY, Case
from export.cast.flights import Stage, Trial, make_pilot
from export.network import Layer, Network, forward, n_parameters, unflatten
from export.training.flights import Fleet
from sim_bridge.faults import Effectiveness, Gust
from sim_bridge.presets import R3_SENSORS
from sim_bridge.sensors import SensorSettings
from task.limits import ACTION_HIGH, ACTION_LOW
from task.observation import observation
from task.reference import base_reference
from task.state import ACTION, OBSERVATION, STATE

NETWORK = Network(layers=(Layer(units=3),))
NOMINAL = EASY[0]
REVERSED = Case(name="turned", faults=(Effectiveness(surface="elevator", factor=-1.0),))


@pytest.fixture(scope="module")
def stage():
    return Stage()


def law(theta_gain):
    """A law that flies: pitch, roll and yaw about the nominal trim."""
    weight = np.zeros((3, 7))
    weight[ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -theta_gain, 0.5 * theta_gain
    weight[ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -4.0, 1.5
    weight[ACTION.dr, OBSERVATION.beta_e] = 2.0
    return np.concatenate([weight.ravel(), [-0.143, 0.0, 0.0]])


def reference(stage, seconds):
    return base_reference(seconds, float(stage.plant.trim.x[STATE.theta]))


def test_a_quiet_flight_is_the_trainers_flight(stage):
    rows = np.stack([law(5.0), law(8.0)])
    path = reference(stage, 3.0)
    flown = stage.fly(NETWORK, rows, [Trial(NOMINAL, path)])
    fleet = Fleet().fly(NETWORK, rows, np.concatenate([path, path[-1:]])[None])
    np.testing.assert_allclose(flown.error, fleet.observation[:-1, ..., :3], atol=1e-6)
    assert not flown.lost.any()


def test_the_opening_policy_flies_until_the_handover(stage):
    path = reference(stage, 3.0)
    rows = np.stack([law(5.0), law(9.0)])
    flown = stage.fly(NETWORK, rows, [Trial(NOMINAL, path, 0.5, 1.0)], opening=law(2.0))
    np.testing.assert_array_equal(flown.action[:100, 0], flown.action[:100, 1])
    assert not np.array_equal(flown.action[100, 0], flown.action[100, 1])
    alone = stage.fly(NETWORK, law(2.0)[None], [Trial(NOMINAL, path)])
    np.testing.assert_allclose(flown.action[:100, 0], alone.action[:100, 0], atol=1e-6)


def test_faults_come_with_the_onset_and_lose_whoever_does_not_answer(stage):
    path = reference(stage, 6.0)
    rows = np.stack([law(5.0), law(5.0)])
    rows[1, :7] *= -1.0
    rows[1, 21] *= -1.0
    flown = stage.fly(NETWORK, rows, [Trial(REVERSED, path, 2.0, 2.2), Trial(NOMINAL, path, 2.0, 2.2)], law(5.0))
    assert flown.lost[:, 0].tolist() == [True, False]
    assert flown.lost[:, 1].tolist() == [False, True]
    np.testing.assert_array_equal(flown.error[:200, 0, 0], flown.error[:200, 0, 1])
    assert 200 < flown.length[0, 0] < 600


def test_scores_count_from_their_sample_on(stage):
    path = reference(stage, 3.0)
    flown = stage.fly(NETWORK, law(5.0)[None], [Trial(NOMINAL, path)])
    late = flown.nmae(np.array([200]))
    error = flown.error[200:, 0, 0]
    scale = [np.deg2rad(20.0), np.deg2rad(20.0), max(abs(error[:, 2].mean()), np.deg2rad(1.0))]
    assert late[0, 0] == pytest.approx(100.0 * (np.abs(error).mean(axis=0) / scale).mean(), rel=1e-4)
    assert np.isnan(flown.nmae(np.array([300]))[0, 0])


def test_noise_is_the_same_for_all_policies_and_only_they_see_it(stage):
    noisy = Case(name="noisy", sensors=SensorSettings(noise=R3_SENSORS.noise))
    path = reference(stage, 1.0)
    rows = np.stack([law(5.0), law(5.0)])
    flown = stage.fly(NETWORK, rows, [Trial(noisy, path, seed=3), Trial(noisy, path, seed=4)])
    np.testing.assert_array_equal(flown.action[:, 0], flown.action[:, 1])
    assert not np.array_equal(flown.action[:, 0, 0], flown.action[:, 0, 1])
    # At the first sample the true error is the reference's: what acted on it was not.
    s = np.zeros((1, 7))
    s[0, :3], s[0, 6] = flown.error[0, 0, 0], stage.plant.trim.x[STATE.alpha]
    quiet = forward(NETWORK, unflatten(NETWORK, rows[:1]), s)[0]
    assert not np.allclose(flown.action[0, 0, 0], quiet, atol=1e-6)
    assert n_parameters(NETWORK) == rows.shape[1]


def test_a_cases_times_count_from_the_onset():
    (gust,) = Case(name="gust", faults=(Gust(start=1.0, end=4.0, down=3.0),)).begun(5.0)
    assert (gust.start, gust.end, gust.down) == (6.0, 9.0, 3.0)


@pytest.mark.parametrize(
    "network",
    [
        Network(layers=(Layer(units=3),), input_scale=(8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0)),
        Network(layers=(Layer(units=5), Layer(units=3, activation="linear")), action_scale=(0.1, 0.2, 0.1)),
        Network(layers=(Layer(units=6, layer_norm="standard"), Layer(units=3))),
    ],
)
def test_a_pilot_commands_what_the_exported_network_does(network):
    rng = np.random.default_rng(0)
    row = (0.4 * rng.standard_normal(n_parameters(network))).astype(np.float32)
    pilot = make_pilot(network, row)
    reference, states = 0.2 * rng.standard_normal((20, 3)), 0.2 * rng.standard_normal((20, 12))
    pilot.brief(reference)
    for k, (x, wanted) in enumerate(zip(states, reference, strict=True)):
        s = observation(x, wanted)
        expected = forward(network, unflatten(network, row[None].astype(float)), s)[0].clip(ACTION_LOW, ACTION_HIGH)
        np.testing.assert_allclose(pilot(k, x), expected, atol=1e-6)
