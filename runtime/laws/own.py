"""A law of one's own, by where its class is: imported, made, and tried before anything flies (docs/own.md)."""

from __future__ import annotations

import importlib
import inspect
import os
from typing import Any, TypeGuard

import numpy as np

from runtime.laws.law import Airframe, Law
from task.config import Settings, convert, read_toml
from task.errors import UserError
from task.law_names import OwnLaw, look_here
from task.laws import N_MEMORY, N_SEEN, LinearLaw
from task.state import N_ACTION, N_REFERENCE, N_STATE, STATE


def load_own(name: str, own: OwnLaw, airframe: Airframe, dt: float, member: bool = False) -> Law:
    """Return a law of one's own at the start of a flight; it is called ``name`` in logs and tables.

    dt: sample time of the loop [s]; member: whether it is to be imagined in a cast. Raises UserError in one line for
    what cannot be imported, is no law, cannot be made, or answers a state with what is no command.
    """
    kind, where = _class_of(name, own), f"law {name}"
    arguments = (airframe, dt, *_settings(where, own, kind))
    try:
        inspect.signature(kind).bind(*arguments)
    except TypeError as error:
        raise UserError(
            f"{where}: expected {own.kind}(airframe, dt{', settings' * (len(arguments) > 2)}), got "
            f"{own.kind}{inspect.signature(kind)}: {error}"
        ) from None
    _try(where, _made(where, kind, arguments), member)
    law = _made(where, kind, arguments)  # the one that was tried has a past
    law.name = name  # so that it is called alike in options, logs and tables
    return law


def _class_of(name: str, own: OwnLaw) -> type[Law]:
    """Import the module and return the class."""
    look_here()
    try:
        module = importlib.import_module(own.module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{own.module}.".startswith(f"{error.name}."):
            raise UserError(f"law {name}: {own.module} needs {error.name}, which is not installed") from None
        raise UserError(
            f"law {name}: no module {error.name}, neither in the working directory {os.getcwd()} nor installed"
        ) from None
    except (Exception, SystemExit) as error:  # whatever somebody's module does
        raise UserError(f"law {name}: {own.module} cannot be imported: {_in_words(error)}") from None
    kind = getattr(module, own.kind, None)
    if kind is None:
        laws = [key for key, value in vars(module).items() if _is_law(value) and value.__module__ == module.__name__]
        raise UserError(
            f"law {name}: no class {own.kind} in {module.__file__}; laws there: {', '.join(laws) or 'none'}"
        )
    if not _is_law(kind):
        raise UserError(f"law {name}: expected a subclass of runtime.laws.law.Law, got {kind!r:.60}")
    return kind


def _is_law(kind: Any) -> TypeGuard[type[Law]]:
    return inspect.isclass(kind) and issubclass(kind, Law) and kind is not Law


def _settings(where: str, own: OwnLaw, kind: type[Law]) -> tuple[Settings, ...]:
    """Return the settings, where the class has any: their defaults, or those of the file."""
    if kind.settings is None:
        if own.settings is not None:
            raise UserError(
                f"{where}: {own.kind} takes no settings; leave @{own.settings} out, or say `settings = ...`"
            )
        return ()
    if not (inspect.isclass(kind.settings) and issubclass(kind.settings, Settings)):
        raise UserError(f"{where}: {own.kind}.settings: expected a subclass of task.config.Settings")
    if own.settings is None:
        return (convert({}, kind.settings, f"{where}: settings"),)
    return (convert(read_toml(own.settings, "settings of a law"), kind.settings, str(own.settings)),)


def _made(where: str, kind: type[Law], arguments: tuple[Any, ...]) -> Law:
    try:
        law = kind(*arguments)
        made = hasattr(law, "parameters")
    except Exception as error:
        raise UserError(f"{where}: cannot be made: {_in_words(error)}") from None
    if not made:
        raise UserError(f"{where}: its __init__ does not call super().__init__(airframe, dt)")
    return law


def _samples() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return states (12,) and references (3,) [rad] that a flight may begin with; nobody may write into them."""
    level, turning = np.zeros(N_STATE), np.zeros(N_STATE)
    level[[STATE.V, STATE.h, STATE.alpha, STATE.theta]] = 90.0, 2000.0, 0.05, 0.05
    turning[[STATE.V, STATE.h, STATE.p, STATE.r, STATE.phi, STATE.beta]] = 120.0, 5000.0, 0.1, -0.02, -0.4, 0.03
    samples = [(level, np.zeros(N_REFERENCE)), (level, np.full(N_REFERENCE, 0.1)), (turning, np.zeros(N_REFERENCE))]
    for sample in samples:
        for array in sample:
            array.setflags(write=False)
    return samples


def _try(where: str, law: Law, member: bool) -> None:
    """Ask a law as a flight would. Raises UserError."""
    try:
        with np.errstate(all="ignore"):  # as in flight
            law.reset()
            for x, reference in _samples():
                action = law.steer(x, reference)
                if wrong := _wrong(action, (N_ACTION,)):
                    raise UserError(f"{where}: steer: expected an array (3,) of finite floats [rad], got {wrong}")
                law.sent(action.copy())
            law.restart_history()
            if member:
                law.steer(*_samples()[0])
                _try_linear(where, law)
    except UserError:
        raise
    except NotImplementedError:
        raise UserError(f"{where}: steer(x, reference) is not implemented") from None
    except Exception as error:
        raise UserError(f"{where}: fails at a state of level flight: {_in_words(error)}") from None


def _try_linear(where: str, law: Law) -> None:
    """Ask a law how it goes on. Raises UserError."""
    try:
        goes_on = law.linear()
    except NotImplementedError:
        raise UserError(
            f"{where}: linear() is not implemented, so it cannot be a member of a cast; fly it alone, with --law"
        ) from None
    if not isinstance(goes_on, LinearLaw):
        raise UserError(f"{where}: linear: expected a task.laws.LinearLaw, got {type(goes_on).__name__}")
    for part, shape in (("maps", (N_ACTION + N_MEMORY, N_MEMORY + N_SEEN)), ("memory", (N_MEMORY,))):
        if wrong := _wrong(getattr(goes_on, part), shape):
            raise UserError(f"{where}: linear: expected {part} {shape} of finite floats, got {wrong}")


def _wrong(array: Any, shape: tuple[int, ...]) -> str:
    """Return in words why something is no array of finite floats of this shape; empty when it is one."""
    if not isinstance(array, np.ndarray):
        return type(array).__name__
    if array.shape != shape:
        return f"shape {array.shape}"
    if array.dtype.kind != "f":
        return f"dtype {array.dtype}"
    return "" if np.isfinite(array).all() else f"{array.tolist()}"


def _in_words(error: BaseException) -> str:
    """Return an error of somebody else's code in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
