"""What a law is called wherever one is asked for: a shipped one by its name, one's own by where its class is."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import sys
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from task.config import read_bytes
from task.errors import UserError

LawName = Literal["pid", "indi", "indi-rls", "indi-rls-signfree", "indi-rls-protected"]
"""``indi-rls`` finds the effectiveness in flight and holds it positive; ``indi-rls-signfree`` lets it change sign, and
``indi-rls-protected`` keeps below the angle of attack of the stall besides."""

LAWS: tuple[LawName, ...] = get_args(LawName)
"""The shipped laws, in the order of tables."""

OWN = "MODULE:CLASS"
"""How a law of one's own is called; ``MODULE:CLASS@FILE.toml`` where it has settings (docs/own.md)."""

_WORD = r"[^\W\d]\w*"
_OWN = re.compile(rf"({_WORD}(?:\.{_WORD})*):({_WORD})(?:@([^,]+\.toml))?")


class OwnLaw(NamedTuple):
    """Where a law of one's own is."""

    module: str
    """Importable from the working directory, or installed."""
    kind: str
    """Name of its class there."""
    settings: Path | None
    """TOML file of its settings, from the working directory; None for their defaults."""


def own_law(name: str) -> OwnLaw | None:
    """Return where the law of this name is; None when it is not called as one's own are."""
    found = _OWN.fullmatch(name)
    return OwnLaw(found[1], found[2], Path(found[3]) if found[3] else None) if found else None


def why_no_law(name: str) -> str:
    """Return what is wrong with the name of a law; empty when nothing is."""
    if name in LAWS or own_law(name):
        return ""
    return f"expected one of {', '.join(LAWS)}, or {OWN} of your own, got {name!r}"


def look_here() -> None:
    """Let modules be imported from the working directory, after those that are installed."""
    here = os.getcwd()
    if not {"", here} & set(sys.path):
        sys.path.append(here)


def own_digest(name: str | None) -> str:
    """Return the SHA-256 of the files that decide a law of one's own; empty for a shipped law or none.

    They are the module, or all of the package that it is in, and its settings; nothing is imported. Raises UserError
    where there is no such file.
    """
    own = own_law(name) if name else None
    if own is None:
        return ""
    look_here()
    top = own.module.partition(".")[0]
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        raise UserError(f"law {name}: no module {top}, neither in the working directory {os.getcwd()} nor installed")
    files = [Path(spec.origin)] if spec.origin and not spec.submodule_search_locations else []
    for folder in spec.submodule_search_locations or ():
        files += sorted(p for p in Path(folder).rglob("*") if "__pycache__" not in p.parts)
    digest = hashlib.sha256()
    for file in files:
        if file.is_file():
            digest.update(file.name.encode() + b"\0" + read_bytes(file, "module of a law"))
    if own.settings is not None:
        digest.update(read_bytes(own.settings, f"settings of the law {name}"))
    return digest.hexdigest()
