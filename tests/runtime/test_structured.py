"""The effectiveness of the surfaces: alarm, belief, noise, and what the imagination gets."""

import msgspec
import numpy as np
import pytest

from runtime.advice import sure_signs
from runtime.config import Adaptation
from runtime.guard import PLAUSIBLE
from runtime.identification import IncrementalModel
from runtime.presets import PRESETS, resolve
from runtime.rate_filter import ALPHA_MID, SLOPES
from runtime.structured import Effectiveness
from runtime.switching import opposed
from runtime.unrest import Unrest
from task.errors import UserError
from task.limits import DT
from task.model import N_REGRESSORS
from task.rates import SIDESLIP, dynamic_pressure
from task.state import N_IDENTIFIED, STATE
from tests.runtime.rate_aircraft import MODEL, SETTINGS, Aircraft, watch


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
@pytest.mark.parametrize("effect", [(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-0.3, -1.0, 1.0), (0.3, 1.0, 1.0)])
def test_a_surface_that_changes_raises_one_alarm_and_is_known_within_a_second(noise, effect):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    assert watch(found, aircraft, 500) == []
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=0.1)
    aircraft.effect = np.array(effect)
    alarms = watch(found, aircraft, 100)
    assert len(alarms) == 1
    assert alarms[0] < 20
    np.testing.assert_allclose(found.effectiveness[:2], effect[:2], atol=0.2)


def what_is_logged(found, aircraft, samples):
    """Return what is known of the surfaces at each sample, (samples, 20), from the first one on."""
    rows = []
    for _ in range(samples):
        watch(found, aircraft, 1)
        rows.append([
            *found.effectiveness, *found.sd, *found.bias, *found.actuators[:2].ravel(), found.unrest.noise_variance,
            max(found.unrest.levels), found.surprise, found.evidence.confidence, found.stuck.mask,
        ])  # fmt: skip
    return np.array(rows)


@pytest.mark.parametrize("preset", ["structured", "ensemble"])
@pytest.mark.parametrize("ends", [20, 60, 200])
def test_a_flight_knows_nothing_of_the_one_before(preset, ends):
    found, before = Effectiveness(PRESETS[preset], MODEL, 1), Aircraft(noise=6.3e-4)
    watch(found, before, 500)
    before.effect, before.delay, before.stuck = np.array([-1.0, 1.0, 0.0]), 10, {0: None}
    assert watch(found, before, ends)
    found.reset()
    alone = Effectiveness(PRESETS[preset], MODEL, 1)
    told, fresh = (what_is_logged(each, Aircraft(1, 6.3e-4), 400) for each in (found, alone))
    np.testing.assert_array_equal(told, fresh)


def test_sensor_noise_is_found_and_raises_no_alarm():
    aircraft, found = Aircraft(seed=3, noise=1.3e-3), Effectiveness(SETTINGS, MODEL, 1)
    assert watch(found, aircraft, 6000) == []
    assert found.unrest.noise_variance**0.5 == pytest.approx(1.3e-3, rel=0.1)
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=0.2)


def test_slopes_that_change_are_not_taken_for_a_surface():
    """The pitching moment turns with the angle of attack, as with a centre of gravity behind the neutral point."""
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    read, step = aircraft.read, aircraft.step
    swing = lambda: ALPHA_MID + 0.05 * np.sin(0.6 * 2.0 * np.pi * aircraft.tick * DT)  # noqa: E731

    def seen():
        x = read()
        x[STATE.alpha] = swing()
        return x

    aircraft.read = seen
    watch(found, aircraft, 500)

    def turned(u):
        alpha = swing()
        step(u)
        aircraft.w[1] += DT * 4.0 * (alpha - ALPHA_MID)

    aircraft.step = turned
    assert watch(found, aircraft, 300)
    np.testing.assert_allclose(found.believed, 1.0, atol=0.2)
    assert found.filter.s[found.evidence.believed, SLOPES.start] == pytest.approx(4.0, abs=1.0)


def what_a_gust_is_taken_for(q_gust, reversed_rudder=False):
    """Return lambda of the rudder as believed, while somebody holds the nose against a gust from the side.

    An alarm for the elevator has opened the filters; of the rudder, which nobody moved, they were not told.
    """
    drift = MODEL.drift.copy()
    drift[SIDESLIP.start] = -2e-3, 0.0, 6e-4
    settings = msgspec.structs.replace(SETTINGS, q_gust=q_gust)
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(settings, MODEL._replace(drift=drift), 1)
    quiet, step = aircraft.command, aircraft.step
    qbar = dynamic_pressure(90.0, 2000.0)
    watch(found, aircraft, 500)
    aircraft.effect = np.array([0.5, 1.0, 1.0])
    aircraft.command = lambda: quiet() * np.array([1.0, 0.3, 0.03])
    watch(found, aircraft, 300)
    began = aircraft.tick
    if reversed_rudder:
        aircraft.effect = np.array([0.5, 1.0, -1.0])
    gust = lambda: 0.06 * min(1.0, (aircraft.tick - began) * DT)  # noqa: E731

    def countered():
        moment = drift[SIDESLIP.start] * qbar * gust()
        roll, yaw = moment[0] / (3.5e-3 * qbar), moment[2] / (1e-3 * qbar)
        return quiet() * np.array([1.0, 0.3, 0.03]) + np.array([0.0, roll, yaw])

    def blown(u):
        step(u)
        aircraft.w += DT * drift[SIDESLIP.start] * qbar * gust()

    aircraft.command, aircraft.step = countered, blown
    watch(found, aircraft, 60)
    return found.believed[2]


def test_a_gust_from_the_side_is_no_rudder_that_fails():
    assert what_a_gust_is_taken_for(8e-4) == pytest.approx(1.0, abs=0.05)
    assert what_a_gust_is_taken_for(8e-4, reversed_rudder=True) == pytest.approx(-1.0, abs=0.2)
    assert what_a_gust_is_taken_for(0.0) < 0.5


def test_gusts_are_allowed_for_while_a_surface_is_in_doubt():
    drift = MODEL.drift.copy()
    drift[SIDESLIP.start] = -2e-3, 0.0, 6e-4
    gusts = msgspec.structs.replace(SETTINGS, q_gust=8e-4)
    found = []
    for settings in (SETTINGS, gusts):
        aircraft, filters = Aircraft(noise=6.3e-4), Effectiveness(settings, MODEL._replace(drift=drift), 1)
        watch(filters, aircraft, 500)
        found.append(filters)
    plain, allowing = found
    np.testing.assert_array_equal(plain.filter.P, allowing.filter.P)

    busy = aircraft.command
    aircraft.effect = np.array([-1.0, 1.0, 1.0])
    aircraft.command = lambda: busy() * np.array([1.0, 1.0, 0.01])
    assert watch(allowing, aircraft, 300)
    assert allowing.sd[2] > Effectiveness.DOUBT
    assert allowing.filter.q_gust == 8e-4**2
    aircraft.command = busy
    watch(allowing, aircraft, 300)
    assert allowing.sd.max() < Effectiveness.DOUBT
    assert allowing.filter.q_gust == 0.0


def test_a_second_reversal_is_found_as_well():
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.effect = np.array([-1.0, 1.0, 1.0])
    watch(found, aircraft, 60)
    aircraft.effect = np.array([-1.0, -1.0, 1.0])
    assert watch(found, aircraft, 150)
    np.testing.assert_allclose(found.effectiveness[:2], -1.0, atol=0.2)
    aircraft.effect = np.ones(3)
    assert watch(found, aircraft, 200)
    np.testing.assert_allclose(found.effectiveness[:2], 1.0, atol=0.2)


@pytest.mark.parametrize("noise", [0.0, 6.3e-4])
def test_a_surface_that_does_nothing_is_imagined_to_do_nothing(noise):
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    aircraft.effect = np.array([1.0, 0.0, 1.0])
    watch(found, aircraft, 300)
    stuck = found.limited == 1 and np.abs(found.actuators[:2, 1]).max() < 0.003  # both ends at zero
    assert stuck or (found.believed[1] == 0.0 and found.effectiveness[1] != 0.0)
    assert found.believed[0] == pytest.approx(1.0, abs=0.2)
    assert sure_signs(found, *found.actuators[:2])[1] is None


def test_negative_angles_of_attack_are_doubted_unless_something_has_just_changed():
    drifts = []
    for alpha in (0.05, -0.12):
        aircraft, found = Aircraft(), Effectiveness(SETTINGS, MODEL, 1)
        read = aircraft.read

        def seen(read=read, alpha=alpha):
            x = read()
            x[STATE.alpha] += alpha - 0.05
            return x

        aircraft.read = seen
        watch(found, aircraft, 500)
        calm = found.filter.q[0, 6:9].copy()
        aircraft.effect = np.array([-1.0, -1.0, 1.0])
        assert watch(found, aircraft, 20)
        drifts.append((calm, found.filter.q[0, 6:9] / found.unrest.levels))
    (calm, after), (calm_low, after_low) = drifts
    assert (calm_low > 100.0 * calm).all()
    assert (after_low < 10.0 * after).all()


def test_a_weak_reversal_while_the_surface_is_hardly_used_is_found():
    """No sample surprises; the bias could take it all, but the agile filter explains it better."""
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    quiet = aircraft.command
    watch(found, aircraft, 500)
    aircraft.command = lambda: 0.02 * quiet()
    watch(found, aircraft, 300)
    aircraft.effect = np.array([-0.3, 1.0, 1.0])
    assert watch(found, aircraft, 50) == []
    aircraft.command = lambda: 0.5 * quiet()
    assert watch(found, aircraft, 150)
    assert found.effectiveness[0] < 0.0
    assert found.believed[0] < 0.3


def test_what_is_imagined_does_not_follow_an_uncertain_estimate():
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    quiet = aircraft.command
    aircraft.command = lambda: quiet() * np.array([1.0, 1.0, 0.0])  # nobody moves the rudder
    watch(found, aircraft, 200)
    aircraft.effect = np.array([-1.0, 1.0, 1.0])
    watch(found, aircraft, 100)
    assert found.sd[2] > 0.5
    assert found.believed[2] == pytest.approx(1.0, abs=0.1)
    assert found.believed[0] == pytest.approx(-1.0, abs=0.3)
    elevator, aileron, rudder = sure_signs(found, *found.actuators[:2])
    assert elevator == pytest.approx(-1.0, abs=0.3)
    assert aileron == pytest.approx(1.0, abs=0.3)
    assert rudder is None


def test_garbage_that_an_aircraft_might_just_be_in_is_recovered_from():
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 500)
    rng, most = np.random.default_rng(1), PLAUSIBLE[:N_IDENTIFIED].clip(max=5e4)
    with np.errstate(all="ignore"):
        for _ in range(200):
            found.observe(rng.uniform(-most, most))
            found.command(np.zeros(3))
        found.restart_history()
        watch(found, aircraft, 500)
        restarts = found.restarts
        watch(found, aircraft, 500)
    assert restarts > 0
    assert found.restarts == restarts
    np.testing.assert_allclose(found.believed, 1.0, atol=0.3)
    aircraft.effect = np.array([-1.0, 1.0, 1.0])
    watch(found, aircraft, 200)
    np.testing.assert_allclose(found.believed, aircraft.effect, atol=0.3)


def skip(found, aircraft, samples):
    """Let the aircraft fly on with its last command, unseen."""
    held = aircraft.sent[-1]
    for _ in range(samples):
        aircraft.step(held)
        found.command(held)
    found.restart_history(commands_known=True)


@pytest.mark.parametrize("noise", [6.3e-4, 0.0])
def test_gaps_change_nothing_of_what_is_known(noise):
    """Neither where a sensor stands still, which undoes what was learnt of late, nor of how late commands are."""
    aircraft, found = Aircraft(noise=noise), Effectiveness(SETTINGS, MODEL, 1)
    aircraft.effect = np.array([0.9, 1.0, 1.1])
    watch(found, aircraft, 600)
    aircraft.stuck = {STATE.p: None}
    watch(found, aircraft, 1)
    for _ in range(30):
        watch(found, aircraft, 25)
        skip(found, aircraft, 1)
    assert found.stuck.signals[STATE.p]
    np.testing.assert_allclose(found.believed, aircraft.effect, atol=0.2)
    aircraft.stuck = {}
    watch(found, aircraft, 100)
    aircraft.delay = 15
    watch(found, aircraft, 200)
    assert found.delay_samples == 15
    alarms = found.alarms
    for _ in range(30):
        watch(found, aircraft, 25)
        skip(found, aircraft, 2)
        assert found.delay_samples == 15
    assert found.alarms == alarms


@pytest.mark.parametrize("axes", [(0, 1, 2), (1,)])
@pytest.mark.parametrize("broken", [0.01, 0.05])
def test_a_gyro_that_becomes_noisy_is_no_surface_that_changed(axes, broken):
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 600)
    noise = np.full(3, 6.3e-4)
    noise[list(axes)] = broken
    aircraft.noise = noise
    watch(found, aircraft, 50)
    believed = []
    for _ in range(60):
        watch(found, aircraft, 10)
        believed.append(found.believed.copy())
    np.testing.assert_allclose(believed, 1.0, atol=0.3)
    ratio = np.sqrt(found.unrest.variances) / noise
    assert (ratio > 0.7).all()
    assert (ratio < 2.0).all()
    # What surfaces do is still found, and that the gyro is well again.
    aircraft.effect = np.array([-1.0, 1.0, 1.0])
    watch(found, aircraft, 300)
    assert found.believed[0] < -0.5
    aircraft.noise = 6.3e-4
    watch(found, aircraft, 400)
    assert max(found.unrest.variances) < (2e-3) ** 2


def test_surfaces_that_swing_the_aircraft_are_no_noise():
    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 600)
    aircraft.command = lambda: 0.15 * np.sign(np.sin(2.0 * np.pi * aircraft.tick / np.array([4.0, 5.0, 6.0])))
    for _ in range(200):
        watch(found, aircraft, 1)
        assert not found.unrest.broke


def test_a_flight_that_starts_again_is_like_the_first():
    found, seen = Effectiveness(SETTINGS, MODEL, 1), []
    for _ in range(2):
        aircraft = Aircraft(noise=6.3e-4)
        alarms = watch(found, aircraft, 300)
        aircraft.effect = np.array([-1.0, 1.0, 1.0])
        seen.append((alarms, watch(found, aircraft, 100), found.filter.s.copy()))
        found.reset()
    assert seen[0][:2] == seen[1][:2]
    np.testing.assert_array_equal(seen[0][2], seen[1][2])


def test_nothing_is_allocated_in_flight_that_stays(without_collections):
    import tracemalloc

    aircraft, found = Aircraft(noise=6.3e-4), Effectiveness(SETTINGS, MODEL, 1)
    watch(found, aircraft, 300)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    watch(found, aircraft, 200)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 20_000


def test_the_imagination_gets_signed_rows_of_g_and_rates_without_noise():
    theta = np.ones((11, 6))
    settings = msgspec.structs.replace(SETTINGS, prior="population")
    model = IncrementalModel(settings, 1, theta, np.eye(11), rates=MODEL)
    aircraft = Aircraft(noise=6.3e-4)
    increments = []
    for k in range(400):
        if k == 300:
            aircraft.effect = np.array([-1.0, 1.0, 1.0])
        model.observe(aircraft.read())
        if k == 399:
            break
        u = aircraft.command()
        model.command(u)
        before = aircraft.w
        aircraft.step(u)
        increments.append(aircraft.w - before)
    identified = model.snapshot()
    effect = model.effectiveness.believed
    assert effect[0] < -0.7
    rows = identified.model[N_IDENTIFIED:N_REGRESSORS, : STATE.beta + 1]
    np.testing.assert_allclose(rows, np.tile(effect.astype(np.float32)[:, None], 6), rtol=1e-5)
    assert np.abs(identified.dx[:3] - increments[-1]).max() < 2e-4  # raw differences would be off by 9e-4
    assert (model.rls.Theta == theta).all()


def test_a_population_without_a_rate_model_is_refused_in_one_line():
    with pytest.raises(UserError, match="the population brings no rate model; export it again"):
        IncrementalModel(SETTINGS, 1, np.zeros((11, 6)), np.eye(11))
    alone = Adaptation(prior="scheduled", identify=False)
    with pytest.raises(UserError, match="prior = 'scheduled', but the population brings no rate model"):
        IncrementalModel(alone, 1, np.zeros((11, 6)), np.eye(11))
    with pytest.raises(UserError, match="needs model = 'reduced'"):
        resolve("thesis", None, ("effectiveness=structured",))


def test_policies_and_their_mirrors_are_opposed_and_nothing_else():
    rng = np.random.default_rng(0)
    good = rng.normal(size=(32, 3))
    lazy = 0.3 * good + 0.02
    mirror = good * np.array([1.0, -1.0, 1.0])
    table = opposed(np.stack([good, lazy, mirror, np.zeros_like(good)]))
    assert table.tolist() == [
        [False, False, True, False],
        [False, False, True, False],
        [True, True, False, False],
        [False, False, False, False],
    ]


def test_the_other_presets_are_as_they_were():
    assert Adaptation().effectiveness == PRESETS["thesis"].effectiveness == "none"


def test_what_is_learnt_of_the_surfaces_before_turbulence_is_known_is_forgotten():
    aircraft, found = Aircraft(), Effectiveness(SETTINGS, MODEL, 1)
    aircraft.effect[:] = 0.8  # what a gust may look like, as long as nobody knows that it is one
    watch(found, aircraft, 3 * Unrest.LEARNING - 1)
    assert found.effectiveness.max() < 0.9
    assert found.believed.max() < 0.9
    aircraft.effect[:] = 1.0
    while not found.unrest.known:
        watch(found, aircraft, 1)
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=0.01)
    np.testing.assert_allclose(found.believed, 1.0, atol=0.01)
    np.testing.assert_allclose(found.sd, SETTINGS.effectiveness_sd, rtol=0.2)
    assert watch(found, aircraft, 300) == []
