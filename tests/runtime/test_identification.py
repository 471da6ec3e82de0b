import tracemalloc

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from runtime.config import Adaptation
from runtime.identification import IncrementalModel, RecursiveLeastSquares
from task.errors import UserError
from task.model import N_REGRESSORS, REDUCED_REGRESSORS, embed_reduced, predict_increment
from task.scheduling import Condition, scheduled
from task.state import N_IDENTIFIED, STATE
from tests.runtime.rate_aircraft import MODEL, state

THESIS = Adaptation(model="full", prior="none")


@pytest.mark.parametrize("kappa", [0.99, 0.9995, 1.0])
def test_recursion_equals_a_fading_memory_kalman_filter(kappa):
    """The oracle, filterpy with F = I, H = z', Q = 0, R = 1 and alpha^2 = 1/kappa, is eqs 8.5-8.7 for one output."""
    rng = np.random.default_rng(1)
    n = 13
    theta0, p0 = rng.normal(size=(n, 1)), 10.0 * np.eye(n)
    rls = RecursiveLeastSquares(theta0, p0, kappa)
    oracle = KalmanFilter(dim_x=n, dim_z=1)
    oracle.x, oracle.P = theta0.copy(), p0.copy()
    oracle.F, oracle.Q, oracle.R = np.eye(n), np.zeros((n, n)), np.eye(1)
    oracle.alpha = kappa**-0.5
    truth = rng.normal(size=(n, 1))
    for _ in range(200):
        z = rng.normal(size=n)
        y = z @ truth + 0.1 * rng.normal(size=1)
        rls.update(z, y)
        oracle.H = z[None, :]
        oracle.predict()
        oracle.update(y[:, None])
        np.testing.assert_allclose(rls.Theta, oracle.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(rls.P, oracle.P, rtol=0, atol=1e-12)


def test_covariance_stays_symmetric_to_the_last_bit():
    rng = np.random.default_rng(2)
    rls = RecursiveLeastSquares(np.zeros((13, 10)), 1e12 * np.eye(13), 0.9995)
    for _ in range(2000):
        rls.update(1e-4 * rng.normal(size=13), 1e-4 * rng.normal(size=10))
    assert np.array_equal(rls.P, rls.P.T)
    assert np.linalg.eigvalsh(rls.P).min() > 0.0


def test_a_quiet_flight_cannot_wind_the_covariance_up():
    quiet, free = (RecursiveLeastSquares(np.zeros((3, 1)), np.eye(3), 0.99, limit) for limit in (3e3, np.inf))
    for _ in range(20_000):
        quiet.update(np.zeros(3), np.zeros(1))
        free.update(np.zeros(3), np.zeros(1))
    assert quiet.trace < 1.02 * 3e3
    assert free.trace > 1e80


def test_what_is_not_finite_is_skipped_and_counted():
    rls = RecursiveLeastSquares(np.zeros((3, 2)), np.eye(3), 0.99)
    rls.update(np.ones(3), np.ones(2))
    theta = rls.Theta.copy()
    rls.update(np.array([1.0, np.nan, 0.0]), np.ones(2))
    rls.update(np.ones(3), np.array([np.inf, 1.0]))
    with np.errstate(over="ignore"):
        rls.update(np.full(3, 1e200), np.ones(2))
    assert rls.skipped == 3
    assert np.array_equal(rls.Theta, theta)


def test_a_recursion_whose_covariance_is_none_starts_again_from_its_prior():
    """Every later update would be skipped, or make it worse."""
    rls, rng = RecursiveLeastSquares(np.full((3, 1), 0.5), np.eye(3), 0.99), np.random.default_rng(0)
    for broken in (np.diag([1.0, 1.0, -30.0]), np.diag([1.0, 1.0, -1.0])):
        rls.P[:] = broken
        for _ in range(300):
            z = rng.standard_normal(3)
            rls.update(z, z @ np.full((3, 1), 2.0))
        np.testing.assert_allclose(rls.Theta, 2.0, atol=0.01)
        assert np.linalg.eigvalsh(rls.P).min() > 0.0
    assert rls.restarts == 2


def test_a_recursion_that_blew_up_starts_again_from_its_prior():
    rls = RecursiveLeastSquares(np.full((3, 1), 0.5), np.eye(3), 0.01)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(200):
            rls.update(np.zeros(3), np.zeros(1))
    assert rls.restarts >= 1
    assert np.isfinite(rls.P).all()
    assert np.allclose(rls.Theta, 0.5)


def test_learning_allocates_nothing(without_collections):
    rng = np.random.default_rng(3)
    z, y = rng.normal(size=(100, 13)), rng.normal(size=(100, 10))
    rls = RecursiveLeastSquares(np.zeros((13, 10)), np.eye(13), 0.9995)
    model = IncrementalModel(Adaptation(prior="none", lowpass_hz=1.5), 1)
    states, actions = 0.1 * rng.normal(size=(100, 12)), rng.normal(size=(100, 3))

    def work():
        for i in range(100):
            rls.update(z[i], y[i])
            model.observe(states[i])
            model.command(actions[i])

    work()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.reset_peak()
    work()
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    one_parameter_matrix = 13 * 10 * 8
    assert peak - before < one_parameter_matrix, f"{peak - before} bytes at once"
    assert after - before < 256


def fly_linear_system(settings, lag, theta, samples=600, seed=4, assumed_lag=None):
    """Fly a system that obeys eq. 8.2 with a command lag, with random commands; return the model that watched."""
    rng = np.random.default_rng(seed)
    model = IncrementalModel(settings, lag if assumed_lag is None else assumed_lag)
    exact = settings.model == "reduced"
    x = np.zeros(12)
    x[STATE.V], x[STATE.h] = 90.0, 2000.0
    dx = np.zeros(N_IDENTIFIED)
    sent = [np.zeros(3) for _ in range(lag + 2)]
    for _ in range(samples):
        model.observe(x)
        command = 0.02 * rng.normal(size=3)
        model.command(command)
        sent = [*sent[1:], command]
        dx = predict_increment(x[:N_IDENTIFIED], dx, sent[1] - sent[0], theta, exact)
        x[:N_IDENTIFIED] += dx
    return model


@pytest.mark.parametrize("lag", [0, 1, 3])
@pytest.mark.parametrize("lowpass", [0.0, 8.0])
def test_a_known_linear_system_is_recovered_with_its_lag(lag, lowpass):
    rng = np.random.default_rng(5)
    reduced = 0.1 * rng.normal(size=(len(REDUCED_REGRESSORS), 6))
    settings = Adaptation(model="reduced", prior="none", kappa=1.0, lowpass_hz=lowpass)
    model = fly_linear_system(settings, lag, embed_reduced(reduced))
    np.testing.assert_allclose(model.rls.Theta, reduced, atol=1e-3)
    snapshot = model.snapshot()
    np.testing.assert_allclose(snapshot.model, embed_reduced(reduced), atol=1e-3)
    assert snapshot.commands.shape == (lag + 1, 3)
    assert snapshot.exact_kinematics


def test_a_wrong_lag_is_not_recovered():
    rng = np.random.default_rng(6)
    reduced = 0.1 * rng.normal(size=(len(REDUCED_REGRESSORS), 6))
    settings = Adaptation(model="reduced", prior="none", kappa=1.0)
    model = fly_linear_system(settings, 1, embed_reduced(reduced), assumed_lag=0)
    assert np.abs(model.rls.Theta - reduced).max() > 0.02


def test_the_full_model_identifies_ten_states():
    rng = np.random.default_rng(7)
    theta = 0.1 * rng.normal(size=(N_REGRESSORS, N_IDENTIFIED))
    model = fly_linear_system(THESIS, 1, theta)
    np.testing.assert_allclose(model.rls.Theta, theta, atol=1e-6)
    assert model.outputs == tuple(STATE(i) for i in range(10))
    assert not model.snapshot().exact_kinematics


def test_heading_that_wraps_is_no_jump():
    model = IncrementalModel(THESIS, 1)
    x = np.zeros(12)
    for psi in (3.13, 3.14, -3.1331853):
        x[STATE.psi] = psi
        model.observe(x)
        model.command(np.zeros(3))
    np.testing.assert_allclose(model.snapshot().dx[STATE.psi], 0.01, atol=1e-6)


def test_no_increment_is_formed_across_a_gap():
    model = fly_linear_system(Adaptation(prior="none"), 1, embed_reduced(np.zeros((11, 6))), samples=20)
    updates = model.rls.updates
    model.restart_history()
    x = np.full(12, 5.0)
    for count in range(3):
        assert model.observe(x + 0.01 * count) is False
        model.command(np.zeros(3))
    assert model.rls.updates == updates
    assert model.observe(x) is True


def test_a_frozen_model_measures_its_innovation_and_learns_nothing():
    theta, p0 = np.full((11, 6), 0.01), np.eye(11)
    model = IncrementalModel(Adaptation(identify=False), 1, theta, p0)
    rng = np.random.default_rng(8)
    for _ in range(20):
        model.observe(rng.normal(size=12))
        model.command(rng.normal(size=3))
    assert np.array_equal(model.rls.Theta, theta)
    assert np.abs(model.rls.innovation).max() > 0.0


def test_a_scheduled_prior_is_imagined_where_the_aircraft_flies_and_never_learnt():
    theta, learnt_at = 0.01 * np.random.default_rng(2).normal(size=(11, 6)), Condition(90.0, 2000.0)
    settings = Adaptation(prior="scheduled", identify=False)
    model = IncrementalModel(settings, 1, theta, np.eye(11), rates=MODEL, learnt_at=learnt_at)
    x = state(w=(0.01, 0.02, 0.03), V=150.0, alpha=0.03, h=5000.0)
    command = np.array([0.02, -0.01, 0.0])
    for _ in range(5):
        model.observe(x)
        model.command(command)
    model.observe(x)
    expected = scheduled(embed_reduced(theta), learnt_at, MODEL, x, command)
    np.testing.assert_allclose(model.snapshot().model, expected, rtol=1e-5, atol=1e-8)
    assert np.array_equal(model.rls.Theta, theta)


def test_a_prior_that_is_missing_or_misshapen_is_one_line():
    with pytest.raises(UserError, match="no model prior"):
        IncrementalModel(Adaptation(), 1)
    with pytest.raises(UserError, match=r"expected theta \(11, 6\)"):
        IncrementalModel(Adaptation(), 1, np.zeros((13, 10)), np.eye(13))
