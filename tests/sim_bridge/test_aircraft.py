"""The identified aircraft: generated files, the fit's machinery, and a compact regression against the reference."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_bridge import presets
from sim_bridge.aircraft import build, identify, page, recordings, spools, structure
from sim_bridge.aircraft.cli import aircraft
from sim_bridge.aircraft.coefficients import Spool, Term, evaluate, load
from sim_bridge.aircraft.fly import SIGNALS, deviation, fly_window
from sim_bridge.aircraft.regression import NormalEquations, solve, unknown
from sim_bridge.aircraft.targets import moment_samples
from sim_bridge.conditions import NOMINAL
from sim_bridge.plant import Plant
from task.errors import UserError
from task.results import Result, read
from task.state import STATE


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant()


def test_committed_model_is_what_the_coefficients_generate() -> None:
    committed = build.ROOT / "aircraft" / build.MODEL_NAME / f"{build.MODEL_NAME}.xml"
    assert committed.read_text() == build.citation_xml(load())


def test_committed_coefficients_are_what_the_recordings_give() -> None:
    """One axis stands for all: Cn from every healthy recording.

    A table of sideslip and a slope over angle of attack both hold what is linear in sideslip, and so for the rudder.
    How it is shared between them the fit does not know: a ridge of 1e-12 decides, and with it the processor's rounding.
    What they add up to is known to the last digits.
    """
    shared = {"sideslip_table": "beta_alpha", "rudder_table": "rudder_alpha"}
    unknowns = structure.aerodynamics()["Cn"]
    samples = [
        moment_samples(recording, identify.BODY, identify.YAW_DAMPER)
        for case in identify.TRIMS
        for recording in recordings.load_case(case)
    ]
    first, *others = (NormalEquations.of(unknowns, data, target["Cn"]) for data, target in samples)
    found, committed = solve(unknowns, sum(others, first), identify.PENALTY), load().aerodynamics["Cn"]
    assert [term.name for term in found] == [term.name for term in committed]
    assert {term.name for term in found} > {*shared, *shared.values()}
    for term, expected in zip(found, committed, strict=True):
        known = term.name not in {*shared, *shared.values()}
        assert term.values == pytest.approx(expected.values, rel=1e-6 if known else 1e-3, abs=1e-9 if known else 1e-5)
    moments = [(evaluate(found, data), evaluate(committed, data)) for data, _ in samples]
    largest = max(np.abs(expected).max() for _, expected in moments)
    for moment, expected in moments:
        np.testing.assert_allclose(moment, expected, rtol=0.0, atol=1e-9 * largest)


@pytest.mark.parametrize(
    ("case", "manoeuvre", "window", "faults", "limits"),
    [
        ("h2000_v90", "closed_large_A", 1, (), [1.5, 2, 1.5, 5, 1.5, 1, 2, 2]),
        ("h2000_v90", "rudder15", 0, (), [1.5, 2, 1.5, 2, 1.5, 1, 1, 2]),
        ("h2000_v150", "closed_excited", 0, (), [1, 1, 1, 2, 1, 1, 1, 1.5]),
        ("h10000_v90", "pushpull", 0, (), [0.1, 3.5, 0.1, 2.5, 3, 0.1, 0.1, 3]),
        ("ice", "closed_excited", 0, presets.F1, [2, 6, 3, 6, 3, 2, 3, 5]),
        ("cg", "3211", 0, presets.F2, [0.5, 3, 0.5, 1, 3, 0.5, 0.5, 4]),
        ("be", "step_de_p05", 0, presets.F5, [np.inf, 6, np.inf, 4, 9, np.inf, np.inf, 3]),
    ],
)
def test_open_loop_for_20_s_stays_close_to_the_reference(plant: Plant, case, manoeuvre, window, faults, limits) -> None:
    recording = recordings.load(case, manoeuvre)
    start = window * 2000
    flown = fly_window(plant, recording, start, identify.TRIMS.get(case, NOMINAL), identify.YAW_DAMPER, faults)
    error = (flown - recording.x[start + 1 : start + 2001])[:, SIGNALS]
    scale = deviation(recordings.load_case(case))
    relative = 100.0 * np.sqrt((error**2).mean(axis=0)) / scale
    assert (relative <= limits).all(), dict(zip([s.name for s in SIGNALS], relative.round(2), strict=True))


def test_gust_pitches_the_aircraft_as_recorded(plant: Plant) -> None:
    recording = recordings.load("gust", "free60")
    flown = fly_window(plant, recording, 1900, NOMINAL, identify.YAW_DAMPER, presets.R3_GUST, seconds=2.0)
    truth = recording.x[1901:2101]
    assert np.abs(flown[:, STATE.alpha] - truth[:, STATE.alpha]).max() < np.deg2rad(0.15)
    change = truth[-1, STATE.alpha] - truth[0, STATE.alpha]
    assert flown[-1, STATE.alpha] - flown[0, STATE.alpha] == pytest.approx(change, rel=0.1)


def test_level_flight_needs_the_references_engine_speeds(plant: Plant) -> None:
    """The recordings of level flight were not used in the fit."""
    level = recordings.load("cg_for", "3211")
    plant.reset(identify.TRIMS["h2000_v90"].__class__(flight_path=0.0))
    assert plant.trim.n1 == pytest.approx(level.n1[0], abs=0.5)
    assert plant.trim.n2 == pytest.approx(level.n2[0], abs=0.5)
    assert np.rad2deg(plant.trim.x[STATE.alpha] - level.x[0, STATE.alpha]) == pytest.approx(0.0, abs=0.05)


def test_regression_recovers_a_table_and_keeps_its_definition() -> None:
    rng = np.random.default_rng(0)
    data = {"alpha": rng.uniform(-0.1, 0.2, 4000), "beta": rng.uniform(-0.1, 0.1, 4000)}
    truth = [
        Term(name="a", values=[1.0, -0.5, 2.0], axes=unknown("", {"alpha": [-0.1, 0.05, 0.2]}).term.axes),
        Term(
            name="b", values=[0.3, 0.0, -0.2], axes=unknown("", {"beta": [-0.1, 0.0, 0.1]}).term.axes, factors=["alpha"]
        ),
    ]
    unknowns = [
        unknown("a", {"alpha": [-0.1, 0.05, 0.2]}),
        unknown("b", {"beta": [-0.1, 0.0, 0.1]}, ("alpha",), zero_at=0.0),
    ]
    equations = NormalEquations.of(unknowns, data, evaluate(truth, data))
    halves = [
        NormalEquations.of(unknowns, {k: v[part] for k, v in data.items()}, evaluate(truth, data)[part])
        for part in (slice(0, 2000), slice(2000, None))
    ]
    assert (halves[0] + halves[1]).gram == pytest.approx(equations.gram)
    for found, true in zip(solve(unknowns, equations, 1e-12), truth, strict=True):
        assert found.values == pytest.approx(true.values, abs=1e-4)
    assert solve(unknowns, equations, 1e-12)[1].values[1] == 0.0


def test_spool_is_recovered_from_its_own_response() -> None:
    truth = load().engine.n2
    rng = np.random.default_rng(1)
    count = 20000
    data = {
        "n2": rng.uniform(50.0, 92.0, count),
        "speed_error": rng.uniform(-3.0, 1.0, count),
        "set_speed_offset": rng.choice([0.0, 1.0], count),
        "altitude_offset": rng.choice([0.0, 0.8], count),
    }
    y = spools.rate(truth, data["n2"], data)
    found = spools.identify_spool(spools.n2_guess(), data["n2"], y, data)
    assert isinstance(found, Spool)
    left = spools.rate(found, data["n2"], data) - y
    assert left.std() < 0.1 * y.std()
    assert np.median(np.abs(left)) < 0.01 * y.std()
    assert found.gain == pytest.approx(truth.gain, rel=0.1)


def test_recorded_ice_is_the_presets() -> None:
    assert load().icing.drag == pytest.approx(presets.F1[0].drag, abs=5e-4)


def test_recordings_are_as_described() -> None:
    recording = recordings.load("h2000_v90", "free60")
    assert recording.x.shape == (6000, 12)
    assert recording.dt == 0.01
    air = recordings.standard_atmosphere(np.array([0.0, 2000.0, 10000.0]))
    assert air.density == pytest.approx([1.225, 1.0066, 0.41351], rel=2e-4)
    assert len(list(recordings.FOLDER.glob("*/*.npz"))) == 41


def test_missing_recordings_are_one_clear_line(tmp_path) -> None:
    with pytest.raises(UserError, match="no recordings"):
        recordings.load_case("ice", tmp_path)
    with pytest.raises(UserError, match="not a recording"):
        recordings.load("ice", "nothing", tmp_path)


def test_command_builds_what_is_committed() -> None:
    outcome = CliRunner().invoke(aircraft, ["build"])
    assert outcome.exit_code == 0, outcome.output
    assert outcome.output.strip().endswith("citation.xml")


def test_page_shows_what_was_measured() -> None:
    root = Path(__file__).parents[2]
    text = (root / page.PAGE).read_text()
    assert page.replace(text, read(root / "results" / "aircraft.json")) == text


def test_page_without_marks_is_one_clear_line() -> None:
    result = Result(title="", command="", seconds=0.0, runs=0, seeds=[], claims=[])
    with pytest.raises(UserError, match="measured: begin"):
        page.replace("nothing here", result)
