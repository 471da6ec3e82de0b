"""The ten cases of table 2 in the air: what breaks, what is sensed, and what is scored is the truth."""

from __future__ import annotations

import numpy as np
import pytest

from export.network import Layer, Network, flatten, layout
from export.study.campaign import ABREAST, SEEDS, Trials, fly, fly_once, join
from export.study.cases import CASES, CaseFleet, choose
from export.training.evaluate import attitude_nmae, evaluate, score
from export.training.flights import Fleet
from task.errors import UserError
from task.metrics import nmae
from task.state import ACTION, OBSERVATION, REFERENCE

NETWORK = Network(layers=(Layer(units=3),))
SHORT = Trials(3, 4.0)


def laws(gains: tuple[float, ...] = (6.0,)) -> np.ndarray:
    """Return linear laws (P, K) of several gains, about trim."""
    tensors = {t.name: np.zeros((len(gains), *t.shape), dtype=np.float32) for t in layout(NETWORK)}
    weight, bias = tensors["layers.0.weight"], tensors["layers.0.bias"]
    bias[:, ACTION.de] = np.arctanh(-1.43 / 10.0)
    for i, gain in enumerate(gains):
        weight[i, ACTION.de, [OBSERVATION.theta_e, OBSERVATION.q]] = -gain, 3.0
        weight[i, ACTION.da, [OBSERVATION.phi_e, OBSERVATION.p]] = -gain, 3.0
    return flatten(NETWORK, tensors)


def case(name: str):
    return choose(name)[0]


@pytest.fixture(scope="module")
def fleet() -> CaseFleet:
    return CaseFleet()


def flown(fleet, name, trials=SHORT, parameters=None):
    done: list[int] = []
    return fly(fleet, case(name), NETWORK, laws() if parameters is None else parameters, trials, done.append)


def test_nominal_flights_are_those_of_the_plain_fleet(fleet):
    fleet.take(case("nominal"))
    references = SHORT.references(fleet.theta_trim)
    ours, plain = flown(fleet, "nominal"), evaluate(Fleet(), NETWORK, laws(), references)
    for field in ("nmae", "smoothness", "returns", "mae"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(plain, field))


@pytest.mark.parametrize("name", [c.name for c in CASES[1:]])
def test_every_other_case_changes_the_flight(fleet, name):
    trials = Trials(1, 22.0 if name == "R3" else 4.0)
    assert abs(flown(fleet, name, trials).returns[0, 0] - flown(fleet, "nominal", trials).returns[0, 0]) > 1e-3


def test_cases_leave_nothing_behind(fleet):
    before = flown(fleet, "nominal")
    flown(fleet, "F6")
    flown(fleet, "R3")
    np.testing.assert_array_equal(flown(fleet, "nominal").returns, before.returns)


def test_with_biased_sensors_the_true_error_is_scored(fleet):
    """A law that nulls what it reads is off by the bias of 4e-3 rad, which its readings do not show."""
    fleet.take(case("R3"))
    trials = Trials(1, 10.0)
    references = trials.references(fleet.theta_trim)
    seen = Fleet.fly(fleet, NETWORK, laws(), references)
    true = fleet.fly_case(NETWORK, laws(), references, trials.noise_seeds())
    apart = seen.observation[1:, 0, 0, REFERENCE.theta] - true.observation[1:, 0, 0, REFERENCE.theta]
    assert apart.mean() == pytest.approx(-4e-3, abs=2e-4)
    assert 1e-5 < apart.std() < 1e-4
    np.testing.assert_allclose(seen.u, true.u)
    assert true.returns()[0, 0] != seen.returns()[0, 0]


def test_noise_belongs_to_the_reference_and_not_to_the_place_in_the_fleet(fleet):
    gains = (6.0,) * 3
    scores = flown(fleet, "R3", Trials(6, 2.0), laws(gains))
    np.testing.assert_array_equal(scores.returns[0], scores.returns[1])
    np.testing.assert_array_equal(scores.returns[0], scores.returns[2])
    assert len(set(scores.returns[0])) == 6


def test_batches_do_not_change_the_flights(fleet):
    """More actors than fly abreast, and one at a time: the same."""
    gains = tuple(np.linspace(3.0, 8.0, ABREAST // 3 + 2))
    together = flown(fleet, "F2", Trials(3, 1.0), laws(gains))
    alone = join([flown(fleet, "F2", Trials(3, 1.0), laws((g,))) for g in gains], axis=0)
    np.testing.assert_allclose(together.returns, alone.returns, rtol=1e-5)
    assert together.nmae.shape == (len(gains), len(SEEDS))


def test_fewer_references_are_the_first_of_more():
    whole = Trials(9, 2.0).references(0.05)
    np.testing.assert_array_equal(Trials(4, 2.0).references(0.05), whole[:4])
    parts = Trials(9, 2.0).parts(4)
    assert [part.total for part in parts] == [4, 4, 1]
    np.testing.assert_array_equal(np.concatenate([part.references(0.05) for part in parts]), whole)
    assert [seed for part in parts for seed in part.noise_seeds()] == Trials(9, 2.0).noise_seeds()
    assert len(set(Trials(9).noise_seeds())) == 9
    assert len({reference.tobytes() for reference in whole}) == 9


def test_flights_are_kept_and_flown_again_only_when_something_changes(fleet, tmp_path):
    done: list[int] = []

    def go(parameters, name="F3"):
        return fly_once(tmp_path, fleet, case(name), NETWORK, parameters, Trials(3, 1.0), done.append)

    first, again = go(laws()), go(laws())
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    assert sum(done) == 6
    go(laws((5.0,)))
    go(laws(), "F4")
    assert len(list(tmp_path.glob("*.npz"))) == 3


def test_scores_say_what_was_flown(fleet):
    fleet.take(case("nominal"))
    references = SHORT.references(fleet.theta_trim)
    hard = laws()
    hard[:, -3 + ACTION.de] = -9.0  # pulled up; biases are the last parameters of the layer
    flights = fleet.fly_case(NETWORK, hard, references, SHORT.noise_seeds())
    scores = score(NETWORK, flights)
    assert scores.saturated.min() > 0.2
    assert scores.unsafe.sum() == (flights.unsafe & flights.flown()).sum() > 0
    n = flights.length[0, 0]
    errors = flights.observation[1 : n + 1, 0, 0, :3].astype(float)
    assert scores.nmae[0, 0] == pytest.approx(nmae(errors))
    assert attitude_nmae(scores)[0, 0] == pytest.approx(100.0 * np.rad2deg(np.abs(errors[:, :2]).mean()) / 20.0)


def test_an_unknown_case_is_named():
    with pytest.raises(UserError, match=r"no case 'F9'; expected some of nominal, F1"):
        choose("F1,F9")
    assert [c.name for c in choose("R3, nominal")] == ["nominal", "R3"]
