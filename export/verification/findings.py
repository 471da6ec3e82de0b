"""What the landers show, as claims and tables."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from export.verification.archive import ArchiveSettings, Progress
from export.verification.lander import FAULTS, POSITION_NOISE
from export.verification.pictures import CASES, Behaviours
from export.verification.trials import SOLVED, worst_case
from task.results import Claim, Result, Table


class Picked(NamedTuple):
    """A policy picked from a repertoire for a fault, beside the nominal champion of that repertoire."""

    repertoire: str
    fault: str
    candidates: int
    episodes: int
    """Of trial."""
    champion: np.ndarray
    """(E,) returns of the nominal champion in the test."""
    chosen: np.ndarray
    """(E,) returns of the policy picked."""
    same: bool
    """The pick is the champion."""


class Found(NamedTuple):
    """All that was measured."""

    flown: dict[str, dict[str, np.ndarray]]
    """Who -> fault -> (E,) returns."""
    archived: Behaviours
    """All elites, nominal."""
    touchdowns: dict[str, dict[str, Behaviours]]
    """Repertoire -> fault -> behaviours in one episode."""
    picks: list[Picked]
    archive: Progress
    settings: ArchiveSettings
    training: tuple[dict[str, Any], dict[str, Any]]
    """Provenance of PDERL and DDPG."""


def _rounded(value: float) -> float:
    return round(float(value), 1)


def cases_table(flown: dict[str, dict[str, np.ndarray]]) -> Table:
    """Return mean, deviation and worst case of everybody in every case."""
    return Table(
        title="Return of an episode (thesis figure 4.4)",
        columns=["who", "case", "mean", "sd", "mean - sd / 2", "worst", "solved [%]"],
        rows=[
            [
                who,
                CASES[fault],
                _rounded(cases[fault].mean()),
                _rounded(cases[fault].std()),
                _rounded(worst_case(cases[fault])),
                _rounded(cases[fault].min()),
                _rounded(100.0 * (cases[fault] >= SOLVED).mean()),
            ]
            for who, cases in flown.items()
            for fault in FAULTS
        ],
    )


def repertoire_table(touchdowns: dict[str, dict[str, Behaviours]]) -> Table:
    """Return how population and best elites fare with each fault, in the archive's own episode."""
    rows: list[list[Any]] = []
    for name, cases in touchdowns.items():
        before = cases["none"]
        good = before.returns >= SOLVED
        for fault in FAULTS:
            now = cases[fault]
            shift = np.abs(now.behaviour - before.behaviour)
            rows.append(
                [
                    name,
                    CASES[fault],
                    len(now.returns),
                    _rounded(now.returns.mean()),
                    _rounded(now.returns.max()),
                    int((now.returns >= SOLVED).sum()),
                    *(round(float(v), 3) for v in shift.mean(axis=0)),
                    *((round(float(v), 3) for v in shift[good].mean(axis=0)) if good.any() else ("", "")),
                ]
            )
    columns = ["repertoire", "case", "policies", "mean", "best", "solve it", "shift of x", "of velocity"]
    columns += ["shift of x, solvers", "of velocity, solvers"]
    return Table(
        title="Population and best elites in one episode (thesis figures 4.3 and 4.5)", columns=columns, rows=rows
    )


def picks_table(picks: list[Picked]) -> Table:
    """Return what a pick by trial brings."""
    return Table(
        title="A policy picked by trial with the fault, nobody told which",
        columns=["repertoire", "case", "candidates", "trial episodes", "champion", "picked", "sd", "solved [%]"],
        rows=[
            [
                p.repertoire,
                CASES[p.fault],
                p.candidates,
                p.episodes,
                _rounded(p.champion.mean()),
                _rounded(p.chosen.mean()) if not p.same else "the champion",
                _rounded(p.chosen.std()),
                _rounded(100.0 * (p.chosen >= SOLVED).mean()),
            ]
            for p in picks
        ],
    )


def claims(found: Found) -> list[Claim]:
    """Return what is claimed, the thesis's findings as targets."""
    pderl, ddpg, linear = (found.flown[who] for who in ("PDERL champion", "DDPG", "CMA-ME champion"))
    listed = []
    for who, cases in (("PDERL champion", pderl), ("DDPG", ddpg)):
        mean = cases["none"].mean()
        listed.append(
            Claim(
                claim=f"{who}, nominal: mean return",
                value=_rounded(mean),
                target=f"{SOLVED:.0f}, solved; the thesis's solves it",
                holds=bool(mean >= SOLVED),
            )
        )
    listed.append(Claim(claim="CMA-ME champion, nominal: mean return", value=_rounded(linear["none"].mean())))
    for fault, thesis in (("noisy_position", 42), ("weak_engine", 25)):
        nominal, broken = float(pderl["none"].mean()), float(pderl[fault].mean())
        listed.append(
            Claim(
                claim=f"PDERL champion, {CASES[fault]}: mean return",
                value=_rounded(broken),
                target="solved nominally, and less than 18 % below that, as the thesis's",
                holds=bool(nominal >= SOLVED and broken > 0.82 * nominal),
            )
        )
        lead = worst_case(pderl[fault]) - ddpg[fault].mean()
        listed.append(
            Claim(
                claim=f"{CASES[fault]}: PDERL's worst case (mean - sd / 2) less DDPG's mean",
                value=_rounded(lead),
                target=f"above 0 and solved; {thesis} % of DDPG's in the thesis",
                holds=bool(lead > 0.0 and worst_case(pderl[fault]) >= SOLVED),
            )
        )
    cells = int(np.prod(found.settings.cells))
    elites = found.archived.returns
    listed += [
        Claim(claim="CMA-ME: cells filled", value=_rounded(100.0 * len(elites) / cells), unit=f"% of {cells}"),
        Claim(claim="CMA-ME: elites that solve their own episode", value=int((elites >= SOLVED).sum())),
    ]
    for p in found.picks:
        gain = p.chosen.mean() - p.champion.mean()
        listed.append(
            Claim(
                claim=f"{p.repertoire}, {CASES[p.fault]}: gain of the picked policy over the nominal champion",
                value=_rounded(gain),
                target="above 0",
                holds=bool(gain > 0.0),
            )
        )
    return listed


def result(found: Found, episodes: int, recalled: int, seconds: float) -> Result:
    """Return everything as a result; ``recalled`` of the ``episodes`` had been flown before an interruption."""
    made = [
        f"{who}: {t['frames']:,} frames, {t['updates']:,} critic updates ({t['updates'] / t['frames']:.2f} a frame, "
        f"the thesis one), {t['seconds']:.0f} s on one shared core, seed {t['seed']}."
        for who, t in zip(("PDERL", "DDPG"), found.training, strict=True)
    ]
    archive = found.archive
    return Result(
        title="LunarLander: PDERL, DDPG and CMA-ME with two faults",
        command="python -m export.verification.measure",
        seconds=round(seconds, 1),
        runs=episodes,
        seeds=[t["seed"] for t in found.training],
        claims=claims(found),
        tables=[cases_table(found.flown), repertoire_table(found.touchdowns), picks_table(found.picks)],
        notes=[
            *made,
            *(
                [f"{recalled} of {episodes} episodes were flown before an interruption; the time is of the last start."]
                if recalled
                else []
            ),
            f"CMA-ME: {archive.iterations} iterations, {archive.episodes:,} episodes, {archive.frames:,} frames, "
            f"{archive.seconds:.0f} s; the thesis: 400 iterations, 50,000 episodes. Each policy is judged by one "
            "episode, always the same.",
            "One training seed each: differences between algorithms may be chance. The episodes of the tests are of "
            "seeds that no training, validation or trial has seen.",
            f"The thesis gives no size of F1's noise; here its standard deviation is {POSITION_NOISE} (the pad reaches "
            "from -0.2 to 0.2). LunarLander-v3 where the thesis has v2; no bonus for legs, as there.",
        ],
    )
