"""What the command says of itself, in process."""

from pathlib import Path

import pytest

from runtime.cli import _describe, _load
from runtime.population import load_population
from runtime.presets import resolve
from task.errors import UserError


def test_who_flies_first_and_how_many_there_are_is_as_it_flies(cast_folder):
    cast = load_population(cast_folder)
    assert _describe(cast, resolve("understudy")).startswith("laws, 4 members, good flies first; preset understudy")
    assert "5 members, indi-rls-protected flies first; preset ensemble" in _describe(cast, resolve("ensemble"))


def test_a_population_may_be_given_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the shipped ones are found from anywhere
    cast = _load(Path("serl50"), None, resolve())
    assert cast.sha256 == load_population(Path(__file__).parents[2] / "populations" / "serl50").sha256
    with pytest.raises(UserError, match="population 'serl5': no such population; expected a folder with a manifest"):
        _load(Path("serl5"), None, resolve())
