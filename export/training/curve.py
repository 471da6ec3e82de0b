"""The learning curve: one row a generation, as CSV and as a picture."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import matplotlib

from task.config import Settings
from task.files import atomic

matplotlib.use("Agg")


class Row(Settings, frozen=True):
    """One generation. Fitness is the mean undiscounted return of a flight (eq. 4)."""

    generation: int
    frames: int
    """Frames stored so far."""
    simulated: int
    """Frames flown so far, stored or not."""
    updates: int
    """Critic updates so far."""
    champion: float
    """Fitness of the fittest genetic actor."""
    average: float
    """Mean fitness of the genetic actors."""
    worst: float
    td3: float
    """Fitness of the TD3 actor, without its exploration where it flew without."""
    champion_smoothness: float
    """Sm of eq. 16 [rad Hz]."""
    td3_smoothness: float
    lost: int
    """Flights of this generation that ended before their time."""
    unsafe: int
    """Samples of this generation beyond the bounds of eq. 14."""
    td_loss: float
    q: float
    seconds_flying: float
    """Wall time [s]."""
    seconds_breeding: float
    seconds_learning: float

    @property
    def seconds(self) -> float:
        """Wall time of the generation [s]."""
        return self.seconds_flying + self.seconds_breeding + self.seconds_learning


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write all rows, atomically."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__struct_fields__)
    for row in rows:
        values = (getattr(row, name) for name in Row.__struct_fields__)
        writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in values])
    with atomic(path) as file:
        file.write(text.getvalue().encode())


def draw(path: Path, rows: list[Row], title: str) -> None:
    """Draw fitness against frames (thesis figure 3) and against wall time."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), sharey=True, layout="constrained")
    minutes, total = [], 0.0
    for row in rows:
        total += row.seconds / 60.0
        minutes.append(total)
    for axis, x, label in (
        (axes[0], [r.frames / 1e6 for r in rows], "frames [million]"),
        (axes[1], minutes, "wall time [min]"),
    ):
        for name, what in (("champion", "champion"), ("average", "population average"), ("td3", "TD3 actor")):
            axis.plot(x, [getattr(r, name) for r in rows], label=what, linewidth=1.2)
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("return of a flight")
    axes[0].set_yscale("symlog", linthresh=100.0)
    axes[0].legend(loc="lower right")
    figure.suptitle(title)
    with atomic(path) as file:
        figure.savefig(file, format="png", dpi=120)
    pyplot.close(figure)
