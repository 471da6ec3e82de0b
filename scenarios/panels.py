"""The panels that pictures of flights are made of, in one style that the colour-blind can read."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb

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
    "structured": "#AA4499",
    "ensemble": "#009E73",
    "pid": "#8c6d31",
    "indi": "#9a9a9a",
    "indi-rls": "#bcbd22",
    "indi-rls-signfree": "#000000",
    "indi-rls-protected": "#8c564b",
}
"""Okabe and Ito's colours, told apart by the colour-blind; the recipe gives the hue, hard or soft its depth."""
OWN_COLOURS = ("#5500cc", "#004d40", "#ff00cc", "#661100", "#1a237e")
"""For laws of one's own, by name, so that one keeps its colour."""
ROOM_FOR_LABEL = 10.0
"""A fault that begins later than this [s] is named before its line, where no loss is marked over it."""
LABEL_GROUND = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
"""What a label in a panel stands on, so that curves behind it do not strike it through."""
MOST_ROWS = 12
"""A larger cast does not get a row for each member."""
CAST_COLOURS = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#8c6d31", "#000000", "#5500cc",
    "#ff00cc", "#1a237e", "#ff1744", "#661100", "#7cb342", "#ffab91", "#7f7f7f", "#00ffcc", "#004d40", "#DDCC77",
)  # fmt: skip
"""Okabe and Ito's and as many more as keep away from each other (30 and more in CIELAB); then the same, paler."""
PALER = 0.6
"""How far towards white the second round of colours is taken."""

STYLE: dict[str, Any] = {
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
    broken: frozenset[int] = frozenset()
    """The surfaces that its faults name, as in ``task.state.ACTION``."""


def verdict(score: Score) -> str:
    """Return how a flight went, in a few words for a title."""
    return f"nMAE {score.nmae:.2f} %" if score.lost_at is None else f"lost at {score.lost_at:.1f} s"


def colour(mode: str) -> str:
    """Return the colour of a mode."""
    return MODE_COLOURS.get(mode) or OWN_COLOURS[zlib.crc32(mode.encode()) % len(OWN_COLOURS)]


def shade_fault(ax: Axes, flight: FlightTrace, label: bool = False) -> None:
    """Shade the times at which something is broken, and mark where it breaks."""
    for start, end in flight.fault_spans():
        ax.axvspan(start, end, color=FAULT, alpha=0.09, lw=0, zorder=0)
    onsets = flight.fault_onsets()
    for start in onsets:
        ax.axvline(start, color=FAULT, lw=1.0, zorder=1)
    if label and onsets:
        before = onsets[0] > ROOM_FOR_LABEL
        ax.annotate(
            "fault", (onsets[0], 1.0), (-3 if before else 3, -1), xycoords=("data", "axes fraction"),
            textcoords="offset points", color="#9c4a7c", fontsize=8, va="top", ha="right" if before else "left",
            zorder=5, bbox=LABEL_GROUND,
        )  # fmt: skip


def mark_loss(ax: Axes, flown: Flown) -> None:
    """Mark where the aircraft was lost."""
    lost_at = flown.score.lost_at
    if lost_at is None:
        return
    late = lost_at > 0.75 * flown.flight.planned_samples * DT
    ax.axvline(lost_at, color=INK, lw=1.2, ls=(0, (1, 1.5)))
    ax.annotate(
        f"lost at {lost_at:.1f} s", (lost_at, 0.5), (-4 if late else 4, 0), xycoords=("data", "axes fraction"),
        textcoords="offset points", ha="right" if late else "left", va="center", fontsize=8, fontweight="bold",
        color=INK, zorder=5, bbox=LABEL_GROUND,
    )  # fmt: skip


def mark_switches(ax: Axes, adaptation: AdaptationTrace) -> None:
    """Put a small triangle at the top edge for each change of the cast."""
    if adaptation.switches:
        times = [s.time for s in adaptation.switches]
        ax.plot(
            times, np.full(len(times), 1.0), "v", transform=ax.get_xaxis_transform(), color=INK, ms=4.5,
            mec="white", mew=0.5, clip_on=False, zorder=6,
        )  # fmt: skip


def tracking(ax: Axes, flown: Flown, channel: REFERENCE, error: bool = False) -> None:
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
    limit(ax, np.concatenate([actual, wanted]), least=1.0)


def limit(ax: Axes, values: np.ndarray, least: float) -> None:
    """Set the y range to the finite values with a margin, at least ``2 * least`` wide."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-least, least)
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), least)
    ax.set_ylim(middle - 1.15 * half, middle + 1.15 * half)


def deflection(ax: Axes, flown: Flown, axis: ACTION) -> None:
    """Draw one command and the deflection that it became [deg]."""
    flight = flown.flight
    command, surface = np.degrees(flight.command[:, axis]), np.degrees(flight.surfaces[:, axis])
    ax.plot(flight.time, surface, color="#bdbdbd", lw=3.0, label="true deflection")
    ax.plot(flight.time, command, color=colour(flown.mode), lw=1.1, label="command")
    ax.set_ylabel(f"{SYMBOLS[axis.name]} [deg]")
    stop = float(np.degrees(DEFLECTION_LIMIT))
    for bound in (-stop, stop):
        ax.axhline(bound, color=GREY, lw=0.6, ls=":")
    limit(ax, np.concatenate([command, surface]), least=2.0)


def cast_strip(ax: Axes, adaptation: AdaptationTrace, tones: dict[str, str]) -> None:
    """Draw who flies as a coloured strip along the bottom edge; who flies alone needs none."""
    active, time = adaptation.active, adaptation.time
    if not active.size or alone(adaptation):
        return
    edges = np.concatenate([[0], np.flatnonzero(np.diff(active)) + 1, [active.size]])
    for start, stop in itertools.pairwise(edges):
        ax.axvspan(
            time[start], time[stop - 1], 0.0, 0.055, color=tones[adaptation.members[active[start]]], lw=0, zorder=5
        )


def full_time(ax: Axes, flight: FlightTrace) -> None:
    """Show the whole planned flight, also when it ended early."""
    ax.set_xlim(0.0, flight.planned_samples * DT)


def alone(adaptation: AdaptationTrace) -> bool:
    """Return whether there was nobody else to fly: the row's own title says who did."""
    return len(adaptation.members) < 2


def cast_colours(flown: Sequence[Flown]) -> dict[str, str]:
    """Return a colour for each member of a cast, by name, that flew in any of the flights; the first to fly is first.

    No two of forty members share one.
    """
    order: dict[str, None] = {}
    for one in flown:
        names, active = one.adaptation.members, one.adaptation.active
        if active.size and not alone(one.adaptation):
            indices = [active[0], *(s.member for s in one.adaptation.switches), *np.unique(active)]
            order.update(dict.fromkeys(names[i] for i in indices))
    return {member: _tone(i) for i, member in enumerate(order)}


def _tone(index: int) -> str:
    """Return the colour of the member that is the ``index``-th to fly."""
    full = CAST_COLOURS[index % len(CAST_COLOURS)]
    if index // len(CAST_COLOURS) % 2 == 0:
        return full
    red, green, blue = (share + PALER * (1.0 - share) for share in to_rgb(full))
    return to_hex((red, green, blue))


def who_flies(ax: Axes, adaptation: AdaptationTrace) -> None:
    """Draw who flies: member against time, one row each; of a large cast those that ever flew."""
    ax.set_title("Who flies  (▼ change of the cast)", pad=8)
    count = len(adaptation.members)
    shown = list(range(count)) if count <= MOST_ROWS else sorted({int(i) for i in np.unique(adaptation.active)})
    row = {member: i for i, member in enumerate(shown)}
    ax.step(adaptation.time, [row[int(i)] for i in adaptation.active], where="post", color=INK, lw=1.6)
    for switch in adaptation.switches:
        ax.axvline(switch.time, color=GREY, lw=0.7, ls=":")
    ax.set_yticks(range(len(shown)), [adaptation.members[i] for i in shown], fontsize=7, parse_math=False)
    ax.set_ylim(len(shown) - 0.5, -0.5)


def predicted_returns(ax: Axes, adaptation: AdaptationTrace) -> None:
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
    ax.legend(loc="lower right", ncols=3, borderaxespad=0.0, bbox_to_anchor=(1.0, 1.0))


def innovations(ax: Axes, adaptation: AdaptationTrace, width: float = 0.25) -> None:
    """Draw the size of the model's one-step surprise: RMS over ``width`` seconds, over its own median."""
    ax.set_title("Innovation over its median")
    ax.set_ylabel("RMS of 0.25 s [-]")
    time, innovation = adaptation.time, adaptation.innovation
    if time.size < 2 or not innovation.size:
        return
    block = max(1, round(width / float(time[1] - time[0])))
    usable = time.size // block * block
    if not usable:
        return  # lost before the first of them was over
    squares = np.square(innovation[:usable]).reshape(-1, block, innovation.shape[1]).mean(axis=1)
    rms = np.sqrt(squares)
    centre = time[:usable].reshape(-1, block).mean(axis=1)
    median = np.median(rms, axis=0)
    shown = {STATE(i).name: tone for i, tone in zip(DYNAMIC, CAST_COLOURS, strict=False)}
    for i, name in enumerate(adaptation.innovation_names):
        if name in shown and median[i] > 0.0:
            ax.semilogy(centre, rms[:, i] / median[i], lw=0.9, color=shown[name], label=SYMBOLS.get(name, name))
    if ax.lines:
        ax.legend(loc="lower right", ncols=6, borderaxespad=0.0, columnspacing=1.0, bbox_to_anchor=(1.0, 1.0))
