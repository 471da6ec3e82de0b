"""The imagination with surfaces that are slow, short of range or jammed: numpy = ONNX, and each limit is felt."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from export.imagination import imagination
from export.rollout import MAX_DELAY
from task.actuators import ACTUATOR, HEALTHY, limited
from task.model import with_effectiveness
from task.reward import CRASH_COST_PER_FRAME
from task.state import ACTION, N_IDENTIFIED
from tests.export.transcription import NETWORKS, RETURN_TOLERANCE, Case, session


@pytest.mark.parametrize(
    ("name", "lag", "delay"), [*itertools.product(["thesis", "scaled"], [0, 1], [0, 15]), ("linear-law", 3, 1)]
)
def test_limited_actuators(delay, lag, name, make_actors, nominal_model, tight):
    """In several models, one with crossed surfaces; each surface's limits are felt."""
    network = NETWORKS[name]
    population = make_actors(network, members=3, seed=5)
    graph = session(imagination(network, population.parameters, lag))
    crossed = with_effectiveness(nominal_model, np.array([[0.3, -0.5, 0.0], [0.4, 1.0, 0.2], [0.0, 0.1, -1.0]]))
    models = np.stack([nominal_model, crossed, nominal_model * 0.99])
    actors = np.concatenate([population.parameters, population.parameters[:1]])

    def flown(actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        case = Case(100, lag, models, True, delay, actuators=actuators)
        expected = []
        for model in models:
            alone = Case(100, lag, model, True, delay, actuators=actuators)
            expected.append(alone.by_numpy(network, actors))
        return np.stack(expected), graph.run(["returns"], case.feeds(population.parameters[0]))[0]

    healthy, _ = flown(HEALTHY)
    expected, returns = flown(tight())
    np.testing.assert_allclose(returns, expected, rtol=0, atol=RETURN_TOLERANCE[200])
    for surface in ACTION:
        actuators = tight()
        actuators[:, surface] = HEALTHY[:, surface]
        less, returns = flown(actuators)
        np.testing.assert_allclose(returns, less, rtol=0, atol=RETURN_TOLERANCE[200])
        assert np.abs(less - expected).max() > 10 * RETURN_TOLERANCE[200]
    assert np.abs(healthy - expected).max() > 100 * RETURN_TOLERANCE[200]


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("delay", [0, 1, 15])
def test_healthy_actuators_are_those_that_no_limit_holds(delay, lag, make_actors, nominal_model):
    """Both loops fly alike where limits are beyond what is commanded, and so does the reference.

    Products of more rows may add up in another order.
    """
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    graph = session(imagination(network, population.parameters, lag))
    wide = HEALTHY.copy()
    wide[ACTUATOR.rate] = 100.0
    answers, references = [], []
    for actuators in (HEALTHY, wide):
        case = Case(200, lag, nominal_model, True, delay, actuators=actuators)
        answers.append(graph.run(["returns", "unsafe"], case.feeds(population.parameters[0])))
        references.append(case.by_numpy(network, population.parameters))
    np.testing.assert_allclose(answers[1], answers[0], rtol=0, atol=RETURN_TOLERANCE[200])
    np.testing.assert_array_equal(references[0], references[1])


@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("delay", [0, 1, 15])
def test_what_acts_already_is_given_and_what_waits_is_limited(delay, lag, make_actors, nominal_model, tight):
    """Commands sent before lie beyond the range, and further apart than the rate."""
    network = NETWORKS["scaled"]
    population = make_actors(network, members=2)
    graph = session(imagination(network, population.parameters, lag))
    actuators = tight(rate=0.5)
    case = Case(40, lag, nominal_model, True, delay, actuators=actuators)
    case.commands[:] = np.random.default_rng(8).uniform(-0.1, 0.1, case.commands.shape).astype(np.float32)

    def flown(case: Case) -> np.ndarray:
        expected = case.by_numpy(network, population.parameters)
        returns = graph.run(["returns"], case.feeds(population.parameters[0]))[0][0, :2]
        np.testing.assert_allclose(returns, expected, rtol=0, atol=RETURN_TOLERANCE[50])
        return expected

    as_given, first = flown(case), MAX_DELAY - case.delay
    queue = case.commands[first:]
    acting = [*queue[:2]]
    for command in queue[2:]:
        acting.append(limited(command, acting[-1], actuators))
    queue[:] = acting
    np.testing.assert_allclose(flown(case), as_given, rtol=0, atol=1e-6)  # limits know what has been limited
    queue[0] = limited(queue[0], np.zeros(3), actuators)
    assert np.abs(flown(case) - as_given).max() > 10 * RETURN_TOLERANCE[50]


def test_a_jammed_surface_flies_as_a_command_that_stays(make_actors, nominal_model):
    """An elevator that is stuck is one that the model does not feel, once it stands where it stuck."""
    network = NETWORKS["thesis"]
    population = make_actors(network, members=3, seed=5)
    case = Case(100, 1, nominal_model, True)
    case.commands[:, ACTION.de] = -0.015625
    case.actuators = HEALTHY.copy()
    case.actuators[: ACTUATOR.rate, ACTION.de] = -0.015625
    graph = session(imagination(network, population.parameters, 1))
    (jammed,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    case.actuators = HEALTHY
    (free,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    case.model = nominal_model.copy()
    case.model[N_IDENTIFIED + ACTION.de] = 0.0
    (dead,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
    np.testing.assert_allclose(jammed, dead, rtol=0, atol=RETURN_TOLERANCE[200])
    assert np.abs(jammed - free).max() > 1.0


def test_nan_among_the_limits_costs_a_crash(make_actors, nominal_model):
    network = NETWORKS["thesis"]
    population = make_actors(network, members=2)
    graph = session(imagination(network, population.parameters, 1))
    for row in ACTUATOR:
        actuators = HEALTHY.copy()
        actuators[row, ACTION.de] = np.nan
        case = Case(20, 1, nominal_model, True, actuators=actuators)
        (returns,) = graph.run(["returns"], case.feeds(population.parameters[0]))[0]
        assert (returns <= -(20 - 1) * CRASH_COST_PER_FRAME).all()  # the first command acts one sample late
