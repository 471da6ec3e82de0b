"""Typed configuration from TOML and JSON: frozen msgspec structs, unknown keys refused."""

from __future__ import annotations

import ast
import codecs
import inspect
import itertools
import math
import re
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin

import msgspec

from task.errors import UserError

T = TypeVar("T")

LARGEST = 1e30
"""No number of a configuration is near it, and what is made of larger ones overflows."""
LARGEST_INTEGER = 2**31 - 1
"""What 32 bits hold."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every configuration: immutable, keyword-only, unknown keys refused."""


class _Place(NamedTuple):
    """What a message complains about."""

    kind: Any
    """What is expected there."""
    value: Any
    """What is there."""
    around: Any
    """What is expected of the table that it lies in."""
    unit: str = ""
    """Of the number there, in brackets with a space before it; empty where the field does not say it."""


def _place(kind: Any, data: Any, message: str) -> _Place | None:
    """Return where ``message`` points to; None where it does not say so."""
    path = re.search(r"`\$([^`]*)`$", message)
    around, unit = kind, ""
    for key, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", path[1] if path else ""):
        if key:
            struct = _struct(kind, data)
            if not isinstance(data, dict) or key not in data:
                return None
            around, data = kind, data[key]
            fields = msgspec.structs.fields(struct) if struct else ()
            field = next((f for f in fields if f.encode_name == key), None)
            kind = field.type if field else None  # None: the tag of a struct
            unit = _unit(struct, field.name) if struct and field else ""
        elif index == "...":  # a mapping, whose key the message does not give
            inner = _value_kind(kind)
            found = [value for value in data.values() if _refused(value, inner)] if isinstance(data, dict) else []
            if not found:
                return None
            around, kind, data = kind, inner, found[0]
        else:
            around, data = kind, data[int(index)]
    return _Place(kind, data, around, unit)


def _unit(struct: type[msgspec.Struct], name: str) -> str:
    """Return the unit that a field's docstring gives, the first [in brackets] that is none of numbers, as it is there.

    Docstrings of fields are in the source alone; where that is not at hand, a message does without the unit.
    """
    for base in struct.__mro__:
        try:
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        except (OSError, TypeError, SyntaxError):
            continue
        for field, after in itertools.pairwise(body.body if isinstance(body, ast.ClassDef) else ()):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and field.target.id == name:
                said = after.value if isinstance(after, ast.Expr) else None
                text = str(said.value) if isinstance(said, ast.Constant) else ""
                found = re.search(r"\[(1/[^\];]*|[^\]\d][^\];]*)", text)
                return f" [{' '.join(found[1].split())}]" if found and found[1] != "-" else ""
    return ""


def _value_kind(kind: Any) -> Any:
    """Return what the values of a mapping are to be."""
    return next((get_args(k)[1] for k in (kind, *get_args(kind)) if get_origin(k) is dict), Any)


def _refused(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return True
    return False


def _choices(kind: Any) -> list[Any]:
    """Return the values that ``kind`` lets through, looking into unions and containers: of literals, or tags."""
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [tag] if (tag := kind.__struct_config__.tag) is not None else []
    return [choice for inner in get_args(kind) for choice in _choices(inner)]


def _explained(kind: Any, data: Any, message: str) -> str:
    """Return the message with what it leaves out: known keys, the choices, or what was got."""
    place = _place(kind, data, message)
    if place is None:
        return message
    said, dash, where = message.partition(" - at ")
    if "unknown field" in said:
        struct = _struct(place.kind, place.value)
        keys = ", ".join(f.encode_name for f in msgspec.structs.fields(struct)) if struct else ""
        return f"{message}; known keys: {keys}" if keys else message
    if said.startswith(("Invalid enum value", "Invalid value")):
        choices = _choices(place.kind if said.startswith("Invalid enum") else place.around)
        return f"{message}; choose from {', '.join(map(str, dict.fromkeys(choices)))}" if choices else message
    if said.startswith(("Expected", "Number out of range")) and ", got " not in said:
        unit = place.unit if isinstance(place.value, (int, float)) else ""
        return f"{said}{unit}, got {_short(place.value)}{dash}{where}"
    return message


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def _struct(kind: Any, data: Any) -> type[msgspec.Struct] | None:
    """Return the struct that ``data`` is meant as, looking through containers; of tagged ones, the one it names."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        tag = kind.__struct_config__.tag
        named = data.get(kind.__struct_config__.tag_field) if tag is not None and isinstance(data, dict) else tag
        return kind if named == tag else None
    found = (_struct(inner, data) for inner in get_args(kind))
    return next((struct for struct in found if struct is not None), None)


def convert(data: Any, kind: type[T], where: str) -> T:
    """Return ``data`` as the struct ``kind``; raise UserError naming ``where`` and the key that is wrong.

    Every number must be finite, and fit what calculates with it; integers have 32 bits.
    """
    try:
        found = msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        message = _explained(kind, data, str(error))
        raise UserError(f"{where}: {message[0].lower()}{message[1:]}") from None
    except OverflowError:  # a check of the struct's own, of a number that is refused here
        _check_numbers(data, where)
        raise
    _check_numbers(data, where)
    _check_integers(found, where)
    return found


def _check_numbers(data: Any, where: str, path: str = "$") -> None:
    """Raise UserError at the first number of ``data`` that is not finite or is too large."""
    if isinstance(data, (float, int)) and not abs(data) <= LARGEST:
        wanted = f"a number up to {LARGEST:g}" if math.isfinite(data) else "a finite number"
        raise UserError(f"{where}: expected {wanted}, got {_short(data)} - at `{path}`")
    for name, value in _parts(data):
        _check_numbers(value, where, path + name)


def _check_integers(found: Any, where: str, path: str = "$") -> None:
    """Raise UserError at the first integer of settings that 32 bits do not hold; what a struct only keeps is passed."""
    if isinstance(found, int) and not -LARGEST_INTEGER - 1 <= found <= LARGEST_INTEGER:
        raise UserError(
            f"{where}: expected an integer from {-LARGEST_INTEGER - 1} to {LARGEST_INTEGER}, got {_short(found)} "
            f"- at `{path}`"
        )
    if isinstance(found, Settings):
        for field in msgspec.structs.fields(found):
            if field.type != dict[str, Any]:
                _check_integers(getattr(found, field.name), where, f"{path}.{field.encode_name}")
    else:
        for name, value in _parts(found):
            _check_integers(value, where, path + name)


def _parts(data: Any) -> Iterator[tuple[str, Any]]:
    """Return what a table or a list holds, each with its place in a path."""
    if isinstance(data, dict):
        yield from ((f".{key}", value) for key, value in data.items())
    elif isinstance(data, (list, tuple)):
        yield from ((f"[{i}]", value) for i, value in enumerate(data))


def read_bytes(path: Path, what: str) -> bytes:
    """Return a file's bytes; raise UserError when it is not there or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise UserError(f"{path}: no such {what}; check the path") from None
    except OSError as error:
        raise UserError(f"{path}: cannot read the {what}: {error.strerror}") from None


def read_toml(path: Path, what: str = "configuration") -> dict[str, Any]:
    """Return the tables of a TOML file, with or without a byte order mark; raise UserError when it is none."""
    try:
        return tomllib.loads(read_bytes(path, what).decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not valid TOML: {error}") from None


def read_json(path: Path, what: str = "file") -> Any:
    """Return what a JSON file holds, with or without a byte order mark; raise UserError when it is none."""
    try:
        return msgspec.json.decode(read_bytes(path, what).removeprefix(codecs.BOM_UTF8))
    except msgspec.DecodeError as error:
        raise UserError(f"{path}: not valid JSON: {error}") from None


def load_toml(path: Path, kind: type[T], what: str = "configuration") -> T:
    """Return a TOML file as the struct ``kind``; raise UserError with path, key, expected and got."""
    return convert(read_toml(path, what), kind, str(path))


def load_json(path: Path, kind: type[T], what: str = "file") -> T:
    """Return a JSON file as the struct ``kind``; raise UserError with path, key, expected and got."""
    return convert(read_json(path, what), kind, str(path))


def to_json(value: Any) -> bytes:
    """Return indented JSON of a struct at full precision."""
    return msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n"
