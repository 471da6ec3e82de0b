"""Pictures for the pages, small and alike."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

FOLDER = Path("docs/img")


@contextmanager
def picture(name: str, folder: Path = FOLDER) -> Iterator[Figure]:
    """Give an empty figure, and write what has been drawn to ``docs/img/<name>.png``."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    yield figure
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=100)
