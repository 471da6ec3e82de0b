"""Pictures of flights: the modes side by side, as in thesis figure 8.2, and one flight in full."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.legend import Legend
from matplotlib.patches import Patch
from PIL import Image

from scenarios.panels import (
    INK,
    STYLE,
    Flown,
    cast_colours,
    cast_strip,
    colour,
    deflection,
    full_time,
    innovations,
    limit,
    mark_loss,
    mark_switches,
    predicted_returns,
    shade_fault,
    tracking,
    verdict,
    who_flies,
)
from task.limits import DT
from task.state import ACTION, REFERENCE, TRACKED


class Margins(NamedTuple):
    """Where the panels of a figure lie [inch]; fixed, so that figures line up with each other."""

    left: float
    right: float
    top: float
    bottom: float
    between_columns: float
    between_rows: float


WIDTH = 12.0
"""Of the modes side by side [inch]."""
LEGEND_LINE = 0.17
"""Height of one more line of the cast's legend [inch]."""
COMPARISON = Margins(0.62, 0.12, 0.72, 0.92, 0.62, 0.34)
DETAIL = Margins(0.72, 0.15, 0.72, 0.48, 1.0, 0.3)


def _grid(figure: Figure, rows: int, ratios: Sequence[float], margins: Margins) -> GridSpec:
    """Return the grid of panels of a figure, columns as wide as ``ratios`` say."""
    width, height = figure.get_size_inches()
    columns = len(ratios)
    inside = width - margins.left - margins.right - (columns - 1) * margins.between_columns
    tall = height - margins.top - margins.bottom - (rows - 1) * margins.between_rows
    return figure.add_gridspec(
        rows,
        columns,
        width_ratios=ratios,
        left=margins.left / width,
        right=1.0 - margins.right / width,
        top=1.0 - margins.top / height,
        bottom=margins.bottom / height,
        wspace=margins.between_columns * columns / inside,
        hspace=margins.between_rows * rows / tall,
    )


def _title(figure: Figure, title: str, tone: str) -> None:
    """Write the title as it is: a scenario's may hold what matplotlib takes for formulas."""
    height = figure.get_size_inches()[1]
    figure.text(
        0.012, 1.0 - 0.1 / height, title, ha="left", va="top", fontsize=11, fontweight="bold", color=tone,
        parse_math=False,
    )  # fmt: skip


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG; it holds no date, so that equal flights give equal pictures.

    In full colour: a palette of 256 would go by area, and gives a member that flew for a moment another's colour.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(float(STYLE["savefig.dpi"]))
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.save(path, optimize=True)
    return path


def comparison(flown: Sequence[Flown], title: str) -> Figure:
    """Return the modes one under the other: pitch, roll, their references, and the surface that the fault moves.

    All flights must be of one reference. The strip under each pitch panel says which member flies.
    """
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        rows = len(flown)
        tones, surface = cast_colours(flown), moved_surface(flown)
        columns = _cast_columns(tones)
        more = max(-(-len(tones) // columns) - 1, 0)
        margins = COMPARISON._replace(bottom=COMPARISON.bottom + more * LEGEND_LINE)
        height = margins.top + margins.bottom + 1.3 * rows + margins.between_rows * (rows - 1)
        figure = Figure(figsize=(WIDTH, height))
        axes = _grid(figure, rows, (1.25, 1.0, 1.0), margins).subplots(sharex=True, sharey="col", squeeze=False)
        for one, (left, middle, right) in zip(flown, axes, strict=True):
            tracking(left, one, REFERENCE.theta, error=True)
            tracking(middle, one, REFERENCE.phi, error=True)
            deflection(right, one, surface)
            cast_strip(left, one.adaptation, tones)
            for ax in (left, middle, right):
                shade_fault(ax, one.flight, label=ax is left)
            mark_switches(left, one.adaptation)
            mark_loss(left, one)
            left.set_title(f"{one.mode}   {verdict(one.score)}", color=colour(one.mode), pad=7)
        _shared_limits(axes, flown, surface)
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
            full_time(ax, flown[0].flight)
        handles, labels = axes[0, 2].get_legend_handles_labels()
        reference = axes[0, 0].get_legend_handles_labels()[0][0]
        figure.legend([reference, *handles], ["reference", *labels], loc="upper right", ncols=3, borderaxespad=0.2)
        if tones:
            _cast_legend(figure, tones, columns)
        _title(figure, title, INK)
    return figure


def _cast_columns(tones: dict[str, str]) -> int:
    """Return how many members stand side by side in the legend of the cast: as many as the figure is wide for."""
    for columns in range(min(len(tones), 9), 1, -1):
        figure = Figure(figsize=(WIDTH, 1.0))
        renderer = FigureCanvasAgg(figure).get_renderer()
        if _cast_legend(figure, tones, columns).get_window_extent(renderer).width <= figure.bbox.width:
            return columns
    return 1


def _cast_legend(figure: Figure, tones: dict[str, str], columns: int) -> Legend:
    """Say which colour of the strips is which member."""
    patches = [Patch(color=tone, label=member) for member, tone in tones.items()]
    legend = figure.legend(
        handles=patches, loc="lower left", borderaxespad=0.2, ncols=columns, handlelength=1.0,
        handleheight=0.7, columnspacing=1.2, title="strip: who flies      ▼ change of the cast", title_fontsize=8,
        alignment="left",
    )  # fmt: skip
    for text in legend.get_texts():
        text.set_parse_math(False)  # members' names are as they are
    return legend


def moved_surface(flown: Sequence[Flown]) -> ACTION:
    """Return the surface that is moved most in the first second of the first fault; the elevator without a fault.

    Of all surfaces, or of those that the faults name: networks chatter with surfaces that are well.
    """
    travel = np.zeros(len(ACTION))
    for flight in (one.flight for one in flown):
        if flight.fault_at is not None:
            first = int(np.searchsorted(flight.time, flight.fault_at))
            travel += np.abs(np.diff(flight.command[first : first + round(1.0 / DT)], axis=0)).sum(axis=0)
    broken = set().union(*(one.broken for one in flown))
    meant = [surface in broken or not broken for surface in ACTION]
    return ACTION(int(np.argmax(np.where(meant, travel, -1.0))))


def _shared_limits(axes: np.ndarray, flown: Sequence[Flown], surface: ACTION) -> None:
    """Give each column of the comparison one y range that fits every flight that was not lost, or all of them."""
    kept = [f for f in flown if f.score.survived] or list(flown)
    for column, channel in ((0, REFERENCE.theta), (1, REFERENCE.phi)):
        values = [np.degrees(f.flight.x[:, TRACKED[channel]]) for f in kept]
        values += [np.degrees(f.flight.reference[:, channel]) for f in kept]
        limit(axes[0, column], np.concatenate(values), least=2.0)
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low - 0.08 * (high - low), high + 0.1 * (high - low))  # room for the strip and for labels
    values = [np.degrees(f.flight.command[:, surface]) for f in kept]
    limit(axes[0, 2], np.concatenate(values), least=2.0)


def detail(flown: Flown, title: str) -> Figure:
    """Return one flight in full: tracking and surfaces on the left, what the runtime thought on the right."""
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        figure = Figure(figsize=(13.0, 8.2))
        grid = _grid(figure, 6, (1.0, 1.0), DETAIL)
        first = figure.add_subplot(grid[0, 0])
        left = [first, *(figure.add_subplot(grid[i, 0], sharex=first) for i in range(1, 6))]
        right = [figure.add_subplot(grid[2 * i : 2 * i + 2, 1], sharex=first) for i in range(3)]
        for ax, channel in zip(left[:3], REFERENCE, strict=True):
            tracking(ax, flown, channel, error=True)
        for ax, axis in zip(left[3:], ACTION, strict=True):
            deflection(ax, flown, axis)
        who_flies(right[0], flown.adaptation)
        predicted_returns(right[1], flown.adaptation)
        innovations(right[2], flown.adaptation)
        for ax in (*left, *right):
            shade_fault(ax, flown.flight, label=ax in (first, right[0]))
            if ax not in (left[-1], right[-1]):
                ax.tick_params(labelbottom=False)
        for ax in (first, right[0]):
            mark_switches(ax, flown.adaptation)
        mark_loss(first, flown)
        for ax in (left[-1], right[-1]):
            ax.set_xlabel("time [s]")
        full_time(first, flown.flight)
        first.set_title("Tracking", pad=8)
        left[3].set_title("Commands and surfaces")
        left[3].legend(loc="lower right", ncols=2, borderaxespad=0.0, bbox_to_anchor=(1.0, 1.0))
        first.legend(loc="lower right", ncols=2, borderaxespad=0.0, bbox_to_anchor=(1.0, 1.0))
        for ax in (*left, *right[1:]):
            ax.yaxis.set_label_coords(-0.5 / (0.45 * figure.get_size_inches()[0]), 0.5)
        _title(figure, title, colour(flown.mode))
    return figure
