"""One law instead of a population: a cast of one, with nothing to imagine and nothing to change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from runtime.laws.law import Law
from runtime.plays import Played

COMMAND_LAG = 1
"""Samples between a command and the increment that it moves, beyond eq. 8.2: the link's (docs/interface.md)."""


class Solo(NamedTuple):
    """A law where a :class:`runtime.population.Population` would stand."""

    law: Law
    sha256: str
    """Hash of the settings: which gains flew."""

    @property
    def name(self) -> str:
        """Return the law's name."""
        return self.law.name

    @property
    def members(self) -> list[str]:
        """Return the one member."""
        return [self.law.name]

    @property
    def champion(self) -> int:
        """Return the index of the one member."""
        return 0

    @property
    def parameters(self) -> np.ndarray:
        """Return (1, 0) float32: there is nothing that a cast could copy or blend."""
        return np.zeros((1, 0), dtype=np.float32)

    @property
    def command_lag(self) -> int:
        """Return the command lag of the link."""
        return COMMAND_LAG

    @property
    def theta(self) -> None:
        """Return None: a law brings no model prior."""
        return

    @property
    def p0(self) -> None:
        """Return None: a law brings no model prior."""
        return


class NoPlays:
    """What :class:`runtime.plays.Plays` is to a cast, to a law that flies alone: nothing is ever played."""

    asked = skipped = failed = 0

    def __init__(self) -> None:
        self.seconds: list[float] = []

    def step(self, tick: int, t: float) -> Played | None:
        """Return that nothing was decided."""
        return None
