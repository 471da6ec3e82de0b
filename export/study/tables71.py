"""What the flights of table 7.1 say: tables, claims and a picture, the thesis's figures in the columns beside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from export.study.contest import CaseScores
from export.study.statistics import best, paired_interval, t_test
from export.study.thesis import BEST_71, TABLE_71
from export.training.evaluate import Scores, attitude_nmae
from task.results import Claim, Table
from task.state import REFERENCE

NOT_TARGETS = ("F6", "R2")
"""Cases reported as they are: the first's nMAE has a floor of a third, the second's is saturation."""


def _spread(values: np.ndarray, lost: int = 0) -> str:
    text = f"{values.mean():.2f} ± {values.std(ddof=1) if len(values) > 1 else 0.0:.1f}"
    return text + (f" ({lost} lost)" if lost else "")


def _of_one(scores: Scores, references: list[int] | slice = slice(None)) -> str:
    return _spread(scores.nmae[0, references], int(scores.lost[0, references].sum()))


def _average(scores: Scores) -> str:
    return _spread(scores.nmae.mean(axis=1), int(scores.lost.sum()))


def _unlost(scores: Scores) -> str:
    """Return the average of the members that lost no flight in this case, and how many they are."""
    whole = scores.nmae[~scores.lost.any(axis=1)]
    return f"{whole.mean():.2f} ({len(whole)} of {len(scores.nmae)})" if len(whole) else f"(0 of {len(scores.nmae)})"


def nmae_table(scores: Mapping[str, CaseScores]) -> Table:
    """Return table 7.1 with the thesis's columns before ours."""
    rows = []
    for case, s in scores.items():
        theirs = TABLE_71[case]
        rows.append(
            [
                case,
                str(theirs.td3),
                _of_one(s.td3),
                str(theirs.average),
                _average(s.population),
                _unlost(s.population),
                str(theirs.champion),
                _of_one(s.champion),
                f"{_of_one(s.repicked, s.unseen or slice(None))} {s.repicked_name}",
            ]
        )
    columns = ["case", "TD3, thesis", "TD3", "average, thesis", "average", "average of members without a loss"]
    columns += ["champion, thesis", "champion", "champion re-picked for the case"]
    return Table(title="nMAE [%], mean ± standard deviation", columns=columns, rows=rows)


def significance_table(scores: Mapping[str, CaseScores]) -> Table:
    """Return the thesis's t-tests and the paired bootstrap interval of champion less TD3."""
    rows = []
    for case, s in scores.items():
        champion, td3, average = s.champion.nmae[0], s.td3.nmae[0], s.population.nmae.mean(axis=0)
        difference, low, high = paired_interval(champion, td3)
        lowest = best({"champion": champion, "td3": td3, "average": average})
        rows.append(
            [
                case,
                BEST_71[case] or "none",
                lowest or "none",
                f"{t_test(champion, td3):.1e}",
                f"{t_test(champion, average):.1e}",
                f"{difference:.2f} [{low:.2f}, {high:.2f}]",
            ]
        )
    columns = ["case", "lowest, thesis", "lowest", "p champion, TD3", "p champion, average"]
    columns.append("champion less TD3 [95 % interval]")
    return Table(title="Significance", columns=columns, rows=rows)


def safety_table(scores: Mapping[str, CaseScores]) -> Table:
    """Return who survives, who is beyond the bounds of eq. 14 and who is smooth."""
    rows = []
    for case, s in scores.items():
        three = (s.td3, s.population, s.champion)
        rows.append(
            [
                case,
                *(f"{int(one.lost.sum())} of {one.lost.size}" for one in three),
                *(f"{100.0 * one.unsafe.sum() / one.length.sum():.2f}" for one in three),
                *(f"{one.smoothness.mean():.1f}" for one in three),
            ]
        )
    who = ("TD3", "population", "champion")
    columns = ["case", *(f"lost, {w}" for w in who), *(f"unsafe [%], {w}" for w in who), *(f"Sm, {w}" for w in who)]
    return Table(title="Flights lost, samples beyond eq. 14, smoothness [rad Hz]", columns=columns, rows=rows)


def jammed_rudder(s: CaseScores) -> Table:
    """Return F6 without the floor of its nMAE: theta and phi alone, and the sideslip that is left."""
    rows = []
    for who, one in (
        ("TD3", s.td3),
        ("population", s.population),
        ("champion", s.champion),
        (f"re-picked {s.repicked_name}", s.repicked),
    ):
        mae = one.mae.reshape(-1, 3)
        attitude = attitude_nmae(one).mean()
        slip = np.rad2deg(mae[:, REFERENCE.beta].mean())
        rows.append([who, round(float(one.nmae.mean()), 2), round(float(attitude), 2), round(float(slip), 2)])
    columns = ["actor", "nMAE [%]", "nMAE of theta and phi [%]", "mean sideslip [deg]"]
    return Table(title="F6 without its floor: the constant sideslip alone makes 33.3 %", columns=columns, rows=rows)


def td3_table(rivals: Mapping[str, Scores]) -> Table:
    """Return every TD3 actor's nominal figures."""
    rows = [
        [name, _of_one(s), round(float(s.nmae.max()), 2), round(float(s.smoothness.mean()), 1)]
        for name, s in rivals.items()
    ]
    return Table(title="TD3 actors, nominal", columns=["trained", "nMAE [%]", "worst [%]", "Sm [rad Hz]"], rows=rows)


def claims(scores: Mapping[str, CaseScores]) -> list[Claim]:
    """Return champion and average beside what the thesis's reached."""
    found = []
    for case, s in scores.items():
        value, bound = float(s.champion.nmae[0].mean()), TABLE_71[case].champion.mean
        judged = case not in NOT_TARGETS
        found.append(
            Claim(
                claim=f"champion's nMAE, {case}",
                value=round(value, 2),
                unit="%",
                target=f"<= {bound:g}, the thesis's" if judged else "",
                holds=bool(value <= bound and not s.champion.lost.any()) if judged else None,
            )
        )
    if "nominal" in scores:
        average = float(scores["nominal"].population.nmae.mean())
        bound = TABLE_71["nominal"].average.mean
        found.insert(
            1,
            Claim(
                claim="population average's nMAE, nominal",
                value=round(average, 2),
                unit="%",
                target=f"<= {bound:g}, the thesis's",
                holds=bool(average <= bound),
            ),
        )
    return found


def draw(figure: Figure, scores: Mapping[str, CaseScores], title: str) -> None:
    """Draw our means and standard deviations beside the thesis's, case by case."""
    figure.set_size_inches(10.0, 4.2)
    axis = figure.subplots()
    x = np.arange(len(scores))
    series = (
        ("TD3", "C0", [TABLE_71[c].td3.mean for c in scores], [s.td3.nmae[0].mean() for s in scores.values()]),
        (
            "population average",
            "C1",
            [TABLE_71[c].average.mean for c in scores],
            [s.population.nmae.mean() for s in scores.values()],
        ),
        (
            "champion",
            "C2",
            [TABLE_71[c].champion.mean for c in scores],
            [s.champion.nmae[0].mean() for s in scores.values()],
        ),
    )
    width = 0.13
    for i, (label, colour, theirs, ours) in enumerate(series):
        at = x + (i - 1) * 2.2 * width
        axis.bar(at - width / 2, theirs, width, color=colour, alpha=0.35, hatch="//", label=f"{label}, thesis")
        axis.bar(at + width / 2, ours, width, color=colour, label=f"{label}, {title}")
    axis.set_yscale("log")
    axis.set_xticks(x, list(scores))
    axis.set_ylabel("nMAE [%]")
    axis.grid(axis="y", alpha=0.3, which="both")
    axis.legend(ncols=3, fontsize="small", loc="upper left")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high * 4.0)
