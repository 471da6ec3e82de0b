"""Laws imagined: the graph is the numpy reference, and the reference is what the law itself would fly."""

from __future__ import annotations

import itertools

import numpy as np
import onnxruntime
import pytest

from export.golden import golden_imagination, golden_laws
from export.imagination import imagination
from export.law_imagination import law_imagination
from export.loop import FREE_LOOP, LIMITED_LOOP, bodies
from export.network import Layer, Network, n_parameters
from export.rollout import MAX_DELAY, Imagined, rollout, rollout_laws
from export.scoring import SCORES
from task.actuators import ACTUATOR, HEALTHY
from task.laws import N_MEMORY, N_SEEN, READ, SEEN
from task.limits import DEFLECTION_LIMIT, DT
from task.model import embed_reduced, predict_increment, with_effectiveness
from task.reference import random_reference
from task.reward import CRASH_COST_PER_FRAME, REWARD_SCALE
from task.state import ACTION, N_ACTION, REFERENCE, STATE
from tests.export.transcription import session

ROWS, COLUMNS = N_ACTION + N_MEMORY, N_MEMORY + N_SEEN
TOLERANCE = 2e-4
"""Return over a hundred steps in float32."""
TRIM = -0.025
GIVEN = ("x", "dx", "commands", "reference", "actuators")


@pytest.fixture(scope="module")
def graphs() -> dict[int, onnxruntime.InferenceSession]:
    return {lag: session(law_imagination(lag)) for lag in (0, 1, 3)}


class Question:
    """An imagination's inputs, in float64 values that float32 holds exactly."""

    def __init__(
        self, models: np.ndarray, lag: int = 1, delay: int = 0, horizon: int = 100, exact: bool = True,
        actuators: np.ndarray = HEALTHY,
    ) -> None:  # fmt: skip
        rng = np.random.default_rng(4)
        x = np.zeros(10)
        x[:3] = rng.normal(0.0, 0.01, 3)
        x[3:10] = 90.0, 0.06, 0.01, 0.1, 0.06, 0.5, 2000.0
        commands = rng.uniform(-0.02, 0.02, (lag + 1 + MAX_DELAY, N_ACTION))
        arrays = (x, 1e-4 * rng.normal(size=10), commands, random_reference(rng, 20.0, 0.06)[: horizon + 1], models)
        self.x, self.dx, self.commands, self.reference, models = (a.astype(np.float32).astype(float) for a in arrays)
        self.models = models.reshape(-1, 13, 10)
        self.delay, self.exact = delay, exact
        self.actuators = actuators.astype(np.float32).astype(float)

    def by_numpy(self, maps: np.ndarray, memory: np.ndarray) -> Imagined:
        """Return what comes of it in each model, (M, Q)."""
        start = self.x, self.dx, self.commands, self.delay
        of_models = [
            rollout_laws(maps, memory, *start, model, self.exact, self.reference, self.actuators)
            for model in self.models
        ]
        return Imagined(*(np.stack(parts) for parts in zip(*of_models, strict=True)))

    def feeds(self) -> dict[str, np.ndarray]:
        arrays = {name: getattr(self, name).astype(np.float32) for name in GIVEN}
        return arrays | {
            "model": self.models.astype(np.float32),
            "delay": np.array(self.delay),
            "exact_kinematics": np.array(self.exact),
        }

    def by_graph(self, graph: onnxruntime.InferenceSession, maps: np.ndarray, memory: np.ndarray) -> Imagined:
        laws = {"maps": maps.astype(np.float32), "memory": memory.astype(np.float32)}
        return Imagined(*graph.run(SCORES, self.feeds() | laws))


def columns(part: slice) -> slice:
    """Return the columns of a law's maps for a part of y."""
    return slice(N_MEMORY + part.start, N_MEMORY + part.stop)


def random_laws(laws: int, growth: float, gain: float = 0.02, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return maps without zeros and a memory; growth: the largest eigenvalue of what a law makes of its memory."""
    rng = np.random.default_rng(seed)
    maps = gain * rng.normal(size=(laws, ROWS, COLUMNS))
    maps[:, :, columns(SEEN.x)][:, :, STATE.V] *= 0.01
    own = rng.normal(size=(laws, N_MEMORY, N_MEMORY))
    own *= growth / np.abs(np.linalg.eigvals(own)).max(axis=1)[:, None, None]
    maps[:, N_ACTION:, :N_MEMORY] = own
    memory = 0.1 * rng.normal(size=(laws, N_MEMORY))
    return maps.astype(np.float32).astype(float), memory.astype(np.float32).astype(float)


# ------------------------------------------------------------------------------------------------- graph and numpy


@pytest.mark.parametrize("exact", [True, False], ids=["exact-kinematics", "full-model"])
@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("delay", [0, 1, 7, MAX_DELAY])
def test_the_graph_is_the_reference(delay, lag, exact, graphs, nominal_model, full_model):
    model = nominal_model if exact else full_model
    reversed_elevator = model.copy()
    reversed_elevator[10] *= -1.0
    for models, laws in ((model, 1), (model, 2), (np.stack([model, reversed_elevator, 0.99 * model]), 5)):
        question = Question(models, lag, delay, exact=exact)
        maps, memory = random_laws(laws, growth=0.95, seed=delay)
        expected, got = question.by_numpy(maps, memory), question.by_graph(graphs[lag], maps, memory)
        assert got.returns.shape == expected.returns.shape == (len(question.models), laws)
        np.testing.assert_allclose(got.returns, expected.returns, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(got.unsafe, expected.unsafe, rtol=0, atol=1.0)
        np.testing.assert_allclose(got.travel, expected.travel, rtol=1e-3, atol=1e-4)
        if laws > 1:
            assert np.ptp(expected.returns, axis=1).min() > 10 * TOLERANCE  # the laws do differ
        if len(question.models) > 1:
            assert np.ptp(expected.returns, axis=0).max() > 10 * TOLERANCE


@pytest.mark.parametrize("horizon", [1, 2, 400])
def test_any_horizon(horizon, graphs, nominal_model):
    question = Question(nominal_model, delay=2, horizon=horizon)
    maps, memory = random_laws(3, growth=0.9)
    expected, got = question.by_numpy(maps, memory), question.by_graph(graphs[1], maps, memory)
    np.testing.assert_allclose(got.returns, expected.returns, rtol=0, atol=1e-3)


def test_unstable_laws(graphs, nominal_model):
    """Memories that grow until the commands only know the limits, and loops closed with the wrong signs."""
    question = Question(nominal_model, horizon=400)
    maps, memory = random_laws(4, growth=1.05)
    for part in (SEEN.x, SEEN.reference):
        maps[2:, :N_ACTION, columns(part)] -= 2.0 * PID.maps()[:N_ACTION, columns(part)]
    expected, got = question.by_numpy(maps, memory), question.by_graph(graphs[1], maps, memory)
    assert (expected.returns[0, 2:] < -0.25 * 400 * CRASH_COST_PER_FRAME).all()
    np.testing.assert_allclose(got.returns[0, :2], expected.returns[0, :2], rtol=0, atol=0.05)
    np.testing.assert_allclose(got.returns[0, 2:], expected.returns[0, 2:], rtol=0, atol=4.0)  # lost a step apart


def test_a_memory_beyond_float32_is_a_lost_flight(graphs, nominal_model):
    question = Question(nominal_model, horizon=100)
    maps, memory = np.zeros((1, ROWS, COLUMNS)), np.ones((1, N_MEMORY))
    maps[0, N_ACTION:, :N_MEMORY] = 1e5 * np.ones((N_MEMORY, N_MEMORY))  # until infinity less infinity
    maps[0, :N_ACTION, 0], maps[0, :N_ACTION, 1] = 1.0, -1.0
    returns = question.by_graph(graphs[1], maps, memory).returns
    assert returns[0, 0] < -0.8 * 100 * CRASH_COST_PER_FRAME


def test_a_poisoned_law_is_lost_and_leaves_the_others_alone(graphs, nominal_model):
    question = Question(nominal_model, horizon=50)
    maps, memory = random_laws(4, growth=0.9)
    sound = question.by_graph(graphs[1], maps, memory).returns
    maps[1, 0, 3] = np.nan
    memory[2, 0] = np.inf
    got = question.by_graph(graphs[1], maps, memory).returns
    np.testing.assert_array_equal(got[:, [0, 3]], sound[:, [0, 3]])
    assert (got[:, [1, 2]] <= -(50 - 1) * CRASH_COST_PER_FRAME).all()  # its first command acts one sample late


# -------------------------------------------------------------------------------------------- what the law itself flies


class PID:
    """Three PID loops as one would write them: integrals, sideslip differenced, reference rates, a smoothed rudder."""

    P, I, D = (-1.2, -0.6, 0.8), (-0.4, -0.2, 0.3), (-0.4, -0.2, 0.2)  # noqa: E741
    SMOOTHING = 0.3

    def __init__(self, integral: list[float], asked_before: np.ndarray, beta_before: float) -> None:
        self.integral = list(integral)
        self.before, self.beta = asked_before, beta_before

    def steer(self, x: np.ndarray, acted: np.ndarray, asked: np.ndarray) -> np.ndarray:
        wanted = (asked - self.before) / DT
        beta_rate = (x[STATE.beta] - self.beta) / DT
        self.before, self.beta = asked, float(x[STATE.beta])
        errors = (
            asked[REFERENCE.theta] - x[STATE.theta],
            asked[REFERENCE.phi] - x[STATE.phi],
            asked[REFERENCE.beta] - x[STATE.beta],
        )
        rates = (x[STATE.q], x[STATE.p], beta_rate)
        u = []
        for axis in range(3):
            rate_error = wanted[axis] - rates[axis]
            u.append(self.P[axis] * errors[axis] + self.I[axis] * self.integral[axis] + self.D[axis] * rate_error)
            self.integral[axis] += DT * errors[axis]
        u[ACTION.de] += TRIM
        u[ACTION.dr] = (1.0 - self.SMOOTHING) * u[ACTION.dr] + self.SMOOTHING * acted[ACTION.dr]
        return np.array(u)

    @classmethod
    def maps(cls) -> np.ndarray:
        """Return the same by hand."""
        maps = np.zeros((ROWS, COLUMNS))
        x, dx = columns(SEEN.x).start, columns(SEEN.dx).start
        asked, rate = columns(SEEN.reference).start, columns(SEEN.rate).start
        for axis, state in enumerate((STATE.theta, STATE.phi, STATE.beta)):
            maps[axis, asked + axis], maps[axis, x + state] = cls.P[axis], -cls.P[axis]
            maps[axis, axis] = cls.I[axis]
            maps[axis, rate + axis] = cls.D[axis]
            integral = N_ACTION + axis
            maps[integral, axis] = 1.0
            maps[integral, asked + axis], maps[integral, x + state] = DT, -DT
        maps[ACTION.de, x + STATE.q], maps[ACTION.da, x + STATE.p] = -cls.D[0], -cls.D[1]
        maps[ACTION.dr, dx + STATE.beta] = -cls.D[2] / DT
        maps[ACTION.de, columns(SEEN.one)] = TRIM
        maps[ACTION.dr] *= 1.0 - cls.SMOOTHING
        maps[ACTION.dr, columns(SEEN.acted).start + ACTION.dr] = cls.SMOOTHING
        return maps


def flown_by_itself(integral: list[float], question: Question, lag: int) -> float:
    """Return the PID's return in the model, one flight, sample by sample."""
    x, dx = question.x.copy(), question.dx.copy()
    # before the first sample: the sideslip that dx tells of, and a reference that has moved as it will move
    asked_before = 2.0 * question.reference[0] - question.reference[1]
    pid = PID(integral, asked_before, float(x[STATE.beta] - dx[STATE.beta]))
    sent = list(question.commands)
    total, alive = 0.0, True
    for asked, following in itertools.pairwise(question.reference):
        late = lag + question.delay
        acted = sent[-1 - late]
        command = pid.steer(x, acted, asked)
        sent.append(np.minimum(np.maximum(command, -DEFLECTION_LIMIT), DEFLECTION_LIMIT))
        dx = predict_increment(x, dx, sent[-1 - late] - acted, question.models[0], question.exact)
        x = x + dx
        alive = alive and abs(x[STATE.theta]) <= np.deg2rad(60) and abs(x[STATE.phi]) <= np.deg2rad(75)
        error = following - x[[STATE.theta, STATE.phi, STATE.beta]]
        total += -np.abs(np.clip(REWARD_SCALE * error, -1, 1)).sum() / 3 if alive else -CRASH_COST_PER_FRAME
    return float(total)


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("delay", [0, 6])
def test_a_pid_in_maps_flies_as_the_pid_itself(delay, lag, graphs, nominal_model):
    question = Question(nominal_model, lag, delay, horizon=300)
    integral = [0.02, -0.03, 0.01]
    alone = flown_by_itself(integral, question, lag)
    memory = np.zeros((1, N_MEMORY))
    memory[0, :3] = integral
    maps = PID.maps()[None]
    assert question.by_numpy(maps, memory).returns[0, 0] == pytest.approx(alone, abs=1e-9)
    assert question.by_graph(graphs[lag], maps, memory).returns[0, 0] == pytest.approx(alone, abs=1e-3)
    if delay == 0:
        assert -40.0 < alone < -1.0  # it does fly


# ------------------------------------------------------------------------------------------------- limits and losses


def test_commands_are_limited(graphs, nominal_model):
    """A law that asks for far more than the limit flies as one that asks for the limit."""
    question = Question(nominal_model, horizon=60)
    maps = np.zeros((2, ROWS, COLUMNS))
    one = columns(SEEN.one).start
    maps[:, ACTION.da, one] = DEFLECTION_LIMIT, 7.0
    maps[:, ACTION.de, one] = -DEFLECTION_LIMIT, -7.0
    memory = np.zeros((2, N_MEMORY))
    for returns in (question.by_numpy(maps, memory).returns, question.by_graph(graphs[1], maps, memory).returns):
        assert returns[0, 0] == pytest.approx(returns[0, 1], abs=1e-6)
        less = 0.5 * maps[:1]
        assert abs(question.by_numpy(less, memory[:1]).returns[0, 0] - returns[0, 0]) > 1.0


@pytest.mark.parametrize("exact", [True, False], ids=["exact-kinematics", "full-model"])
@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("delay", [0, 1, 15])
def test_limited_actuators(delay, lag, exact, graphs, nominal_model, full_model, tight):
    """Laws that read what acted, in several models, one with crossed surfaces; each surface's limits are felt."""
    model = nominal_model if exact else full_model
    crossed = with_effectiveness(model, np.array([[0.3, -0.5, 0.0], [0.4, 1.0, 0.2], [0.0, 0.1, -1.0]]))
    models = np.stack([model, crossed, 0.99 * model])
    maps, memory = random_laws(3, growth=0.95, gain=0.1, seed=delay)

    def flown(actuators: np.ndarray) -> np.ndarray:
        question = Question(models, lag, delay, exact=exact, actuators=actuators)
        question.commands *= 3.0
        expected, got = question.by_numpy(maps, memory), question.by_graph(graphs[lag], maps, memory)
        np.testing.assert_allclose(got.returns, expected.returns, rtol=0, atol=10 * TOLERANCE)
        np.testing.assert_allclose(got.unsafe, expected.unsafe, rtol=0, atol=1.0)
        np.testing.assert_allclose(got.travel, expected.travel, rtol=1e-3, atol=1e-4)
        return expected.returns

    expected = flown(tight())
    for surface in ACTION:
        actuators = tight()
        actuators[:, surface] = HEALTHY[:, surface]
        assert np.abs(flown(actuators) - expected).max() > 100 * TOLERANCE


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("delay", [0, 15])
def test_limits_beyond_what_is_commanded_change_nothing(delay, lag, graphs, nominal_model):
    """Both loops fly alike, but for the order in which a product of more rows may add up."""
    wide = HEALTHY.copy()
    wide[ACTUATOR.rate] = 100.0
    maps, memory = random_laws(3, growth=0.95)
    healthy, held = (
        Question(nominal_model, lag, delay, actuators=actuators).by_graph(graphs[lag], maps, memory)
        for actuators in (HEALTHY, wide)
    )
    np.testing.assert_allclose(held.returns, healthy.returns, rtol=0, atol=0.1 * TOLERANCE)
    np.testing.assert_array_equal(healthy.unsafe, held.unsafe)


def test_a_law_with_a_slow_aileron_flies_a_ramp(graphs, nominal_model):
    """By hand: a step that the aileron can only follow at its rate is the ramp that a quick one is told to fly."""
    rate = 0.25
    slow = HEALTHY.copy()
    slow[ACTUATOR.rate, ACTION.da] = rate
    one, sum_before, sum_after = columns(SEEN.one).start, 0, N_ACTION
    maps, memory = np.zeros((2, ROWS, COLUMNS)), np.zeros((2, N_MEMORY))
    maps[0, ACTION.da, one] = 0.1
    maps[1, [ACTION.da, sum_after], sum_before], maps[1, sum_after, one] = 1.0, rate * DT
    memory[1, 0] = rate * DT
    quick = Question(nominal_model, horizon=40)
    quick.commands[:] = 0.0
    at_once = quick.by_graph(graphs[1], maps, memory).returns[0]
    quick.actuators = slow
    slowly = quick.by_graph(graphs[1], maps, memory).returns[0]
    assert slowly[0] == pytest.approx(at_once[1], abs=1e-4)
    assert abs(slowly[0] - at_once[0]) > 0.5


@pytest.mark.parametrize("start", ["level", "steep", "diverging", "nan"])
@pytest.mark.parametrize("delay", [0, 5])
def test_a_law_of_zeros_is_a_network_of_zeros(delay, start, graphs, nominal_model):
    """Loss, safety and altitude are the networks' own."""
    network = Network(layers=(Layer(units=3, activation="linear"),))
    parameters = np.zeros((1, n_parameters(network)), dtype=np.float32)
    question = Question(1.5 * nominal_model if start == "diverging" else nominal_model, 1, delay, horizon=300)
    if start == "steep":
        question.x[[STATE.alpha, STATE.phi, STATE.h]] = 0.19, 1.06, 120.0
    elif start == "nan":
        question.x[STATE.q] = np.nan
    maps, memory = np.zeros((2, ROWS, COLUMNS)), np.zeros((2, N_MEMORY))
    laws = question.by_graph(graphs[1], maps, memory)
    networks = session(imagination(network, parameters, 1)).run(SCORES, question.feeds() | {"incumbent": parameters[0]})
    np.testing.assert_allclose(laws.returns, networks[0], rtol=0, atol=TOLERANCE)
    np.testing.assert_array_equal(laws.unsafe, networks[1])
    np.testing.assert_allclose(laws.travel, networks[2], rtol=0, atol=1e-6)
    by_laws = question.by_numpy(maps, memory)
    by_network = rollout(
        network, parameters, question.x, question.dx, question.commands, delay, question.models[0], True,
        question.reference,
    )  # fmt: skip
    np.testing.assert_array_equal(by_laws.returns[0, 0], by_network.returns[0])
    if start == "steep":
        assert laws.unsafe[0, 0] > 10.0
    if start != "level":
        assert laws.returns[0, 0] < -100.0


def test_heading_and_altitude_read_as_zero(graphs, nominal_model):
    question = Question(nominal_model)
    maps, memory = random_laws(2, growth=0.9)
    blind = maps.copy()
    blind[:, :, N_MEMORY:] *= READ
    assert not np.array_equal(blind, maps)
    for got, expected in (
        (question.by_numpy(maps, memory), question.by_numpy(blind, memory)),
        (question.by_graph(graphs[1], maps, memory), question.by_graph(graphs[1], blind, memory)),
    ):
        np.testing.assert_array_equal(got.returns, expected.returns)


# ------------------------------------------------------------------------------------------------- cost and golden laws


def test_the_loop_holds_few_nodes():
    """A node costs about a microsecond a step; whoever adds one should know it."""
    loops = bodies(law_imagination(1))
    assert len(loops[FREE_LOOP].node) <= 9
    assert len(loops[LIMITED_LOOP].node) <= 13


def test_the_golden_laws_would_notice_any_limit_that_is_not_felt(short_prior, make_actors):
    play = golden_imagination(make_actors(Network(layers=(Layer(units=3),))), short_prior)
    golden = golden_laws(play, short_prior)
    maps, memory = np.array(golden.maps), np.array(golden.memory)
    model = embed_reduced(short_prior.theta)
    start = (*(np.array(part) for part in (play.x, play.dx, play.commands)), play.delay, model, True)
    for limit in np.ndindex(HEALTHY.shape):
        actuators = np.array(play.actuators)
        actuators[limit] = HEALTHY[limit]
        returns = rollout_laws(maps, memory, *start, np.array(play.reference), actuators).returns
        assert np.abs(returns - golden.limited_returns).max() > 10 * golden.tolerance, limit


def test_the_golden_laws_would_notice_any_column_that_is_not_read(short_prior, make_actors):
    play = golden_imagination(make_actors(Network(layers=(Layer(units=3),))), short_prior)
    golden = golden_laws(play, short_prior)
    assert (np.array(golden.returns) > -0.5 * (len(play.reference) - 1)).all()  # none is lost
    model = embed_reduced(short_prior.theta)
    x, dx, commands, reference = (np.array(part) for part in (play.x, play.dx, play.commands, play.reference))
    missing = np.repeat(np.array(golden.maps)[2:], COLUMNS, axis=0)
    missing[np.arange(COLUMNS), :, np.arange(COLUMNS)] = 0.0
    memory = np.repeat(np.array(golden.memory)[2:], COLUMNS, axis=0)
    imagined = rollout_laws(missing, memory, x, dx, commands, play.delay, model, True, reference)
    unseen = np.abs(imagined.returns - golden.returns[2]) < golden.tolerance
    zero = READ == 0.0
    zero[[SEEN.reference.start + REFERENCE.beta, SEEN.rate.start + REFERENCE.beta]] = True  # as that reference is
    np.testing.assert_array_equal(np.flatnonzero(unseen), N_MEMORY + np.flatnonzero(zero))
