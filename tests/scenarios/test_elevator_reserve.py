"""An aircraft that is unstable and runs out of elevator is kept by laws that keep some of it back."""

from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from scenarios.campaign.flying import WorldLink
from scenarios.references import build
from scenarios.schema import find, load_scenario
from sim_bridge.world import World
from task.limits import DT
from task.metrics import nmae
from task.observation import tracking_error

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return by reserve [deg] how long the aircraft flew [s], its nMAE [%] and what laws were told, by the log."""
    scenario, citation = load_scenario(find("cg_beyond_neutral")), load_population(ROOT / "populations" / "citation")
    (reference,) = build(scenario, ROOT)
    found = {}
    for reserve in (0.0, 1.5):
        link = WorldLink(World(scenario.flight), reference.rows)
        log = tmp_path_factory.mktemp("reserve") / "flight.ulg"
        configuration = resolve("ensemble", None, (f"elevator_reserve={np.deg2rad(reserve)}",))
        with Session(link, citation, RecordedReference(reference.rows), configuration, log) as session:
            session.fly()
        (told,) = (t.data["alpha_highest"] for t in ULog(str(log)).data_list if t.name == "effectiveness")
        x = link.course.trace().x
        found[reserve] = len(x) * DT, nmae(tracking_error(x, reference.rows[: len(x)])), told
    return found


def test_without_a_reserve_the_aircraft_is_lost_and_with_one_it_is_kept(flown):
    (short, _, untold), (long, error, told) = flown[0.0], flown[1.5]
    assert short < 45.0
    assert long == pytest.approx(50.0, abs=0.02)
    assert error < 10.0
    assert np.isinf(untold).all()
    before, after = np.split(told, [round(20.0 / DT)])
    assert np.isinf(before).all()
    assert np.isfinite(after).mean() > 0.3
