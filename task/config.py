"""Typed configuration from TOML and JSON: frozen msgspec structs, unknown keys refused."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar, get_args

import msgspec

from task.errors import UserError

T = TypeVar("T")

LARGEST = 1e30
"""No number of a configuration is near it, and what is made of larger ones overflows."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every configuration: immutable, keyword-only, unknown keys refused, and its numbers are finite."""

    def __post_init__(self) -> None:
        """Refuse numbers that TOML can spell and no setting can be."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float) and not abs(number) <= LARGEST:
                    raise ValueError(f"{name}: expected a finite number, {LARGEST:g} at most, got {number}")


def _keys_at(kind: Any, data: Any, message: str) -> str:
    """Return the known keys of the struct that ``message`` complains about, as a hint."""
    if "unknown field" not in message:
        return ""
    path = message.rsplit("at `$", 1)[1] if "at `$" in message else ""
    for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        struct = _struct(kind, data)
        if key:
            if struct is None or not isinstance(data, dict) or key not in data:
                return ""  # the path leads through a mapping, whose keys the message does not give
            kind = next(f.type for f in msgspec.structs.fields(struct) if f.encode_name == key)
        data = data[key or int(index)]
    struct = _struct(kind, data)
    return "; known keys: " + ", ".join(f.encode_name for f in msgspec.structs.fields(struct)) if struct else ""


def _struct(kind: Any, data: Any) -> type[msgspec.Struct] | None:
    """Return the struct that ``data`` is meant as, looking through containers; of tagged ones, the one it names."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        tag = kind.__struct_config__.tag
        named = data.get(kind.__struct_config__.tag_field) if tag is not None and isinstance(data, dict) else tag
        return kind if named == tag else None
    found = (_struct(inner, data) for inner in get_args(kind))
    return next((struct for struct in found if struct is not None), None)


def convert(data: Any, kind: type[T], where: str) -> T:
    """Return ``data`` as the struct ``kind``; raise UserError naming ``where`` and the key that is wrong."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        message = str(error)
        raise UserError(f"{where}: {message[0].lower()}{message[1:]}{_keys_at(kind, data, message)}") from None


def read_bytes(path: Path, what: str) -> bytes:
    """Return a file's bytes; raise UserError when it is not there or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise UserError(f"{path}: no such {what}; check the path") from None
    except OSError as error:
        raise UserError(f"{path}: cannot read the {what}: {error.strerror}") from None


def load_toml(path: Path, kind: type[T], what: str = "configuration") -> T:
    """Return a TOML file as the struct ``kind``; raise UserError with path, key, expected and got."""
    try:
        data = tomllib.loads(read_bytes(path, what).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not valid TOML: {error}") from None
    return convert(data, kind, str(path))


def load_json(path: Path, kind: type[T], what: str = "file") -> T:
    """Return a JSON file as the struct ``kind``; raise UserError with path, key, expected and got."""
    try:
        data = msgspec.json.decode(read_bytes(path, what))
    except msgspec.DecodeError as error:
        raise UserError(f"{path}: not valid JSON: {error}") from None
    return convert(data, kind, str(path))


def to_json(value: Any) -> bytes:
    """Return indented JSON of a struct at full precision."""
    return msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n"
