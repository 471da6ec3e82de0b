import numpy as np
import pytest

from task.model import (
    DYNAMIC,
    N_REGRESSORS,
    REDUCED_REGRESSORS,
    embed_reduced,
    kinematic_rates,
    predict_increment,
    with_effectiveness,
)
from task.state import ACTION, N_ACTION, N_IDENTIFIED, STATE


def rotation_ned_from_body(phi: float, theta: float, psi: float) -> np.ndarray:
    cf, sf, ct, st, cp, sp = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    roll = np.array([[1, 0, 0], [0, cf, -sf], [0, sf, cf]])
    pitch = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    yaw = np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]])
    return yaw @ pitch @ roll


def test_kinematics_agree_with_the_rotation_matrix() -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.6, 0.6, N_IDENTIFIED)
    x[STATE.V] = 90.0
    rates = kinematic_rates(x)
    # The rotation matrix turns with R' = R [omega]x; compare with a finite difference along the rates.
    p, q, r = x[STATE.p : STATE.r + 1]
    skew = np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]])
    angles = x[STATE.phi : STATE.psi + 1]
    eps = 1e-6
    turned = rotation_ned_from_body(*(angles + eps * rates[:3]))
    before = rotation_ned_from_body(*angles)
    assert (turned - before) / eps == pytest.approx(before @ skew, abs=1e-5)
    alpha, beta = x[STATE.alpha], x[STATE.beta]
    v_body = 90.0 * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    assert rates[3] == pytest.approx(-(before @ v_body)[2])


def test_full_increment_is_eq_8_2() -> None:
    rng = np.random.default_rng(1)
    F, G = rng.normal(size=(10, 10)), rng.normal(size=(10, 3))
    x, dx, da = rng.normal(size=10), rng.normal(size=10), rng.normal(size=3)
    Theta = np.vstack([F.T, G.T])
    assert predict_increment(x, dx, da, Theta, exact_kinematics=False) == pytest.approx(F @ dx + G @ da)
    stacked = predict_increment(np.tile(x, (4, 1)), np.tile(dx, (4, 1)), np.tile(da, (4, 1)), Theta, False)
    assert stacked[2] == pytest.approx(F @ dx + G @ da)


def test_reduced_model_uses_its_regressors_alone() -> None:
    rng = np.random.default_rng(2)
    reduced = rng.normal(size=(len(REDUCED_REGRESSORS), len(DYNAMIC)))
    Theta = embed_reduced(reduced)
    assert Theta.shape == (N_REGRESSORS, N_IDENTIFIED)
    x = rng.uniform(-0.3, 0.3, 10)
    dx, da = rng.normal(size=10) * 0.01, rng.normal(size=N_ACTION) * 0.01
    nxt = predict_increment(x, dx, da, Theta, exact_kinematics=True)
    z = np.concatenate([dx, da])[list(REDUCED_REGRESSORS)]
    assert nxt[list(DYNAMIC)] == pytest.approx(reduced.T @ z)
    far = dx.copy()
    far[[STATE.psi, STATE.h]] += 100.0
    assert np.array_equal(predict_increment(x, far, da, Theta, True), nxt)
    assert nxt[STATE.theta] == pytest.approx(0.01 * kinematic_rates(x)[1], abs=3e-4)


@pytest.mark.parametrize(
    "effectiveness",
    [
        np.diag([-1.0, 0.3, 0.0]),
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),  # aileron and rudder crossed
        np.array([[0.5, 0.1, 0.0], [0.0, 0.0, -2.0], [0.0, 0.7, 0.0]]),
    ],
    ids=["signed", "crossed", "mixed"],
)
def test_effectiveness_is_what_the_surfaces_make_of_the_command(effectiveness: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    Theta = rng.normal(size=(N_REGRESSORS, N_IDENTIFIED))
    x, dx, da = rng.normal(size=10), rng.normal(size=10), rng.normal(size=N_ACTION)
    before = Theta.copy()
    faulty = with_effectiveness(Theta, effectiveness)
    expected = predict_increment(x, dx, effectiveness @ da, Theta, False)
    assert predict_increment(x, dx, da, faulty, False) == pytest.approx(expected)
    assert np.array_equal(Theta, before)
    assert np.array_equal(faulty[:N_IDENTIFIED], Theta[:N_IDENTIFIED])


def test_several_aircraft_at_once() -> None:
    Theta = np.random.default_rng(5).normal(size=(N_REGRESSORS, N_IDENTIFIED))
    several = np.stack([np.diag([scale, 1.0, 1.0]) for scale in (1.0, -1.0)])
    models = with_effectiveness(Theta, several)
    assert models.shape == (2, N_REGRESSORS, N_IDENTIFIED)
    assert np.array_equal(models[0], Theta)
    assert np.array_equal(models[1, N_IDENTIFIED + ACTION.de], -Theta[N_IDENTIFIED + ACTION.de])
    with pytest.raises(ValueError, match="broadcast"):
        with_effectiveness(np.stack([Theta] * 3), several)
