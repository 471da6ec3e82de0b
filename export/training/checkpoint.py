"""A training run's whole state in one file: arrays and JSON, no pickle, replaced atomically."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor

from task.errors import UserError
from task.files import atomic

META = "meta"


def save(path: Path, tensors: dict[str, Tensor], meta: dict[str, Any]) -> None:
    """Write tensors and JSON-like ``meta`` to an ``.npz``."""
    arrays = {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}
    arrays[META] = np.frombuffer(msgspec.json.encode(meta), dtype=np.uint8)
    with atomic(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint; raise UserError when it is not one."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        meta = msgspec.json.decode(arrays.pop(META).tobytes(), type=dict[str, Any])
        meta["config"]  # a checkpoint says what it is of
    except (OSError, ValueError, AttributeError, KeyError, EOFError, zipfile.BadZipFile, msgspec.DecodeError) as error:
        raise UserError(
            f"{path}: not a checkpoint of a training run: {said(error)}; start afresh with --fresh"
        ) from None
    return {name: torch.from_numpy(array) for name, array in arrays.items()}, meta


def said(error: Exception) -> str:
    """Return what an error says, in one line, with its kind where that alone says something."""
    lines = str(error).splitlines()
    return lines[0] if lines and not isinstance(error, KeyError) else f"{type(error).__name__} {error}".strip()


def part(tensors: dict[str, Tensor], name: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with ``name.``, without it."""
    return {k.removeprefix(f"{name}."): v for k, v in tensors.items() if k.startswith(f"{name}.")}


def require_same(path: Path, saved: dict[str, Any], config: object) -> None:
    """Raise UserError, naming the first difference, unless a checkpoint was made with this configuration.

    How long to train and how often to save may change between two starts of one run. A setting that did not exist
    when the checkpoint was made had its default.
    """
    free = ("frames", "checkpoint_seconds")
    try:
        saved = msgspec.json.decode(msgspec.json.encode(msgspec.convert(saved, type(config))))
    except msgspec.ValidationError as error:
        raise UserError(f"{path}: made by another version ({error}); start afresh with --fresh") from None
    wanted = msgspec.json.decode(msgspec.json.encode(config))
    for key in wanted:
        old, new = saved.get(key), wanted[key]
        if key not in free and old != new:
            if isinstance(new, dict) and isinstance(old, dict):
                inner = next(k for k in new if old.get(k) != new[k])
                key, old, new = f"{key}.{inner}", old.get(inner), new[inner]
            raise UserError(
                f"{path}: made with {key} = {old}, but the configuration says {new}; "
                "give that configuration, another --out, or start afresh with --fresh"
            )


def stream_state(rng: np.random.Generator) -> dict[str, Any]:
    """Return a PCG64 stream's state for JSON, whose integers are too small for it."""
    state = rng.bit_generator.state
    return {
        "state": hex(state["state"]["state"]),
        "inc": hex(state["state"]["inc"]),
        "has_uint32": state["has_uint32"],
        "uinteger": state["uinteger"],
    }


def restore_stream(rng: np.random.Generator, saved: dict[str, Any]) -> None:
    """Take up a stream where :func:`stream_state` left it."""
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": int(saved["state"], 16), "inc": int(saved["inc"], 16)},
        "has_uint32": saved["has_uint32"],
        "uinteger": saved["uinteger"],
    }
