"""What the command says of itself, in process."""

from runtime.cli import _describe
from runtime.population import load_population
from runtime.presets import resolve


def test_who_flies_first_and_how_many_there_are_is_as_it_flies(cast_folder):
    cast = load_population(cast_folder)
    assert _describe(cast, resolve("understudy")).startswith("laws, 4 members, good flies first; preset understudy")
    assert "5 members, indi-rls-protected flies first; preset ensemble" in _describe(cast, resolve("ensemble"))
