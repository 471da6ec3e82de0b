"""Pictures of a campaign: who survives what, and how far from the best member in hindsight."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from scenarios.campaign.report import faults_of, rows_of
from scenarios.campaign.rows import ORACLE
from scenarios.campaign.statistics import median, survival
from scenarios.campaign.table import Campaign
from scenarios.figures import save
from scenarios.panels import INK, STYLE

SURVIVAL_SCALE = (-30.0, 130.0)
"""Of the first picture [%]; wider than what there is, so that numbers are read on its darkest colours."""
LARGEST_RATIO = 6.0
"""The scale of the second picture ends here [-]."""


def draw(campaign: Campaign, folder: Path, name: str = "campaign") -> list[Path]:
    """Write <name>_<suite>.png of every suite; return their paths."""
    return [save(picture(campaign, suite), folder / f"{name}_{suite}.png") for suite in campaign.suites]


def picture(campaign: Campaign, suite: str) -> Figure:
    """Return a suite at a glance: survival and nMAE over the oracle's, by fault (down) and row (across)."""
    rows, faults = rows_of(campaign), faults_of(campaign, suite)
    alive, ratio = np.full((len(faults), len(rows)), np.nan), np.full((len(faults), len(rows)), np.nan)
    for i, fault in enumerate(faults):
        oracle = campaign.pick(ORACLE, suite, fault=fault)
        for j, row in enumerate(rows):
            flights = campaign.pick(row, suite, fault=fault)
            alive[i, j] = survival(flights)
            both = [k for k, r in flights.items() if r.survived and k in oracle and oracle[k].survived]
            ratio[i, j] = median([flights[k].nmae / oracle[k].nmae for k in both])
    maps = [(alive, alive, "survivors %", "RdYlBu", SURVIVAL_SCALE, "{:.0f}")]
    if np.isfinite(ratio).any():
        scale = (-math.log2(LARGEST_RATIO), math.log2(LARGEST_RATIO))
        title = "median nMAE over the oracle's"
        maps.append((np.log2(ratio), ratio, title, "RdYlBu_r", scale, "{:.2g}"))
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        across = max(0.42 * len(rows), 2.4)
        figure = Figure(figsize=(3.2 + across * len(maps), 1.2 + 0.2 * len(faults)), layout="constrained")
        axes = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for ax, (values, shown, title, colours, scale, form) in zip(axes, maps, strict=True):
            ax.imshow(values, cmap=colours, vmin=scale[0], vmax=scale[1], aspect="auto", alpha=0.75)
            ax.set_title(title)
            for (i, j), value in np.ndenumerate(shown):
                if np.isfinite(value):
                    ax.text(j, i, form.format(value), ha="center", va="center", fontsize=6.5, color=INK)
        axes[0].set_yticks(range(len(faults)), faults, parse_math=False)
        for ax in axes:
            ax.set_xticks(
                range(len(rows)), rows, rotation=45, ha="right", rotation_mode="anchor", parse_math=False
            )  # names are as they are, not formulas
            ax.grid(False)
            ax.tick_params(length=0)
            for spine in ax.spines.values():
                spine.set_visible(False)
    return figure
