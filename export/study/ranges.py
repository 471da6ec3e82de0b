"""What a sweep varies and between which bounds, around the values of the thesis's table 1."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from export.training.config import TrainingConfig, load

UPDATES_PER_FRAME = 0.01


class Range(NamedTuple):
    """One hyperparameter; the dot parts the table of the configuration from the field."""

    name: str
    thesis: Any
    """Value of table 1."""
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    choices: tuple[Any, ...] = ()
    """Instead of bounds."""

    @property
    def text(self) -> str:
        """Return the range in words."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        return f"{self.low:g} to {self.high:g}{', log' if self.log else ''}"


_LEARNER = (
    Range("td3.batch", 86, choices=(64, 86, 128, 256)),
    Range("actor.width", 72, choices=(32, 64, 72, 96)),
    Range("actor.activation", "tanh", choices=("tanh", "relu")),
)
_GENETIC = (
    Range("genetic.mutation_magnitude", 2.47e-2, 5e-3, 1e-1, log=True),
    Range("genetic.elite_fraction", 0.3, 0.1, 0.5),
    Range("genetic.mutation_probability", 0.9, 0.3, 1.0),
)
RANGES: dict[str, tuple[Range, ...]] = {
    "td3": (
        Range("td3.learning_rate", 4.33e-4, 1e-5, 2e-3, log=True),
        Range("td3.sigma", 0.33, 0.1, 0.5),
        *(
            r._replace(thesis={"td3.batch": 64, "actor.width": 96, "actor.activation": "relu"}[r.name])
            for r in _LEARNER
        ),
    ),
    "serl10": (
        Range("td3.learning_rate", 4.82e-5, 1e-5, 2e-3, log=True),
        Range("td3.sigma", 0.29, 0.1, 0.5),
        *_LEARNER,
        *_GENETIC,
    ),
    "serl50": (
        Range("td3.learning_rate", 1.86e-5, 1e-5, 2e-3, log=True),
        Range("td3.sigma", 0.23, 0.1, 0.5),
        *(r._replace(thesis=256) if r.name == "td3.batch" else r for r in _LEARNER),
        Range("genetic.mutation_magnitude", 6.27e-2, 5e-3, 1e-1, log=True),
        Range("genetic.elite_fraction", 0.2, 0.1, 0.5),
        _GENETIC[-1],
    ),
}
"""By the shipped configuration that a trial varies."""


def configure(kind: str, values: dict[str, Any], frames: int, seed: int) -> TrainingConfig:
    """Return the shipped configuration with a trial's values, short of updates and of frames."""
    config = load(kind)
    changes: dict[str, dict[str, Any]] = {"actor": {}, "td3": {}, "genetic": {}}
    if config.genetic.population:
        changes["td3"]["updates_per_frame"] = UPDATES_PER_FRAME
        changes["genetic"] |= {"evaluations": 1, "stored_evaluations": 1, "crossover_epochs": 1}
    for name, value in values.items():
        table, field = name.split(".")
        changes[table][field] = value
    tables = {table: msgspec.structs.replace(getattr(config, table), **change) for table, change in changes.items()}
    return msgspec.structs.replace(config, name=f"sweep-{kind}", frames=frames, seed=seed, **tables)
