"""States that cannot be used: the shipped cast flies on what its model foretells, and holds only where it has none."""

from pathlib import Path

import numpy as np
import pytest

from runtime.continuity import Continuity
from runtime.identification import IncrementalModel
from runtime.laws.catalogue import load_solo
from runtime.loop import Outcome
from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from task.reference import base_reference
from task.state import N_STATE, STATE

CITATION = Path("populations/citation")
ROWS = base_reference(20.0, 0.056)
SPREAD = np.zeros(N_STATE)
SPREAD[: STATE.r + 1], SPREAD[STATE.V], SPREAD[STATE.alpha : STATE.psi + 1], SPREAD[STATE.h] = 0.2, 10.0, 0.06, 500.0


@pytest.fixture(scope="module")
def citation():
    return load_population(CITATION)


def fly(link, population, log, preset="ensemble", overrides=()):
    flies = load_solo("pid") if population is None else population
    if population is None:
        preset, overrides = "understudy", ("prior=none", "effectiveness=none")
    configuration = resolve(preset, None, overrides, "none" if population is None else None)
    with Session(link, flies, RecordedReference(ROWS), configuration, log, overwrite=True) as session:
        (flown,) = session.fly()
    return flown


def spoiled(first, ticks, spoil):
    """Return a distortion of ``ticks`` states from tick ``first`` on."""
    return lambda tick, x: spoil(x) if first <= tick < first + ticks else x


def garbage(seed):
    rng = np.random.default_rng(seed)
    return lambda x: x + rng.uniform(-SPREAD, SPREAD)


def nan(x):
    return np.where(np.arange(N_STATE) == STATE.q, np.nan, x)


@pytest.mark.parametrize(
    ("preset", "ticks", "spoil", "flag"),
    [
        ("ensemble", 20, garbage(1), "state_jumps"),
        ("structured", 20, garbage(2), "state_jumps"),
        ("ensemble", 150, garbage(3), "state_jumps"),
        ("ensemble", 150, nan, "state_not_finite"),
    ],
)
def test_the_model_stands_in_for_states_that_cannot_be_used(citation, plant_link, tmp_path, preset, ticks, spoil, flag):
    """1.5 s without a state, in a manoeuvre, cost less than a degree; nothing is taken for a fault."""
    whole = plant_link(2000)
    fly(whole, citation, tmp_path / "whole.ulg", preset)
    link = plant_link(2000, state=spoiled(800, ticks, spoil))
    flown = fly(link, citation, tmp_path / "f.ulg", preset)
    assert flown.outcome is Outcome.OVER
    assert flown.summary.alarms == 0
    coasted = flown.summary.health["coasting"]
    assert 0.95 * ticks <= coasted <= ticks + Continuity.SOUNDEST
    assert flown.summary.health[flag] >= 0.95 * ticks
    assert "holding" not in flown.summary.health
    away = np.abs(np.array(link.x)[:, STATE.phi : STATE.psi] - np.array(whole.x)[:, STATE.phi : STATE.psi])
    assert np.degrees(away.max()) < 1.0


def test_who_has_no_model_flies_on_what_comes(plant_link, tmp_path):
    """A held command would be worse than noise: attitude that jumps is said, and used."""
    link = plant_link(2000, state=spoiled(800, 100, garbage(4)))
    flown = fly(link, None, tmp_path / "f.ulg")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["state_jumps"] > 95
    assert not {"holding", "coasting"} & set(flown.summary.health)
    assert len({tuple(each) for each in link.sent[800:900]}) > 50


@pytest.mark.parametrize("ticks", [50, 150])
def test_states_that_stand_still_and_zeros_are_not_flown(citation, plant_link, tmp_path, ticks):
    """All signals at once hold their last reading, or read zero: their source has failed, not the aircraft."""
    whole = plant_link(2000)
    fly(whole, citation, tmp_path / "whole.ulg")
    last = []

    def hold(x):
        last.append(x)
        return last[0]

    for spoil in (hold, np.zeros_like):
        link = plant_link(2000, state=spoiled(800, ticks, spoil))
        flown = fly(link, citation, tmp_path / "f.ulg")
        assert flown.outcome is Outcome.OVER
        assert flown.summary.health["coasting"] >= ticks - Continuity.STILL
        away = np.abs(np.array(link.x)[:, STATE.phi : STATE.psi] - np.array(whole.x)[:, STATE.phi : STATE.psi])
        assert np.degrees(away.max()) < 2.0


def test_an_alarm_is_told_once_though_no_state_comes_after_it(citation, plant_link, tmp_path):
    def reversed_elevator(tick, action):
        return action * (-1.0, 1.0, 1.0) if tick >= 600 else action

    told = plant_link(700, reversed_elevator)
    fly(told, citation, tmp_path / "told.ulg")
    alarm = next(line for line in told.lines if line.startswith("alarm"))
    first = told.told_at[told.lines.index(alarm)] - 1
    link = plant_link(700, reversed_elevator, spoiled(first + 1, 30, nan))
    fly(link, citation, tmp_path / "f.ulg")
    said = [line for line, tick in zip(link.lines, link.told_at, strict=True) if first + 1 < tick <= first + 31]
    assert not [line for line in said if line.startswith(("alarm", "suspected"))]


def test_an_attitude_that_is_aligned_anew_is_flown_with(citation, plant_link, tmp_path):
    def aligned(tick, x):
        return x + (np.isin(np.arange(N_STATE), (STATE.phi, STATE.theta)) * 0.02 if tick >= 800 else 0.0)

    flown = fly(plant_link(2000, state=aligned), citation, tmp_path / "f.ulg")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["coasting"] == 3
    assert flown.summary.alarms == 0


def test_when_the_model_has_flown_for_as_long_as_it_can_states_are_taken_as_they_come(
    citation, plant_link, tmp_path, monkeypatch
):
    monkeypatch.setattr(IncrementalModel, "COASTS", 0.3)
    flown = fly(plant_link(1000, state=spoiled(800, 100, nan)), citation, tmp_path / "nan.ulg")
    assert flown.summary.health["coasting"] == 30
    assert flown.summary.health["holding"] == 70
    flown = fly(plant_link(1000, state=spoiled(800, 100, garbage(5))), citation, tmp_path / "garbage.ulg")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["coasting"] < 60
    assert "holding" not in flown.summary.health


def test_late_commands_are_answered_for_when_they_act_while_no_state_comes(citation, plant_link, tmp_path):
    """The model foretells the state of this sample, and from there the one at which the answer acts."""
    late = [np.zeros(3)] * 10

    def delayed(tick, action):
        late.append(np.array(action))
        return late[-11] if tick > 300 else action

    link = plant_link(2000, delayed, spoiled(1200, 50, nan))
    flown = fly(link, citation, tmp_path / "f.ulg")
    assert flown.outcome is Outcome.OVER
    assert flown.summary.health["coasting"] == 50
    assert link.error(ROWS)[0] < np.radians(1.0)
