"""Parallel coordinates, as the thesis shows its sweeps (figures 5.1 to 5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from export.study.ranges import Range

Trial = tuple[dict[str, Any], float, bool]
"""Settings, average return, and whether it was pruned."""


def place(r: Range, value: Any) -> float:
    """Return where a value stands on its axis, 0 at the bottom and 1 at the top."""
    if r.choices:
        return r.choices.index(value) / max(len(r.choices) - 1, 1)
    low, high, at = np.log([r.low, r.high, value]) if r.log else np.array([r.low, r.high, value])
    return float((at - low) / (high - low))


def draw(figure: Figure, trials: Sequence[Trial], ranges: Sequence[Range]) -> None:
    """Draw a line for each trial through its settings to its return; pruned trials are dashed and end before it."""
    figure.set_size_inches(11.0, 4.4)
    axis = figure.subplots()
    reached = [-value for _, value, pruned in trials if not pruned]
    low, high = np.log10(min(reached)), np.log10(max(reached))
    colours = matplotlib.colormaps["viridis"]
    for params, value, pruned in sorted(trials, key=lambda trial: trial[1]):
        heights = [place(r, params[r.name]) for r in ranges]
        merit = float(np.clip((high - np.log10(-value)) / max(high - low, 1e-9), 0.0, 1.0))
        if pruned:
            axis.plot(heights, "--", color="0.6", lw=0.8)
        else:
            axis.plot([*heights, merit], color=colours(merit), lw=1.6)
    for i, r in enumerate(ranges):
        axis.axvline(i, color="black", lw=0.8)
        ticks = r.choices or (np.geomspace(r.low, r.high, 4) if r.log else np.linspace(r.low, r.high, 5))
        for tick in ticks:
            text = tick if isinstance(tick, str) else f"{tick:.3g}"
            axis.text(i + 0.03, place(r, tick), text, fontsize="x-small", va="center")
        axis.plot(i, place(r, r.thesis), marker="D", color="C3", ms=6, zorder=5)
    last = len(ranges)
    axis.axvline(last, color="black", lw=0.8)
    for merit in np.linspace(0.0, 1.0, 5):
        axis.text(last + 0.03, merit, f"{-(10 ** (high - merit * (high - low))):.0f}", fontsize="x-small", va="center")
    names = [r.name.split(".")[1].replace("_", " ") for r in ranges]
    axis.set_xticks(range(last + 1), [*names, "average return"], fontsize="small", rotation=12)
    axis.set_yticks([])
    axis.set_xlim(-0.1, last + 0.4)
    for side in ("left", "right", "top"):
        axis.spines[side].set_visible(False)
    axis.set_title("diamonds: the thesis's values; dashed: pruned", fontsize="medium")
