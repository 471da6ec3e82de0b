"""The bank of Kalman filters against filterpy's, and the evidence of a bank of models."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from runtime.hypotheses import Evidence
from runtime.rate_filter import MOTION, B, N, RateFilters
from task.rates import SIDESLIP, dynamic_pressure, features
from tests.runtime.rate_aircraft import MODEL, state


@pytest.mark.parametrize(("q_gust", "moving"), [(0.0, {}), (1e-4, {}), (0.0, {0: 3, 1: 4, 3: 5})])
def test_the_bank_is_filterpys_filters(q_gust, moving):
    """``moving``: the place that goes on as the last state says, by filter."""
    rng, size = np.random.default_rng(0), 4
    drift = MODEL.drift.copy()
    drift[SIDESLIP] = rng.normal(size=(5, 3)) * 1e-3
    ours = RateFilters(MODEL._replace(drift=drift), size)
    ours.q_gust = q_gust
    if moving:  # one filter alone, and two with a place each
        ours.moving = ours.motion(slice(0, 1), moving[0]), ours.motion(slice(1, 4, 2), slice(moving[1], moving[3] + 1))
    ours.s[:] = rng.normal(size=(size, N)) * 0.1
    ours.variances[:] = rng.uniform(1e-4, 1.0, (size, N))
    ours.q[:], ours.r = rng.uniform(1e-8, 1e-4, (size, N)), 1e-7
    bank = [KalmanFilter(dim_x=N, dim_z=3, dim_u=3) for _ in range(size)]
    for i, theirs in enumerate(bank):
        theirs.x, theirs.P = ours.s[i].copy(), ours.P[i].copy()
        theirs.H, theirs.B = np.eye(3, N), np.eye(N, 3)
        theirs.Q, theirs.R = np.diag(ours.q[i]), ours.r * np.eye(3)
    for _ in range(200):
        x = state(rng.normal(size=3) * 0.1, rng.uniform(80, 150), rng.uniform(0, 0.1), rng.normal() * 0.02)
        washed = 0.01 * rng.normal()
        ours.linearise(x.tolist(), washed, rng.uniform(-0.17, 0.17, (size, 3)))
        Q = q_gust * moments_of_sideslip(drift, x, washed)
        ours.predict()
        z = ours.s[0, :3] + 1e-3 * rng.normal(size=3)
        for i, theirs in enumerate(bank):
            F = np.eye(N)
            F[:3] = ours.F_rates[i]
            assert (F[2, MOTION] == 0.0) == (i in moving)
            if i in moving:
                F[moving[i], MOTION] = ours.dt
            theirs.Q[B, B] = np.diag(ours.q[i, B]) + Q
            theirs.predict(u=ours.drift_step, F=F)
            theirs.update(z)
        assert ours.update(z)
        for i, theirs in enumerate(bank):
            np.testing.assert_allclose(ours.s[i], theirs.x, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(ours.P[i], theirs.P, rtol=1e-5, atol=1e-11)
            assert ours.nis[i] == pytest.approx(float(theirs.y @ theirs.SI @ theirs.y), rel=1e-6)
            constant = 1.5 * np.log(2.0 * np.pi)
            assert ours.log_likelihood[i] - constant == pytest.approx(theirs.log_likelihood, rel=1e-6)
    np.testing.assert_array_equal(ours.P, ours.P.transpose(0, 2, 1))


def moments_of_sideslip(drift, x, washed, step=1e-6):
    """Return m m' of the change m of p', q', r' by sideslip (3,), by differences of all features."""
    p, q, r, V, alpha, beta, _, _, _, h = x
    qbar = dynamic_pressure(V, h)
    low, high = (np.array(features(p, q, r, V, alpha, b, washed, qbar)) for b in (beta - step, beta + step))
    m = (high - low) / (2.0 * step) @ drift
    return np.outer(m, m)


def test_the_evidence_is_the_posterior_of_a_bank_of_models():
    """Without forgetting, and while no sample says much, the probabilities of filterpy's multiple-model estimator."""
    from filterpy.kalman import MMAEFilterBank

    rng = np.random.default_rng(1)
    bank = []
    for drift in (0.0, 0.02, 0.04):
        kf = KalmanFilter(dim_x=1, dim_z=1, dim_u=1)
        kf.x, kf.P, kf.Q, kf.R = np.zeros(1), 0.1 * np.eye(1), 1e-3 * np.eye(1), 9.0 * np.eye(1)
        kf.F = kf.H = np.eye(1)
        kf.B = np.array([[drift]])
        bank.append(kf)
    estimator, evidence = MMAEFilterBank(bank, [1 / 3] * 3, 1, H=np.eye(1)), Evidence([0.0] * 3, 1.0, 1e9, 1e9)
    for k in range(60):
        for kf in bank:
            kf.predict(u=np.ones(1))
        z = np.array([0.02 * k + 2.0 * rng.normal()])
        estimator.update(z)
        likelihoods = [kf.log_likelihood for kf in bank]
        assert max(likelihoods) - min(likelihoods) < Evidence.SAYS
        evidence.weigh(likelihoods)
    weights = np.exp(-np.array(evidence.behind))
    np.testing.assert_allclose(weights / weights.sum(), estimator.p, rtol=1e-6)
    assert evidence.best == int(np.argmax(estimator.p))


def test_another_hypothesis_is_believed_after_a_lead_that_lasts_and_no_single_sample_decides():
    evidence = Evidence([0.0] * 3, 1.0, 10.0, 10.0)
    assert not evidence.weigh([0.0, 0.0, 1e6])
    assert evidence.behind == [1.0, 1.0, 0.0]
    told = [evidence.weigh([0.0, 0.0, 4.0]) for _ in range(12)]
    assert told.index(True) == 11  # a lead of more than 10 at the eleventh sample, held for three
    assert (evidence.believed, evidence.best) == (2, 2)
    assert evidence.confidence > 0.999
    assert not any(evidence.weigh([0.0, 0.0, -1.0]) for _ in range(11))
    assert any(evidence.weigh([5.0, 0.0, 0.0]) for _ in range(30))
    assert evidence.believed == 0
