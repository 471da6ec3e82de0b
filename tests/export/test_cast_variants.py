"""Mirrors, gain levels and the symmetric policies of the cast."""

import numpy as np
import pytest

from export.cast.variants import levelled, mirrored, symmetric, variant_name
from export.network import Layer, Network, forward, n_parameters, unflatten
from task.state import ACTION, OBSERVATION

ONE = Network(layers=(Layer(units=3),), input_scale=(8.0, 8.0, 20.0, 4.0, 4.0, 4.0, 8.0))
TWO = Network(layers=(Layer(units=5), Layer(units=3)))
ALPHA = 0.07


def act(network, parameters, s):
    return forward(network, unflatten(network, np.tile(parameters, (len(s), 1))), s)


def drawn(network, seed=0):
    rng = np.random.default_rng(seed)
    return 0.3 * rng.standard_normal(n_parameters(network)), 0.05 * rng.standard_normal((6, 7))


@pytest.mark.parametrize("network", [ONE, TWO])
def test_a_mirror_commands_the_opposite_on_its_axes_alone(network):
    parameters, s = drawn(network)
    turned = act(network, mirrored(network, parameters, (ACTION.de, ACTION.dr)), s)
    np.testing.assert_allclose(turned, act(network, parameters, s) * [-1.0, 1.0, -1.0], rtol=1e-12)


@pytest.mark.parametrize("network", [ONE, TWO])
def test_a_gain_level_keeps_the_trim_and_scales_what_is_added_to_it(network):
    parameters, s = drawn(network)
    trim = np.zeros((1, 7))
    trim[0, OBSERVATION.alpha] = ALPHA
    level = levelled(network, parameters, 0.4, ALPHA)
    before, after = act(network, parameters, trim), act(network, level, trim)
    np.testing.assert_allclose(after, before, rtol=1e-12)

    def inner(p, s):  # the last layer's output before its tanh
        return np.arctanh(act(network, p, s) / network.action_scale)

    np.testing.assert_allclose(
        inner(level, s) - inner(level, trim), 0.4 * (inner(parameters, s) - inner(parameters, trim)), rtol=1e-9
    )


def test_variants_leave_their_origin_alone():
    parameters, _ = drawn(ONE)
    before = parameters.copy()
    mirrored(ONE, parameters, (ACTION.da,))
    levelled(ONE, parameters, 3.0, ALPHA)
    np.testing.assert_array_equal(parameters, before)


def test_a_symmetric_policy_sees_no_difference_between_left_and_right():
    free = symmetric(ONE)
    assert free.sum() == 12
    parameters, s = drawn(ONE)
    parameters[~free] = 0.0
    seen_in_mirror = s * [1.0, -1.0, -1.0, -1.0, 1.0, -1.0, 1.0]
    expected = act(ONE, parameters, s) * [1.0, -1.0, -1.0]
    np.testing.assert_allclose(act(ONE, parameters, seen_in_mirror), expected, rtol=1e-12)


def test_names_say_level_and_axes():
    assert variant_name("nominal", 1.0, ()) == "nominal"
    assert variant_name("nominal", 0.4, (ACTION.de, ACTION.da)) == "nominal*0.4/-ea"
