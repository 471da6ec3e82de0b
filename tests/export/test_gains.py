"""Members with stronger and weaker answers to what they observe."""

import numpy as np
import pytest

from export.gains import GAINS, gain_name, with_gains
from export.network import Layer, Network, forward, unflatten
from task.errors import UserError
from task.state import N_OBSERVATION, OBSERVATION

TANH = Network(layers=(Layer(units=12), Layer(units=12, layer_norm="standard"), Layer(units=3)))
SCALED = Network(
    layers=(Layer(units=12, layer_norm="unbiased", activation="relu"), Layer(units=3, activation="linear")),
    input_scale=(2.0, 1.0, 3.0, 0.5, 1.0, 1.0, 4.0),
    action_offset=(-0.02, 0.0, 0.0),
)


@pytest.mark.parametrize("network", [TANH, SCALED])
def test_a_gain_is_the_champion_that_sees_a_weighted_observation(make_actors, network):
    population = make_actors(network, members=3)
    gained = with_gains(population, "run")
    np.testing.assert_array_equal(gained.parameters[:3], population.parameters)
    assert gained.description.champion == "actor-1"
    tensors = unflatten(network, gained.parameters.astype(float))
    for s in np.random.default_rng(0).uniform(-0.4, 0.4, (10, N_OBSERVATION)):
        actions = forward(network, tensors, s)
        for member, gains in enumerate(GAINS, start=3):
            weighted = s.copy()
            for each, factor in gains.items():
                weighted[each] *= factor
            np.testing.assert_allclose(actions[member], forward(network, tensors, weighted)[1], rtol=1e-6, atol=1e-9)
            assert np.abs(actions[member] - actions[1]).max() > 1e-4


def test_names_say_what_is_stronger_and_are_not_taken_twice(make_actors):
    assert gain_name("actor-1", {OBSERVATION.beta_e: 8.0, OBSERVATION.r: 0.5}) == "actor-1/beta_e*8+r*0.5"
    gained = with_gains(make_actors(TANH), "run")
    assert [m.name for m in gained.description.members][4:] == [gain_name("actor-1", gains) for gains in GAINS]
    with pytest.raises(UserError, match=r"run: --gains: the population has members actor-1/alpha\*0.5, .* already"):
        with_gains(gained, "run")
