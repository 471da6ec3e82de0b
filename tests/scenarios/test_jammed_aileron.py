"""An aircraft whose aileron jams askew is kept by a law that rolls by sideslip, and the cast lets that law fly on."""

from pathlib import Path

import numpy as np
import pytest

from runtime.loop import Outcome
from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from scenarios.campaign.flying import WorldLink
from scenarios.references import build
from scenarios.schema import find, load_scenario
from sim_bridge.world import World
from task.observation import tracking_error
from task.state import REFERENCE

ROOT = Path(__file__).parents[2]


LAW = "indi-rls-signfree"
"""A law that does not roll by sideslip."""


@pytest.mark.parametrize(
    ("changes", "outcome"), [((f"laws=['{LAW}']", f"first={LAW}", "switch=none"), Outcome.LOST), ((), Outcome.OVER)]
)
def test_it_is_kept_by_the_law_that_rolls_by_sideslip(changes, outcome, tmp_path):
    scenario, citation = load_scenario(find("jammed_aileron")), load_population(ROOT / "populations" / "citation")
    (reference,) = build(scenario, ROOT)
    link = WorldLink(World(scenario.flight), reference.rows)
    configuration = resolve("ensemble", None, changes)
    with Session(link, citation, RecordedReference(reference.rows), configuration, tmp_path / "f.ulg") as session:
        (flown,) = session.fly()
    assert flown.outcome is outcome
    if outcome is Outcome.OVER:
        assert flown.summary.switches == 0
        x = link.course.trace().x
        bank = np.degrees(np.abs(tracking_error(x, reference.rows[: len(x)])[:, REFERENCE.phi]))
        assert bank.max() < 50.0
        assert bank[-100:].max() < 0.5 * bank.max()  # the sideslip is held anyway, and the bank comes back
