"""Pictures of flights in one style: the comparison of modes (as in thesis figure 8.2) and one flight in detail."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch

from scenarios.score import Score
from scenarios.trace import AdaptationTrace, FlightTrace
from task.limits import DEFLECTION_LIMIT, DT
from task.model import DYNAMIC
from task.state import ACTION, REFERENCE, STATE, TRACKED

INK, GREY, FAINT = "#1b1b1b", "#767676", "#d9d9d9"
FAULT = "#CC79A7"
MODE_COLOURS = {
    "none": "#5f5f5f",
    "thesis-hard": "#E69F00",
    "thesis-soft": "#D55E00",
    "understudy-hard": "#56B4E9",
    "understudy-soft": "#0072B2",
}
"""Okabe and Ito's colours, told apart by the colour-blind; the recipe gives the hue, hard or soft its depth."""
CAST_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#8c6d31", "#000000")

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 8.5,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.xmargin": 0.0,
    "grid.color": "#ececec",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.handlelength": 1.6,
    "savefig.dpi": 160,
    "figure.dpi": 160,
}

SYMBOLS = {"theta": "θ", "phi": "φ", "beta": "β", "alpha": "α", "de": "elevator", "da": "aileron", "dr": "rudder"}


@dataclass(frozen=True)
class Flown:
    """One flight as the pictures need it."""

    mode: str
    flight: FlightTrace
    adaptation: AdaptationTrace
    score: Score


def colour(mode: str) -> str:
    """Return the colour of a mode."""
    return MODE_COLOURS.get(mode, "#009E73")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG; the file holds no date, so that equal flights give equal pictures."""
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure)
    figure.savefig(path, metadata={"Software": None})
    return path


def _shade_fault(ax: Axes, flight: FlightTrace, label: bool = False) -> None:
    """Shade the times at which something is broken, and mark where it breaks."""
    spans = flight.fault_spans()
    for start, end in spans:
        ax.axvspan(start, end, color=FAULT, alpha=0.09, lw=0, zorder=0)
        ax.axvline(start, color=FAULT, lw=1.0, zorder=1)
    if label and spans:
        ax.annotate(
            "fault", (spans[0][0], 1.0), (3, -2), xycoords=("data", "axes fraction"),
            textcoords="offset points", color="#9c4a7c", fontsize=8, va="top",
        )  # fmt: skip


def _mark_loss(ax: Axes, score: Score) -> None:
    """Mark where the aircraft was lost."""
    if score.lost_at is not None:
        ax.axvline(score.lost_at, color=INK, lw=1.2, ls=(0, (1, 1.5)))
        ax.annotate(
            f"lost at {score.lost_at:.1f} s", (score.lost_at, 0.03), (-3, 0), xycoords=("data", "axes fraction"),
            textcoords="offset points", ha="right", va="bottom", fontsize=8, fontweight="bold", color=INK,
        )  # fmt: skip


def _mark_switches(ax: Axes, adaptation: AdaptationTrace) -> None:
    """Put a small triangle at the top edge for each change of the cast."""
    if adaptation.switches:
        times = [s.time for s in adaptation.switches]
        ax.plot(
            times, np.full(len(times), 1.0), "v", transform=ax.get_xaxis_transform(), color=INK, ms=4.5,
            mec="white", mew=0.5, clip_on=False, zorder=6,
        )  # fmt: skip


def _tracking(ax: Axes, flown: Flown, channel: REFERENCE, error: bool = False) -> None:
    """Draw one tracked angle and its reference [deg]."""
    flight = flown.flight
    actual = np.degrees(flight.x[:, TRACKED[channel]])
    wanted = np.degrees(flight.reference[:, channel])
    tone = colour(flown.mode)
    if error:
        ax.fill_between(flight.time, wanted, actual, color=tone, alpha=0.25, lw=0)
    ax.plot(flight.time, wanted, color=INK, lw=1.0, ls=(0, (4, 2)), label="reference")
    ax.plot(flight.time, actual, color=tone, label=f"{SYMBOLS[channel.name]}")
    ax.set_ylabel(f"{SYMBOLS[channel.name]} [deg]")
    _limit(ax, np.concatenate([actual, wanted]), least=1.0)


def _limit(ax: Axes, values: np.ndarray, least: float) -> None:
    """Set the y range to the finite values with a margin, at least ``2 * least`` wide."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-least, least)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), least)
    ax.set_ylim(middle - 1.15 * half, middle + 1.15 * half)


def _deflection(ax: Axes, flown: Flown, axis: ACTION) -> None:
    """Draw one command and the deflection that it became [deg]."""
    flight = flown.flight
    command, surface = np.degrees(flight.command[:, axis]), np.degrees(flight.surfaces[:, axis])
    ax.plot(flight.time, surface, color="#bdbdbd", lw=3.0, label="true deflection")
    ax.plot(flight.time, command, color=colour(flown.mode), lw=1.1, label="command")
    ax.set_ylabel(f"{SYMBOLS[axis.name]} [deg]")
    limit = float(np.degrees(DEFLECTION_LIMIT))
    for bound in (-limit, limit):
        ax.axhline(bound, color=GREY, lw=0.6, ls=":")
    _limit(ax, np.concatenate([command, surface]), least=2.0)


def _cast_strip(ax: Axes, adaptation: AdaptationTrace, tones: dict[int, str]) -> None:
    """Draw who flies as a coloured strip along the bottom edge."""
    active, time = adaptation.active, adaptation.time
    if not active.size:
        return
    edges = np.concatenate([[0], np.flatnonzero(np.diff(active)) + 1, [active.size]])
    for start, stop in itertools.pairwise(edges):
        ax.axvspan(time[start], time[stop - 1], 0.0, 0.055, color=tones[int(active[start])], lw=0, zorder=5)


def _full_time(ax: Axes, flight: FlightTrace) -> None:
    """Show the whole planned flight, also when it ended early."""
    ax.set_xlim(0.0, flight.planned_samples * DT)


def cast_colours(flown: Sequence[Flown]) -> dict[int, str]:
    """Return a colour for each member that flew in any of the flights; the first ever to fly comes first."""
    order: dict[int, None] = {}
    for one in flown:
        if one.adaptation.active.size:
            order.update(dict.fromkeys(int(i) for i in one.adaptation.active[[0]]))
            order.update(dict.fromkeys(s.member for s in one.adaptation.switches))
            order.update(dict.fromkeys(int(i) for i in np.unique(one.adaptation.active)))
    return {member: CAST_COLOURS[i % len(CAST_COLOURS)] for i, member in enumerate(order)}


def _figure(rows: int, columns: int, size: tuple[float, float], **grid: Any) -> tuple[Figure, np.ndarray]:
    """Return a figure and its axes in our style; no global state is left behind."""
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(h_pad=0.03, hspace=0.0, w_pad=0.05))
        axes = figure.subplots(rows, columns, squeeze=False, **grid)
    return figure, axes


def comparison(flown: Sequence[Flown], title: str) -> Figure:
    """Return the modes one under the other: pitch and roll against their reference, and the elevator.

    All flights must be of one reference. The strip under each pitch panel says which member flies.
    """
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        rows = len(flown)
        figure, axes = _figure(
            rows, 3, (12.0, 1.0 + 1.62 * rows), sharex=True, sharey="col", width_ratios=[1.25, 1.0, 1.0]
        )
        tones = cast_colours(flown)
        for one, (left, middle, right) in zip(flown, axes, strict=True):
            _tracking(left, one, REFERENCE.theta, error=True)
            _tracking(middle, one, REFERENCE.phi, error=True)
            _deflection(right, one, ACTION.de)
            _cast_strip(left, one.adaptation, tones)
            for ax in (left, middle, right):
                _shade_fault(ax, one.flight, label=ax is left)
            _mark_switches(left, one.adaptation)
            _mark_loss(left, one.score)
            left.set_title(f"{one.mode}   nMAE {one.score.nmae:.2f} %", color=colour(one.mode), pad=7)
        _shared_limits(axes, flown)
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
            _full_time(ax, flown[0].flight)
        handles, labels = axes[0, 2].get_legend_handles_labels()
        reference = axes[0, 0].get_legend_handles_labels()[0][0]
        figure.legend([reference, *handles], ["reference", *labels], loc="outside upper right", ncols=3)
        _cast_legend(figure, flown[0].adaptation.members, tones)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK)
    return figure


def _cast_legend(figure: Figure, members: Sequence[str], tones: dict[int, str]) -> None:
    """Say which colour of the strips is which member."""
    patches = [Patch(color=tone, label=members[member]) for member, tone in tones.items()]
    legend = figure.legend(
        handles=patches, loc="outside lower left", ncols=min(len(patches), 9), handlelength=1.0, handleheight=0.7,
        columnspacing=1.2, title="strip: who flies      ▼ change of the cast", title_fontsize=8, alignment="left",
    )  # fmt: skip
    legend.set_in_layout(True)


def _shared_limits(axes: np.ndarray, flown: Sequence[Flown]) -> None:
    """Give each column of the comparison one y range that fits every flight that was not lost, or all of them."""
    kept = [f for f in flown if f.score.survived] or list(flown)
    for column, channel in ((0, REFERENCE.theta), (1, REFERENCE.phi)):
        values = [np.degrees(f.flight.x[:, TRACKED[channel]]) for f in kept]
        values += [np.degrees(f.flight.reference[:, channel]) for f in kept]
        _limit(axes[0, column], np.concatenate(values), least=2.0)
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low - 0.08 * (high - low), high)  # room for the strip
    values = [np.degrees(f.flight.command[:, ACTION.de]) for f in kept]
    _limit(axes[0, 2], np.concatenate(values), least=2.0)


def detail(flown: Flown, title: str) -> Figure:
    """Return one flight in full: tracking and surfaces on the left, what the runtime thought on the right."""
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        figure, _ = _figure(1, 1, (13.0, 8.2))
        figure.clear()
        grid = figure.add_gridspec(6, 2, width_ratios=[1.0, 1.0])
        first = figure.add_subplot(grid[0, 0])
        left = [first, *(figure.add_subplot(grid[i, 0], sharex=first) for i in range(1, 6))]
        right = [figure.add_subplot(grid[2 * i : 2 * i + 2, 1], sharex=first) for i in range(3)]
        for ax, channel in zip(left[:3], REFERENCE, strict=True):
            _tracking(ax, flown, channel, error=True)
        for ax, axis in zip(left[3:], ACTION, strict=True):
            _deflection(ax, flown, axis)
        _active(right[0], flown.adaptation)
        _returns(right[1], flown.adaptation)
        _innovations(right[2], flown.adaptation)
        for ax in (*left, *right):
            _shade_fault(ax, flown.flight, label=ax in (first, right[0]))
            if ax not in (left[-1], right[-1]):
                ax.tick_params(labelbottom=False)
        for ax in (first, right[0]):
            _mark_switches(ax, flown.adaptation)
        _mark_loss(first, flown.score)
        for ax in (left[-1], right[-1]):
            ax.set_xlabel("time [s]")
        _full_time(first, flown.flight)
        first.set_title("Tracking", pad=8)
        left[3].set_title("Commands and surfaces")
        left[3].legend(loc="upper right", ncols=2, borderaxespad=0.1, bbox_to_anchor=(1.0, 1.3))
        first.legend(loc="upper right", ncols=2, borderaxespad=0.1, bbox_to_anchor=(1.0, 1.35))
        figure.align_ylabels(left)
        figure.align_ylabels(right)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold", color=colour(flown.mode))
    return figure


def _active(ax: Axes, adaptation: AdaptationTrace) -> None:
    """Draw who flies: member against time, one row each."""
    ax.set_title("Who flies  (▼ change of the cast)", pad=8)
    ax.step(adaptation.time, adaptation.active, where="post", color=INK, lw=1.6)
    for switch in adaptation.switches:
        ax.axvline(switch.time, color=GREY, lw=0.7, ls=":")
    count = len(adaptation.members)
    step = max(1, -(-count // 12))
    ticks = list(range(0, count, step))
    ax.set_yticks(ticks, [adaptation.members[i] for i in ticks], fontsize=7)
    ax.set_ylim(count - 0.5, -0.5)


def _returns(ax: Axes, adaptation: AdaptationTrace) -> None:
    """Draw the predicted return of every member at each play, the best and the incumbent picked out."""
    ax.set_title("Predicted returns")
    ax.set_ylabel("return over the horizon")
    if not adaptation.plays:
        ax.text(0.5, 0.5, "nothing was imagined", transform=ax.transAxes, ha="center", color=GREY)
        return
    time = np.array([p.time for p in adaptation.plays])
    returns = np.array([p.returns for p in adaptation.plays], dtype=float)
    cast, incumbent = returns[:, :-1], returns[:, -1]
    ax.plot(np.repeat(time, cast.shape[1]), cast.ravel(), ".", color="#a9a9a9", ms=2.6, label="each member")
    ax.plot(time, cast.max(axis=1), "o-", color="#009E73", ms=3.2, lw=0.9, label="best member")
    ax.plot(time, incumbent, "s-", color=INK, ms=2.8, lw=0.9, label="who flies")
    # A member that would crash costs hundreds: the range is that of the better half, the rest runs off below.
    finite = returns[np.isfinite(returns)]
    if finite.size:
        floor = min(float(np.percentile(finite, 40)), float(incumbent[np.isfinite(incumbent)].min(initial=0.0)))
        floor = max(floor, 12.0 * float(np.median(cast.max(axis=1))))
        ax.set_ylim(1.1 * min(floor, -1.0), 0.0)
    ax.legend(loc="upper right", ncols=3, borderaxespad=0.1, bbox_to_anchor=(1.0, 1.14))


def _innovations(ax: Axes, adaptation: AdaptationTrace, width: float = 0.25) -> None:
    """Draw the size of the model's one-step surprise: RMS over ``width`` seconds, over its own median."""
    ax.set_title("Innovation  (RMS over 0.25 s over its median)")
    ax.set_ylabel("innovation [-]")
    time, innovation = adaptation.time, adaptation.innovation
    if time.size < 2 or not innovation.size:
        return
    block = max(1, round(width / float(time[1] - time[0])))
    usable = time.size // block * block
    squares = np.square(innovation[:usable]).reshape(-1, block, innovation.shape[1]).mean(axis=1)
    rms = np.sqrt(squares)
    centre = time[:usable].reshape(-1, block).mean(axis=1)
    median = np.median(rms, axis=0)
    shown = {STATE(i).name: tone for i, tone in zip(DYNAMIC, CAST_COLOURS, strict=False)}
    for i, name in enumerate(adaptation.innovation_names):
        if name in shown and median[i] > 0.0:
            ax.semilogy(centre, rms[:, i] / median[i], lw=0.9, color=shown[name], label=SYMBOLS.get(name, name))
    ax.legend(loc="upper right", ncols=6, borderaxespad=0.1, columnspacing=1.0, bbox_to_anchor=(1.0, 1.14))
