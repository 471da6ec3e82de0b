"""Named presets of the adaptation, and the configuration that a preset, a file and options make together."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import msgspec

from runtime.config import Adaptation, Configuration, Operation
from task.config import Settings, convert, read_json, read_toml
from task.errors import UserError

_IDENTIFIED: dict[str, Any] = {
    "effectiveness": "structured",
    "identify": False,
    "prior": "scheduled",
    "q_gust": 8e-4,
    "q_uncommanded": 0.02,
    "excitation": math.radians(5.0),
    "foretell": True,
    "confirmations": 2,
}
"""What the presets for hard faults share: how the aircraft is identified, whoever flies it."""

PRESETS: dict[str, Adaptation] = {
    "understudy": Adaptation(),
    "structured": Adaptation(
        **_IDENTIFIED,
        t_play=1.0,
        trend_time=0.5,
        travel_cost=0.3,
        travel_free=1.0,
        head_start=0.3,
        forecast_time=0.5,
    ),
    "ensemble": Adaptation(
        **_IDENTIFIED,
        laws=("indi-rls-protected",),
        first="indi-rls-protected",
        bandwidths=(1.0,),
        elevator_reserve=math.radians(1.5),
        margin=0.5,
        head_start=15.0,
        forecast_time=0.2,
        confirmations_watch=2,
    ),
    "thesis": Adaptation(
        model="full", prior="none", p0=1e12, kappa=0.9995, t_play=2.0, horizon=2.0, margin=0.5, rho=0.05
    ),
}
"""``ensemble`` is the recommended one for a cast bred for hard faults: the surfaces' signed effectiveness and the delay
of the commands are found, laws and networks are one cast, and the model is the healthy aircraft's where it flies
otherwise.
``structured`` is the same with the networks alone. ``understudy`` is the mended recipe of chapter 8, for ideal sensors:
with noisy ones raw increments tell nothing. ``thesis`` is chapter 8 read literally: ten states, Theta = 0, t_play = t_h
= 2 s, 50 % of |R_incumbent|, rho = 0.05; p0, kappa and the meaning of 50 % for negative returns are our reading."""


def _value(text: str) -> Any:
    """Return the TOML value that ``text`` spells, or the text itself."""
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        return text


def _table_of(key: str) -> str:
    """Return which table of the configuration knows ``key``."""
    known = {f.name: t for t, kind in (("adaptation", Adaptation), ("operation", Operation)) for f in _fields(kind)}
    if key not in known:
        raise UserError(f"--set {key}: unknown key; known keys: {', '.join(known)}")
    return known[key]


def _fields(kind: type[Settings]) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(kind)


def resolve(
    preset: str | None = None,
    file: Path | None = None,
    overrides: tuple[str, ...] = (),
    switch: str | None = None,
    real_time: bool = False,
) -> Configuration:
    """Return the configuration: preset, the file over it, ``key=value`` overrides, then ``switch`` and ``real_time``.

    The file is TOML with an optional ``preset`` and tables ``[adaptation]`` and ``[operation]``, or the JSON that lies
    beside each log, by whose name's end it is known. A preset given here beats the one in the file. What all of them
    make together has to be valid, not the file alone. Raises UserError naming the file or option, the key, expected and
    got.
    """
    data: dict[str, Any] = {}
    if file is not None:
        read = read_json if file.suffix == ".json" else read_toml
        data = read(file, "configuration")
        if not isinstance(data, dict):
            convert(data, Configuration, str(file))  # which says what is expected
    name = preset or data.get("preset", "understudy")
    if not isinstance(name, str) or name not in PRESETS:
        where = f"{file}: " if preset is None else ""
        raise UserError(f"{where}preset {name!r}: unknown; choose one of {', '.join(PRESETS)}")
    data["preset"] = name
    tables = {"adaptation": msgspec.to_builtins(PRESETS[name]), "operation": {}}
    for table, values in tables.items():
        given = data.get(table, {})
        if not isinstance(given, dict):
            convert(data, Configuration, str(file))  # which says what is expected
        data[table] = values | given
    whole = {**data, **{table: dict(data[table]) for table in tables}}
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise UserError(f"--set {override}: expected key=value, as in --set kappa=0.999")
        whole[_table_of(key.strip())][key.strip()] = _value(text.strip())
    if switch is not None:
        whole["adaptation"]["switch"] = switch
    if real_time:
        whole["operation"]["real_time"] = True
    try:
        return convert(whole, Configuration, "--set" if overrides else "configuration")
    except UserError:
        if file is not None and _fault(whole) == _fault(data):
            convert(data, Configuration, str(file))  # what is wrong is the file's own
        raise


def _fault(data: dict[str, Any]) -> str:
    """Return what is wrong with a configuration; empty when nothing is."""
    try:
        convert(data, Configuration, "")
    except UserError as error:
        return str(error)
    return ""
