"""What a scripted flight is: a TOML file of this shape; unknown keys are refused and named."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from sim_bridge.flight import Flight
from task.config import Settings, load_toml
from task.errors import UserError
from task.law_names import LAWS, OWN, own_law
from task.reference import FAMILIES, FamilyName

FOLDER = Path(__file__).parent
"""Where the scenarios of this package lie."""

Seed = Annotated[int, msgspec.Meta(ge=0)]


class Mode(NamedTuple):
    """One way of adapting: the runtime's preset and how it changes the cast."""

    name: str
    preset: Literal["thesis", "understudy", "structured", "ensemble"]
    switch: Literal["none", "hard", "soft"]
    law: str | None = None
    """A law that flies in the population's place: a shipped one (docs/laws.md), or one's own (docs/own.md)."""


MODES: dict[str, Mode] = {
    mode.name: mode
    for mode in (
        Mode("none", "understudy", "none"),
        Mode("thesis-hard", "thesis", "hard"),
        Mode("thesis-soft", "thesis", "soft"),
        Mode("understudy-hard", "understudy", "hard"),
        Mode("understudy-soft", "understudy", "soft"),
    )
}
"""``none`` flies the champion throughout; ``thesis`` is chapter 8 as published, ``understudy`` what we recommend."""

STRUCTURED = {name: Mode(name, name, "soft") for name in ("structured", "ensemble")}
"""The presets for surfaces that work backwards (docs/adaptation.md), networks alone and with laws as members; flown
when they are asked for."""

PEERS: dict[str, Mode] = {law: Mode(law, "understudy", "none", law) for law in LAWS}
"""Classical laws on the same link, references and faults; flown when they are asked for."""

CHOICES = MODES | STRUCTURED | PEERS
"""Every mode that has a name; a law of one's own is another, called as ``task.law_names`` says."""

KNOWN = f"{', '.join(CHOICES)}, or {OWN} of a law of your own"


def mode_named(name: str) -> Mode | None:
    """Return the mode of this name; None when there is none."""
    return CHOICES.get(name) or (Mode(name, "understudy", "none", name) if own_law(name) else None)


class References(Settings, frozen=True):
    """What the aircraft is to follow: the thesis's fixed base case, random draws of a family, or a file."""

    source: Literal["base", "random", "file"] = "base"
    """Which of the three."""
    family: FamilyName | None = None
    """Family of random references (``task.reference.FAMILIES``); evaluation when none is named."""
    seeds: tuple[Seed, ...] | None = None
    """One random reference for each seed; (1,) when there are none."""
    file: str | None = None
    """CSV or NPY of t, theta, phi, beta [s, rad], absolute angles; relative to the scenario's folder."""

    def drawn(self) -> tuple[int, ...]:
        """Return the seeds of random references."""
        return (1,) if self.seeds is None else self.seeds

    def kind(self) -> FamilyName:
        """Return the family of random references."""
        return self.family or "evaluation"


USED_BY = {"family": "random", "seeds": "random", "file": "file"}
"""Keys of the references that belong to one source."""


class Scenario(Settings, frozen=True):
    """A scripted flight: the aircraft and what breaks in it, what it is to follow, and the modes that are compared."""

    title: str
    """One line for the head of tables and reports."""
    description: str = ""
    """What is to be seen; a sentence or two."""
    flight: Flight = Flight()
    """The bridge's side: duration, condition, wind, sensors, faults, seed."""
    references: References = References()
    """The references; the pitch reference of ``base`` and ``random`` is added to the trim pitch."""
    modes: tuple[str, ...] = tuple(MODES)
    """Which modes are flown, all on the same references; ``structured`` and the laws only when they are named."""
    population: str = "serl50"
    """The cast: a folder, or the name of one under ``populations/``."""


def available() -> dict[str, Path]:
    """Return the scenarios of this package: bare name and file."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}


def find(name: str) -> Path:
    """Return the file of a scenario given by path or by bare name. Raises UserError."""
    known, path = available(), Path(name)
    if name in known:  # whatever else is called so here: ./NAME is a file
        return known[name]
    if path.suffix == ".toml" or path.is_file():
        return path
    raise UserError(f"scenario {name!r}: no such scenario; choose one of {', '.join(known)}, or give a .toml file")


def load_scenario(path: Path) -> Scenario:
    """Read a scenario. Raises UserError that says file, key, expected and got."""
    scenario = load_toml(path, Scenario, "scenario")
    references = scenario.references
    if not scenario.modes:
        raise UserError(f"{path}: modes: expected at least one of {KNOWN}, got none")
    for i, name in enumerate(scenario.modes):
        if mode_named(name) is None:
            raise UserError(f"{path}: unknown mode {name!r} - at `$.modes[{i}]`; choose from {KNOWN}")
    if len(set(scenario.modes)) < len(scenario.modes):
        raise UserError(f"{path}: modes: expected each mode once, got {', '.join(scenario.modes)}")
    for fault in scenario.flight.beyond_its_end():
        raise UserError(f"{path}: flight.{fault}; let it begin earlier, or fly longer")
    _check(references, path)
    return scenario


def _check(references: References, path: Path) -> None:
    """See that the references' keys go together. Raises UserError."""
    for key, source in USED_BY.items():
        if getattr(references, key) is not None and references.source != source:
            raise UserError(
                f"{path}: references.{key}: expected with source = {source!r} alone, got source = "
                f"{references.source!r}, which would not use it; say source = {source!r}, or leave it out"
            )
    if references.source == "file" and references.file is None:
        raise UserError(
            f"{path}: references.file: expected a CSV or NPY file, as references.source is 'file'; got none"
        )
    seeds = references.drawn()
    if not seeds:
        raise UserError(f"{path}: references.seeds: expected at least one seed for {', '.join(FAMILIES)}; got none")
    if len(set(seeds)) < len(seeds):
        raise UserError(f"{path}: references.seeds: expected each seed once, got {', '.join(map(str, seeds))}")


def to_toml(settings: Settings) -> str:
    """Return settings as TOML that reads back to the same struct; fields that are None are left out."""
    tree: Mapping[str, Any] = msgspec.to_builtins(settings)
    return "".join(f"{key} = {_value(value)}\n" for key, value in tree.items() if value is not None)


def _value(value: Any) -> str:
    """Return one TOML value; tables are written inline."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None)
        return f"{{ {inside} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(v) for v in value)}]"
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return "inf" if value > 0 else "-inf"
    return msgspec.json.encode(value).decode()  # numbers, words and booleans are written alike in JSON and TOML


def _key(key: str) -> str:
    return key if key.isidentifier() else msgspec.json.encode(key).decode()
