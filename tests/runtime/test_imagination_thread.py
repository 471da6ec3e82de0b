"""The imagination's thread: asks return at once, answers are the same each time, failures do not end it."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from runtime.imagination import Imagination, Snapshot
from runtime.population import load_population
from task.actuators import HEALTHY
from task.model import embed_reduced

HORIZON = 200


@pytest.fixture(scope="module")
def population(population_folder):
    return load_population(population_folder)


@pytest.fixture
def imagination(population):
    with Imagination(population, HORIZON) as imagination:
        yield imagination


@pytest.fixture
def snapshot(population) -> Snapshot:
    golden = population.manifest.golden_imagination
    return Snapshot(
        x=np.array(golden.x),
        dx=np.array(golden.dx),
        commands=np.array(golden.commands),
        delay=golden.delay,
        model=embed_reduced(population.theta),
        exact_kinematics=True,
        reference=np.array(golden.reference),
        incumbent=population.parameters[golden.incumbent],
    )


def longest(snapshot: Snapshot) -> Snapshot:
    return snapshot._replace(reference=np.resize(snapshot.reference, (HORIZON + 1, 3)))


def test_it_gives_the_golden_returns(imagination, snapshot, population):
    golden = population.manifest.golden_imagination
    imagination.request(snapshot, tick=7)
    prediction = imagination.wait(7)
    np.testing.assert_allclose(prediction.returns[0], golden.returns, rtol=0, atol=golden.tolerance)
    assert prediction.tick_requested == 7
    assert prediction.error == ""
    assert 0.0 < prediction.seconds < 10.0


def test_it_gives_the_golden_returns_of_limited_surfaces_and_healthy_ones_are_the_default(
    imagination, snapshot, population
):
    golden = population.manifest.golden_imagination
    imagination.request(snapshot._replace(actuators=np.array(golden.actuators)), tick=1)
    (limited,) = imagination.wait(1).returns
    np.testing.assert_allclose(limited, golden.limited_returns, rtol=0, atol=golden.tolerance)
    assert np.abs(limited - golden.returns).max() > 100 * golden.tolerance
    imagination.request(snapshot, tick=2)
    (healthy,) = imagination.wait(2).returns
    imagination.request(snapshot._replace(actuators=HEALTHY), tick=3)
    np.testing.assert_array_equal(imagination.wait(3).returns[0], healthy)


def test_the_incumbent_and_its_member_are_predicted_alike(imagination, snapshot, population):
    for member in range(4):
        imagination.request(longest(snapshot)._replace(incumbent=population.parameters[member]), member)
        (returns,) = imagination.wait(member).returns
        assert returns[-1] == pytest.approx(returns[member], rel=1e-5)


def test_the_same_question_has_the_same_answer_bit_for_bit(imagination, snapshot, population):
    questions = [longest(snapshot), snapshot, longest(snapshot), snapshot]
    answers = []
    for tick, question in enumerate(questions):
        imagination.request(question, tick)
        answers.append(imagination.wait(tick).returns)
    np.testing.assert_array_equal(answers[0], answers[2])
    np.testing.assert_array_equal(answers[1], answers[3])
    with Imagination(population, HORIZON) as other:
        other.request(snapshot, 0)
        np.testing.assert_array_equal(other.wait(0).returns, answers[1])


def test_a_request_copies_what_it_is_given(imagination, snapshot):
    snapshot = snapshot._replace(actuators=HEALTHY.copy())
    imagination.request(snapshot, 0)
    expected = imagination.wait(0).returns
    imagination.request(snapshot, 1)
    for array in (snapshot.x, snapshot.dx, snapshot.commands, snapshot.model, snapshot.reference, snapshot.actuators):
        array[:] = np.nan
    np.testing.assert_array_equal(imagination.wait(1).returns, expected)


def test_looking_never_waits_and_finds_the_answer_once_it_is_there(imagination, snapshot):
    assert imagination.result(3) is None
    imagination.request(longest(snapshot), 3)
    deadline = time.monotonic() + 10.0
    while (prediction := imagination.result(3)) is None and time.monotonic() < deadline:
        time.sleep(0.001)
    assert prediction is not None
    assert imagination.result(4) is None
    assert imagination.result(3) is prediction


def test_asking_takes_no_longer_than_copying(imagination, snapshot):
    """A play of the longest horizon takes milliseconds; the control thread must not feel it."""
    question = longest(snapshot)
    imagination.request(question, 0)
    play = imagination.wait(0).seconds
    asked = []
    for tick in range(1, 21):
        start = time.perf_counter()
        imagination.request(question, tick)
        asked.append(time.perf_counter() - start)
    assert np.median(asked) < 0.25 * play
    assert imagination.wait(20).tick_requested == 20


def test_the_newest_question_counts(imagination, snapshot):
    for tick in range(50):
        imagination.request(longest(snapshot), tick)
    assert imagination.wait(49).tick_requested == 49
    assert imagination.wait(48) is None


def test_waiting_for_a_question_that_was_never_asked_returns(imagination):
    assert imagination.wait(1) is None


def test_a_failing_play_is_a_status_and_the_next_one_works(imagination, snapshot):
    imagination.request(snapshot._replace(reference=np.zeros((0, 3))), 0)
    failed = imagination.wait(0)
    assert np.isnan(failed.returns).all()
    assert failed.returns.shape == (1, 5)
    assert failed.error
    assert "\n" not in failed.error
    assert imagination.failures == 1
    imagination.request(snapshot, 1)
    assert np.isfinite(imagination.wait(1).returns).all()
    assert imagination.failures == 1


def test_nan_in_the_model_costs_the_crash_everywhere(imagination, snapshot):
    imagination.request(snapshot._replace(model=np.full((13, 10), np.nan)), 0)
    prediction = imagination.wait(0)
    np.testing.assert_array_equal(prediction.returns, -2.0 * (len(snapshot.reference) - 1))


def test_a_reference_beyond_the_horizon_is_cut(imagination, snapshot):
    imagination.request(longest(snapshot), 0)
    expected = imagination.wait(0).returns
    beyond = np.concatenate([longest(snapshot).reference, np.ones((100, 3))])
    imagination.request(snapshot._replace(reference=beyond), 1)
    np.testing.assert_array_equal(imagination.wait(1).returns, expected)


def test_many_models_are_asked_at_once_and_a_delay_is_bounded(imagination, snapshot, population):
    models = np.stack([snapshot.model, 0.9 * snapshot.model])
    imagination.request(snapshot._replace(model=models, delay=population.max_delay), 0)
    several = imagination.wait(0)
    assert several.returns.shape == several.unsafe.shape == several.travel.shape == (2, 5)
    imagination.request(snapshot._replace(model=models[1], delay=population.max_delay + 100), 1)
    (alone,) = imagination.wait(1).returns
    np.testing.assert_allclose(several.returns[1], alone, rtol=0, atol=1e-4)


def test_closing_ends_the_thread_even_in_the_middle_of_a_play(population, snapshot):
    before = threading.active_count()
    imagination = Imagination(population, HORIZON)
    imagination.request(longest(snapshot), 0)
    imagination.close()
    assert threading.active_count() == before
    assert imagination.wait(1) is None
    imagination.close()
