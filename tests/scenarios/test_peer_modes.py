"""The classical laws as modes: flown when they are named, by the runtime under the same name."""

import pytest

from runtime.laws.catalogue import LAWS
from scenarios.cli import chosen_modes
from scenarios.schema import MODES, PEERS, Scenario, load_scenario
from task.errors import UserError


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
