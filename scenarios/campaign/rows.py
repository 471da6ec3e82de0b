"""The rows of the tables: each a way of answering the same faults."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from runtime.config import Configuration
from runtime.presets import PRESETS, resolve
from scenarios.campaign.mirrored import MIRRORED
from task.config import Settings
from task.errors import UserError
from task.law_names import LAWS, OWN, own_law

MEMBERS = "members"
"""The task in which every member flies from the fault on, the champion until then: rows none, oracle and robust."""
NONE, ORACLE, ROBUST = "none", "oracle", "robust"
"""The champion throughout; of each flight the best member in hindsight; the one member that is best over a suite."""
FROZEN = "frozen"
"""``understudy`` in the nominal model throughout; with a preset before it, that preset in the same way."""
PERFECT, SEQUENCES = "perfect", "sequences"
"""A preset that imagines its cast in the aircraft itself; and sequences of two members there."""
CERTAIN = (
    "watch_period=0.5", "play_delay_ticks=1", "margin=0.02", "head_start=0.0", "forecast_time=0.0",
    "confirmations=1", "confirmations_watch=1", "travel_cost=0.0",
)  # fmt: skip
"""What a perfect model says is believed at once. A question costs it seconds: after an alarm there are fewer."""
DERIVED = (NONE, ROBUST, ORACLE)
"""Rows that follow from the flights of the members."""


class Row(Settings, frozen=True):
    """One way of adapting: a preset with changes, or a law in the cast's place."""

    name: str
    """How tables call it."""
    preset: str = "understudy"
    """Preset of the runtime."""
    changes: tuple[str, ...] = ()
    """``key=value`` over the preset, as the runtime's ``--set``."""
    law: str | None = None
    """A law that flies in the cast's place: a shipped one, one's own (``task.law_names``), or ``pid-mirrored``."""
    model: Literal["identified", "aircraft"] = "identified"
    """In what the cast is imagined: the runtime's model, or the aircraft itself (``scenarios.campaign.perfect``)."""
    stage: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    """In the aircraft itself each imagined flight may change its member once more after so long [s]; 0: never."""

    @property
    def alone(self) -> str | None:
        """The law that flies by itself, without population and estimator; None in every other row."""
        return None if self.law == MIRRORED else self.law

    def configuration(self, preview: bool) -> Configuration:
        """Return the runtime's configuration. Raises UserError."""
        if self.law is not None:  # nobody listens to what would be identified
            return resolve(overrides=("prior=none", "identify=false", *self.changes), switch="none")
        return resolve(self.preset, overrides=(*self.changes, f"preview={str(preview).lower()}"))


def known_rows() -> dict[str, Row]:
    """Return every row by name: the recipe hard and soft, the presets, the frozen model, the laws."""
    rows = [
        Row(name="thesis-hard", preset="thesis", changes=("switch=hard",)),
        Row(name="thesis-soft", preset="thesis"),
        *(Row(name=preset, preset=preset) for preset in PRESETS if preset != "thesis"),
        Row(name=FROZEN, changes=("identify=false",)),
        Row(name=f"ensemble-{FROZEN}", preset="ensemble", changes=("effectiveness=none",)),
        *(Row(name=f"{p}-{PERFECT}", preset=p, changes=CERTAIN, model="aircraft") for p in ("ensemble", "structured")),
        Row(name=f"ensemble-{SEQUENCES}", preset="ensemble", changes=CERTAIN, model="aircraft", stage=1.0),
        *(Row(name=law, law=law) for law in LAWS),
        Row(name=MIRRORED, law=MIRRORED),
    ]
    return {row.name: row for row in rows}


def row_names() -> list[str]:
    """Return what a list of rows may name."""
    return [*DERIVED, MEMBERS, *known_rows()]


def _split(text: str) -> list[str]:
    """Return what lies between commas; those of a list or a table part nothing."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts


def parse_row(text: str) -> Row:
    """Return the row of ``NAME=PRESET[,key=value...]`` or ``NAME=LAW``. Raises UserError."""
    name, equals, rest = text.partition("=")
    preset, *changes = _split(rest)
    if not equals or not name or name in (MEMBERS, *DERIVED):
        raise UserError(f"--row {text}: expected NAME=PRESET[,key=value...] or NAME=LAW, with a name of its own")
    if preset in LAWS or own_law(preset):
        if changes:
            raise UserError(f"--row {text}: a law takes no key=value; its settings are in {OWN}@FILE.toml")
        return Row(name=name, law=preset)
    row = Row(name=name, preset=preset, changes=tuple(changes))
    row.configuration(True)
    return row


def choose_rows(names: str | None, extra: tuple[str, ...]) -> list[Row | Literal["members"]]:
    """Return the rows of a comma-separated list and those that ``extra`` describes.

    Without a list all of them but those that imagine in the aircraft itself, which take hours.

    The members' flights come with any of the rows that follow from them, and always in a full campaign; ``none`` on its
    own is flown on its own.
    """
    known = known_rows()
    quick = [name for name, row in known.items() if row.model == "identified"]
    wanted = [name.strip() for name in names.split(",")] if names else [MEMBERS, *quick]
    derived: tuple[str, ...] = DERIVED
    if not {MEMBERS, ORACLE, ROBUST} & set(wanted):
        derived, known = (), {NONE: Row(name=NONE, changes=("switch=none",)), **known}
    chosen: list[Row | Literal["members"]] = []
    for name in dict.fromkeys(MEMBERS if name in derived else name for name in wanted if name):
        if name == MEMBERS:
            chosen.append("members")
        elif name in known:
            chosen.append(known[name])
        elif own_law(name):
            chosen.append(Row(name=name, law=name))
        else:
            raise UserError(
                f"--rows {names}: unknown row {name!r}; choose from {', '.join(row_names())}, or {OWN} of a law of "
                "your own"
            )
    chosen += [parse_row(text) for text in extra]
    if not chosen:
        raise UserError(f"--rows {names}: expected at least one row; choose from {', '.join(row_names())}")
    labels = [row if isinstance(row, str) else row.name for row in chosen]
    if twice := {label for label in labels if labels.count(label) > 1}:
        raise UserError(f"--row {min(twice)}: there is a row of this name already; give it another")
    return chosen
