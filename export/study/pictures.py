"""Pictures for the pages, small and alike."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from task.files import atomic, make_folder

FOLDER = Path("docs/img")


@contextmanager
def picture(name: str, folder: Path = FOLDER) -> Iterator[Figure]:
    """Give an empty figure, and write what has been drawn to ``docs/img/<name>.png``.

    In full colour: a palette would go by area, and gives a thin curve another's colour.
    """
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    yield figure
    make_folder(folder)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=100)
    with atomic(folder / f"{name}.png") as file:
        Image.open(drawn).convert("RGB").save(file, format="PNG", optimize=True)
