"""Typed configuration from TOML and JSON: frozen msgspec structs, unknown keys refused."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from task.errors import UserError

T = TypeVar("T")


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every configuration: immutable, keyword-only, unknown keys refused."""


def _keys_at(kind: Any, message: str) -> str:
    """Return the known keys of the struct that ``message`` complains about, as a hint."""
    if "unknown field" not in message:
        return ""
    if "at `$" in message:
        steps = message.rsplit("at `$", 1)[1].rstrip("`").replace("[...]", "").split(".")
        for step in filter(None, (s.split("[")[0] for s in steps)):
            kind = _field_type(kind, step)
            if kind is None:
                return ""
    try:
        return "; known keys: " + ", ".join(f.encode_name for f in msgspec.structs.fields(kind))
    except TypeError:
        return ""


def _field_type(kind: Any, name: str) -> Any:
    """Return the struct type of field ``name``, looking through containers and unions of one struct."""
    try:
        kind = next(f.type for f in msgspec.structs.fields(kind) if f.encode_name == name)
    except (TypeError, StopIteration):
        return None
    while not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        inner = [a for a in getattr(kind, "__args__", ()) if a is not type(None) and a is not Ellipsis]
        if len(inner) != 1:
            return None
        kind = inner[0]
    return kind


def convert(data: Any, kind: type[T], where: str) -> T:
    """Return ``data`` as the struct ``kind``; raise UserError naming ``where`` and the key that is wrong."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        message = str(error)
        raise UserError(f"{where}: {message[0].lower()}{message[1:]}{_keys_at(kind, message)}") from None


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
