"""Tables and pictures of the default cast from what was measured (``bench.cast``)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from task.config import Settings
from task.results import Claim, Result, Table

TARGETS = {"nominal": 0.5, **dict.fromkeys(("F1", "F2", "F3", "F4", "F5", "R1", "R3"), 1.2), "R2": 4.0}
"""Largest nMAE [%] that the best member is meant to have."""
SMOOTH = -10.0
"""Least Sm [rad Hz] that the best member is meant to have in the nominal case."""
RATIO = 1.5
"""Largest nMAE of the cast over the specialist's."""
USELESS = 50.0
"""Mean cost [% nMAE] from which on a member is of no use in a case: that of two flights of which one is lost."""
LAWS = ("pid", "indi", "indi-rls-signfree")


class Cell(Settings, frozen=True):
    """What one pilot made of one case's flights."""

    nmae: list[float]
    """From the onset to the end or the loss [%]."""
    smoothness: list[float]
    """Sm, likewise [rad Hz]."""
    lost: list[bool]

    @classmethod
    def join(cls, cells: list[Cell]) -> Cell:
        """Return several flights as one cell."""
        return cls(
            nmae=[v for cell in cells for v in cell.nmae],
            smoothness=[v for cell in cells for v in cell.smoothness],
            lost=[v for cell in cells for v in cell.lost],
        )

    @property
    def survived(self) -> int:
        """Flights that flew to the end."""
        return len(self.lost) - sum(self.lost)

    @property
    def mean(self) -> float:
        """Mean nMAE of the flights that flew to the end [%]; infinite without one."""
        kept = [v for v, lost in zip(self.nmae, self.lost, strict=True) if not lost]
        return float(np.mean(kept)) if kept else math.inf

    @property
    def rank(self) -> tuple[int, float]:
        """Order of merit: fewest losses, then least nMAE."""
        return sum(self.lost), self.mean

    def __str__(self) -> str:
        if not self.survived:
            return "lost"
        return f"{self.mean:.2f}" + (f" ({self.survived} of {len(self.lost)})" if any(self.lost) else "")


class Measured(Settings, frozen=True):
    """One case."""

    case: str
    hard: bool
    chosen: str
    """The member that did best on the tuning trials."""
    members: dict[str, Cell]
    """All of them in hard cases, else the chosen and the main one."""
    others: dict[str, Cell]
    """``specialist``, ``robust`` and, in hard cases, ``serl`` and the classical laws."""
    seconds: float = 0.0


def against(specialist: Cell, other: Cell) -> float:
    """Return the nMAE of ``other`` over the specialist's on the flights that the specialist survives; inf if lost."""
    kept = [i for i, lost in enumerate(specialist.lost) if not lost]
    if any(other.lost[i] for i in kept):
        return math.inf
    return float(np.mean([other.nmae[i] for i in kept]) / np.mean([specialist.nmae[i] for i in kept]))


def best_member(case: Measured) -> tuple[str, float]:
    """Return which member of a hard case has the least nMAE over the specialist's, and that."""
    ratios = {name: against(case.others["specialist"], cell) for name, cell in case.members.items()}
    best = min(ratios, key=lambda name: ratios[name])
    return best, ratios[best]


def word(ratio: float) -> str:
    """Return a ratio as a cell's text."""
    return f"{ratio:.2f}" if math.isfinite(ratio) else "lost"


def oracle_table(measured: Mapping[str, Measured], main: str) -> Table:
    """Return the hard cases: who survives, and how well."""
    rows = []
    for case in (m for m in measured.values() if m.hard):
        specialist, chosen = case.others["specialist"], case.members[case.chosen]
        flies = specialist.survived > 0
        best, ratio = best_member(case) if flies else ("", math.inf)
        with_laws = min([chosen, *(case.others[law] for law in LAWS)], key=lambda cell: cell.rank)
        rows.append([
            case.case, str(specialist), case.chosen, str(chosen),
            word(against(specialist, chosen)) if flies else "-",
            *((best, word(ratio)) if flies else ("-", "-")),
            str(case.members[main]), *(str(case.others[name]) for name in (*LAWS, "robust", "serl")), str(with_laws),
        ])  # fmt: skip
    columns = [
        "case", "specialist", "member chosen on tuning flights", "its nMAE", "over specialist's",
        "member that is best here", "over specialist's", "main member alone", "PID", "INDI", "INDI, sign-free RLS",
        "single robust policy", "SERL champion", "oracle over members and laws",
    ]  # fmt: skip
    return Table(title="Hard cases: nMAE % of the flights that survive", columns=columns, rows=rows)


def easy_table(measured: Mapping[str, Measured], main: str) -> Table:
    """Return the thesis's cases."""
    rows = []
    for case in (m for m in measured.values() if not m.hard):
        chosen, target = case.members[case.chosen], TARGETS.get(case.case)
        rows.append([
            case.case, "-" if target is None else f"<= {target:g}", case.chosen, str(chosen),
            round(float(np.mean(chosen.smoothness)), 1), str(case.members[main]),
            str(case.others["specialist"]) if "specialist" in case.others else "-",
            str(case.others["robust"]),
        ])  # fmt: skip
    columns = [
        "case", "target", "member chosen on tuning flights", "its nMAE", "its Sm", "main member",
        "specialist", "single robust policy",
    ]  # fmt: skip
    return Table(title="The thesis's cases: nMAE %", columns=columns, rows=rows)


def totals_table(measured: Mapping[str, Measured], main: str) -> Table:
    """Return each pilot's survivors and median nMAE over all hard cases, members and laws together included."""
    hard = [m for m in measured.values() if m.hard]
    pilots: dict[str, list[Cell]] = {
        "specialist of each case": [m.others["specialist"] for m in hard],
        "oracle over the cast (chosen on tuning flights)": [m.members[m.chosen] for m in hard],
        "oracle over the cast and the laws": [
            min([m.members[m.chosen], *(m.others[law] for law in LAWS)], key=lambda cell: cell.rank) for m in hard
        ],
        "main member alone": [m.members[main] for m in hard],
        **{law: [m.others[law] for m in hard] for law in LAWS},
        "single robust policy": [m.others["robust"] for m in hard],
        "SERL champion, from scratch": [m.others["serl"] for m in hard],
    }
    rows: list[list[Any]] = []
    for name, cells in pilots.items():
        whole = [cell.mean for cell in cells if not any(cell.lost)]
        flights, survived = sum(len(cell.lost) for cell in cells), sum(cell.survived for cell in cells)
        rows.append([
            name, f"{survived} of {flights}", f"{len(whole)} of {len(cells)}",
            round(float(np.median(whole)), 2) if whole else None,
        ])  # fmt: skip
    columns = ["pilot", "flights survived", "cases without a loss", "median nMAE % of those cases"]
    return Table(title="Hard cases, all together", columns=columns, rows=rows)


def claims(measured: Mapping[str, Measured], members: list[str]) -> list[Claim]:
    """Return what the cast was meant to do, and whether it does."""
    found = [
        Claim(claim="members", value=len(members), target="<= 50", holds=len(members) <= 50),
    ]
    for name, target in TARGETS.items():
        cell = measured[name].members[measured[name].chosen]
        value = round(cell.mean, 2) if cell.survived else None
        holds = not any(cell.lost) and cell.mean <= target
        found.append(
            Claim(claim=f"{name}, nMAE of the member chosen for it ({measured[name].chosen})", value=value, unit="%",
                  target=f"<= {target:g}", holds=holds)
        )  # fmt: skip
    nominal = measured["nominal"].members[measured["nominal"].chosen]
    smooth = float(np.mean(nominal.smoothness))
    found.append(
        Claim(claim="nominal, its Sm", value=round(smooth, 1), unit="rad Hz", target=f">= {SMOOTH:g}",
              holds=smooth >= SMOOTH)
    )  # fmt: skip
    flown = [m for m in measured.values() if m.hard and m.others["specialist"].survived]
    within = [m for m in flown if against(m.others["specialist"], m.members[m.chosen]) <= RATIO]
    hard = sum(m.hard for m in measured.values())
    found += [
        Claim(claim="hard cases that their own specialist survives", value=len(flown), unit=f"of {hard}"),
        Claim(
            claim="of these: the member chosen on tuning flights survives too, with at most 1.5x the nMAE",
            value=len(within), unit=f"of {len(flown)}", target="all", holds=len(within) == len(flown),
        ),
    ]  # fmt: skip
    some = [m for m in flown if any(against(m.others["specialist"], cell) <= RATIO for cell in m.members.values())]
    found.append(
        Claim(claim="of these: some member survives what the specialist survives, with at most 1.5x its nMAE",
              value=len(some), unit=f"of {len(flown)}", target="all", holds=len(some) == len(flown))
    )  # fmt: skip
    for law in LAWS:
        better = [m for m in flown if m.others[law].rank < m.members[m.chosen].rank]
        found.append(Claim(claim=f"hard cases in which {law} beats the cast's oracle", value=len(better),
                           unit=f"of {len(flown)}"))  # fmt: skip
    return found


def result(
    measured: Mapping[str, Measured], members: list[str], training: Mapping[str, Any], protocol: Mapping[str, Any],
    seconds: float,
) -> Result:  # fmt: skip
    """Return everything as one result."""
    main = members[0]
    flights = sum(len(cell.lost) for m in measured.values() for cell in (*m.members.values(), *m.others.values()))
    chosen = training["chosen"]
    casting = Table(
        title="The cast",
        columns=["member", "why", "cases that it is chosen for"],
        rows=[
            [
                name,
                (
                    "main member"
                    if i == 0
                    else "mirror"
                    if i < 8
                    else "covers"
                    if i < chosen["needed"]
                    else "lowers cost"
                ),
                ", ".join(case for case, who in chosen["for_case"].items() if who == name) or "-",
            ]
            for i, name in enumerate(members)
        ],
    )
    return Result(
        title="The default cast",
        command="python -m bench.cast",
        seconds=round(seconds, 1),
        runs=flights,
        seeds=[training["seed"]],
        claims=claims(measured, members),
        tables=[
            totals_table(measured, main), oracle_table(measured, main), easy_table(measured, main), casting,
        ],
        notes=[
            f"Hard cases: {protocol['hard_references']} evaluation references of {protocol['hard_duration']:g} s. The "
            f"faults come all at once, between {protocol['onset'][0]:g} and {protocol['onset'][1]:g} s. The main "
            f"member flies until {training['config']['trial']['decision']:g} s after the onset, then the member or "
            "specialist in question; laws and single policies fly alone from the start. nMAE from the onset to the "
            "end. In brackets: flights that survived, where not all did; the nMAE is theirs.",
            f"The thesis's cases: {protocol['easy_references']} evaluation references of "
            f"{protocol['easy_duration']:g} s, faults from the start, nobody is switched.",
            "References, onsets and noise are of streams that neither breeding nor the choice of the cast has seen.",
            "F6 and jammed rudders have a floor of about 33 % that the metric makes: a constant sideslip is divided by "
            "its own mean.",
            "The oracle is told the case; which member an aircraft needs is the runtime's to find out. The INDI with "
            "sign-free RLS is told nothing.",
            "Oracle over members and laws: a law counts as a member that has flown from the start.",
        ],
    )  # fmt: skip


def coverage_picture(
    scores: Mapping[str, Mapping[str, float]], for_case: Mapping[str, str], cases: list[str], path: Path
) -> None:
    """Draw what every member costs in every hard case on the tuning flights, as the population's manifest has it.

    scores: {member: {case: mean cost [% nMAE]}}; for_case: the member chosen for each case.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import LogNorm

    members = list(scores)
    cost = np.array([[scores[name][case] for name in members] for case in cases])
    values = np.where(cost < USELESS, cost, np.nan)
    figure, axes = plt.subplots(figsize=(3.0 + 0.2 * len(members), 1.9 + 0.17 * len(cases)), layout="constrained")
    colours = plt.get_cmap("viridis_r").copy()
    colours.set_bad("0.25")
    image = axes.imshow(values, norm=LogNorm(1.0, 50.0), cmap=colours, aspect="auto")
    for row, case in enumerate(cases):
        axes.plot(members.index(for_case[case]), row, "o", color="red", markersize=3.5)
    axes.set_xticks(range(len(members)), members, rotation=90, fontsize=6)
    axes.set_yticks(range(len(cases)), cases, fontsize=6)
    axes.set_title(
        "nMAE % of every member in every hard case (grey: above 50 %, or a flight lost; dot: the best)", fontsize=8
    )
    figure.colorbar(image, ax=axes, shrink=0.6).ax.tick_params(labelsize=6)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
