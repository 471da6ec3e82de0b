"""The pictures of the lander: thesis figures 4.2 to 4.5."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from PIL import Image

from export.training.gymnasium_run import Point
from export.verification.archive import ArchiveSettings
from export.verification.lander import FAULTS

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#767676"
"""Told apart by the colour-blind."""
CASES = {"none": "nominal", "noisy_position": "F1 noisy position", "weak_engine": "F2 engine at 75 %"}
RETURNS = Normalize(-200.0, 280.0)
"""Colours of returns, the same in all maps."""
STYLE: Any = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#ececec",
    "legend.frameon": False,
    "figure.dpi": 120,
}


class Curve(NamedTuple):
    """One algorithm's learning curve."""

    name: str
    colour: str
    points: Sequence[Point]
    average: np.ndarray | None
    """(G, 2) frames and mean fitness of the population, where there is one."""


class Behaviours(NamedTuple):
    """Where policies touch down, and what they earn; (M, 2) and (M,)."""

    behaviour: np.ndarray
    returns: np.ndarray


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG in full colour, without a date."""
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.save(path, optimize=True)
    return path


def learning(curves: Sequence[Curve], episodes: int, path: Path) -> Path:
    """Draw mean and standard deviation over the validation episodes against frames (figure 4.2)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.6), layout="constrained")
        axes = figure.subplots()
        for name, colour, points, average in curves:
            x = np.array([p.frames for p in points]) / 1e6
            mean, sd = np.array([p.champion for p in points]), np.array([p.champion_sd for p in points])
            axes.plot(x, mean, color=colour, label=name)
            axes.fill_between(x, mean - sd, mean + sd, color=colour, alpha=0.15, lw=0)
            if average is not None:
                axes.plot(average[:, 0] / 1e6, average[:, 1], color=colour, ls="--", lw=0.9, label=f"{name}, average")
        axes.axhline(200.0, color=GREY, lw=0.8, ls=":")
        axes.set(xlabel="frames [million]", ylabel="return of an episode", ylim=(-400.0, 320.0), xlim=(0.0, None))
        axes.grid(True)
        axes.legend(loc="upper right", ncols=3)
        axes.set_title(f"Champion: mean and standard deviation over {episodes} episodes not trained on")
        return save(figure, path)


def _map(axes: Axes, settings: ArchiveSettings, title: str) -> None:
    axes.set(xlim=settings.x_range, ylim=settings.velocity_range[::-1], title=title, xlabel="x at touchdown")
    axes.axvspan(-0.2, 0.2, color="#f1f1f1", zorder=0)


def maps(archive: Behaviours, population: Behaviours, settings: ArchiveSettings, path: Path) -> Path:
    """Draw the archive's elites by cell and the population as points, coloured by return (figure 4.3)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.8), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        grid = np.full(settings.cells, np.nan)
        low = np.array([settings.x_range[0], settings.velocity_range[0]])
        span = np.array([settings.x_range[1], settings.velocity_range[1]]) - low
        cell = ((archive.behaviour - low) / span * settings.cells).astype(int).clip(0, np.array(settings.cells) - 1)
        grid[cell[:, 0], cell[:, 1]] = archive.returns
        extent = (*settings.x_range, *settings.velocity_range)
        left.imshow(grid.T, origin="lower", extent=extent, aspect="auto", norm=RETURNS, cmap="viridis", zorder=1)
        _map(left, settings, f"CMA-ME archive: {len(archive.returns)} linear policies")
        left.set_ylabel("vertical velocity at touchdown")
        x, v = population.behaviour.T
        points = right.scatter(
            x, v, c=population.returns, norm=RETURNS, cmap="viridis", s=22, edgecolor="white", lw=0.4
        )
        _map(right, settings, f"PDERL population: {len(population.returns)} actors")
        figure.colorbar(points, ax=[left, right], label="return", extend="min")
        return save(figure, path)


def robustness(returns: dict[str, dict[str, np.ndarray]], path: Path) -> Path:
    """Draw mean and one standard deviation of each policy, nominal and with each fault (figure 4.4)."""
    colours = (BLUE, ORANGE, GREEN, "#E69F00", "#CC79A7")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.5, 3.6), layout="constrained")
        axes = figure.subplots()
        wide = 0.8 / len(returns)
        for i, (name, cases) in enumerate(returns.items()):
            x = np.arange(len(FAULTS)) + (i - (len(returns) - 1) / 2.0) * wide
            mean = [cases[fault].mean() for fault in FAULTS]
            sd = [cases[fault].std() for fault in FAULTS]
            axes.bar(x, mean, 0.9 * wide, yerr=sd, color=colours[i], label=name, error_kw={"lw": 0.9, "capsize": 2})
        axes.axhline(200.0, color=GREY, lw=0.8, ls=":")
        axes.axhline(0.0, color=GREY, lw=0.8)
        axes.set_xticks(range(len(FAULTS)), [CASES[fault] for fault in FAULTS])
        axes.set_ylabel("return of an episode")
        axes.grid(True, axis="y")
        axes.legend(ncols=len(returns), loc="upper center", bbox_to_anchor=(0.5, 1.14))
        return save(figure, path)


def shifts(casts: dict[str, dict[str, Behaviours]], settings: ArchiveSettings, path: Path) -> Path:
    """Draw where behaviours go with each fault, arrows from nominal, coloured by the return with it (figure 4.5).

    casts: name -> fault -> behaviours in one order of policies.
    """
    faults = [fault for fault in FAULTS if fault != "none"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.4 * len(casts)), layout="constrained")
        panels = figure.subplots(len(casts), len(faults), sharex=True, sharey=True, squeeze=False)
        shown: Any = None
        for row, (name, by_fault) in zip(panels, casts.items(), strict=True):
            x0, v0 = by_fault["none"].behaviour.T
            for axes, fault in zip(row, faults, strict=True):
                x1, v1 = by_fault[fault].behaviour.T
                shown = axes.quiver(
                    x0, v0, x1 - x0, v1 - v0, by_fault[fault].returns, norm=RETURNS, cmap="viridis",
                    angles="xy", scale_units="xy", scale=1.0, width=0.003,
                )  # fmt: skip
                axes.plot(x0, v0, "o", color=GREY, ms=2.0)
                _map(axes, settings, f"{name}: {CASES[fault]}")
            row[0].set_ylabel("vertical velocity at touchdown")
        figure.colorbar(shown, ax=panels, label="return with the fault", extend="min")
        return save(figure, path)
