"""The classical laws as modes: flown when they are named, by the runtime under the same name."""

import re
from pathlib import Path

import pytest

from runtime.cli import main as runtime
from runtime.laws.catalogue import LAWS
from scenarios.campaign.rows import choose_rows, known_rows, parse_row
from scenarios.chapter8.command import FLOWN_LAWS
from scenarios.cli import chosen_modes, fly
from scenarios.outputs import file_name
from scenarios.panels import MODE_COLOURS, colour
from scenarios.references import build
from scenarios.run import fly as fly_job
from scenarios.run import inputs_digest, plan
from scenarios.schema import CHOICES, MODES, PEERS, Scenario, load_scenario, mode_named
from sim_bridge.flight import Flight
from task.errors import UserError
from task.files import find_population
from task.results import read

ROOT = Path(__file__).parents[2]
LAW = """
import numpy as np
from runtime.laws.law import Law
class Mine(Law):
    def steer(self, x, reference):
        self._action[0] = self.trim(self.pressure_ratio(x.tolist())) + 0.5 * x[1] + x[7] - reference[0]
        return self._action
"""


def help_of(command, option):
    (found,) = [p.help for p in command.params if option in p.opts]
    return found


def test_the_same_laws_are_offered_everywhere():
    assert tuple(PEERS) == LAWS
    assert set(LAWS) <= set(known_rows())
    for said in (help_of(runtime, "--law"), help_of(fly, "--modes")):
        assert set(LAWS) <= set(re.findall(r"[\w-]+", said))
        assert "MODULE:CLASS of " in said
    assert set(MODE_COLOURS) == set(CHOICES)
    assert len({colour(mode) for mode in CHOICES}) == len(CHOICES)


def test_the_table_of_chapter_8_is_that_of_the_modes_it_flies():
    (table,) = [t for t in read(ROOT / "results/chapter8.json").tables if t.title.startswith("By mode")]
    assert [row[0] for row in table.rows] == [*MODES, *FLOWN_LAWS]


def test_every_peer_is_a_law_of_the_runtime_and_switches_nothing():
    assert PEERS
    for name, mode in PEERS.items():
        assert mode.name == name
        assert mode.law == name
        assert mode.law in LAWS
        assert mode.switch == "none"


def test_peers_are_flown_when_they_are_named_and_only_then(tmp_path):
    assert Scenario(title="x").modes == tuple(MODES)
    assert [mode.name for mode in chosen_modes("none,pid,pid", ())] == ["none", "pid"]
    file = tmp_path / "peers.toml"
    file.write_text('title = "x"\nmodes = ["indi-rls-signfree", "indi"]\n')
    assert load_scenario(file).modes == ("indi-rls-signfree", "indi")


def test_an_unknown_mode_is_answered_with_the_peers_too():
    with pytest.raises(UserError, match=r"unknown mode 'lqr'; choose from none, .*, structured, ensemble, pid, indi"):
        chosen_modes("lqr", ())


def test_no_mode_at_all_is_not_taken_for_the_scenarios_own():
    assert [mode.name for mode in chosen_modes(None, ("none", "pid"))] == ["none", "pid"]
    with pytest.raises(UserError, match="unknown mode ''"):
        chosen_modes("", ("none", "pid"))


def test_a_law_of_ones_own_is_a_mode_and_a_row(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('title = "x"\nmodes = ["none", "my_law:Mine@gains/fast.toml"]\n')
    mode = mode_named(load_scenario(file).modes[1])
    assert (mode.name, mode.law, mode.switch) == (*["my_law:Mine@gains/fast.toml"] * 2, "none")
    assert chosen_modes("my_law:Mine", ())[0].law == "my_law:Mine"
    assert file_name(mode.name) == "my_law_Mine_gains_fast.toml"
    assert [file_name(name) for name in CHOICES] == list(CHOICES)
    rows = choose_rows("none,my_law:Mine", ("fast=my_law:Mine@fast.toml", "slow=pid"))
    assert [(r.name, r.alone) for r in rows[1:]] == [
        ("my_law:Mine", "my_law:Mine"),
        ("fast", "my_law:Mine@fast.toml"),
        ("slow", "pid"),
    ]
    with pytest.raises(UserError, match=r"a law takes no key=value; its settings are in MODULE:CLASS@FILE\.toml"):
        parse_row("fast=my_law:Mine,gain=2")
    for wrong in (lambda: choose_rows("none,lqr", ()), lambda: chosen_modes("lqr", ())):
        with pytest.raises(UserError, match=r"unknown .* 'lqr'; choose from .*, or MODULE:CLASS of a law of your own"):
            wrong()


def test_a_law_of_ones_own_flies_a_scenario_and_is_flown_again_when_it_has_changed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    Path("law_of_a_scenario.py").write_text(LAW)
    scenario = Scenario(title="x", flight=Flight(duration=2.0))
    (mode,) = chosen_modes("law_of_a_scenario:Mine", ())
    (job,) = plan(scenario.flight, build(scenario, tmp_path), [mode], find_population("citation"), tmp_path / "out")
    result = fly_job(job)
    assert result.score.survived
    assert result.adaptation.members == ["law_of_a_scenario:Mine"]
    assert fly_job(job).reused
    before = inputs_digest(job)
    Path("law_of_a_scenario.py").write_text(LAW + "# changed\n")
    assert inputs_digest(job) != before
    Path("law_of_a_scenario.py").write_text(LAW.replace("return self._action", "return x"))
    with pytest.raises(UserError, match=r"law_of_a_scenario:Mine, base: runtime: law .*: steer: expected an array"):
        fly_job(job)
