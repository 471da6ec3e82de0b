"""What a campaign is to show, held against what was flown; a figure without flights to it is left out."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

from runtime.laws.catalogue import LAWS
from scenarios.campaign.design import DURATION
from scenarios.campaign.mirrored import MIRRORED
from scenarios.campaign.report import by_group, healthy, short
from scenarios.campaign.rows import NONE, ORACLE, ROBUST
from scenarios.campaign.statistics import Flights, median, of_oracle, paired, survival
from scenarios.campaign.table import Campaign
from task.results import Claim

REVERSALS = ("reversal", "second reversal", "reversal with latency")
"""Groups in which a surface works backwards and nothing else is broken but time."""
PEERS = (*LAWS, MIRRORED)
FROZEN = "frozen"


_HOLDS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt, "=": operator.eq,
}  # fmt: skip


def claim(text: str, value: float, unit: str, relation: str = "", bound: float | None = None) -> Claim:
    """Return a claim, with a target when there is a bound; what could not be measured holds nothing."""
    known = not math.isnan(value)
    return Claim(
        claim=text,
        value=short(value) if known else None,
        unit=unit,
        target="" if bound is None else f"{relation} {bound:g}",
        holds=_HOLDS[relation](value, bound) if known and bound is not None else None,
    )


def claims(campaign: Campaign, ours: str, faithful: bool) -> list[Claim]:
    """Return every claim about the row ``ours``; ``faithful``: with the targets of the faithful SERL(50) cast."""
    if ours not in campaign.rows:
        return []
    found: list[Claim] = []
    if "hard" in campaign.suites:
        found += hard(campaign, ours)
    if "easy" in campaign.suites:
        found += easy(campaign, ours) if not faithful else serl50(campaign, ours)
        found += peers(campaign, ours)
    found += identified(campaign, ours)
    found += quiet(campaign, ours)
    return [c for c in found if c.value is not None]


def hard(campaign: Campaign, ours: str) -> list[Claim]:
    """Return survival, accuracy and speed over the hard suite."""
    found = []
    for sensors, least in (("ideal", 98.0), ("noise", 97.0), ("twice the noise", None)):
        flights = campaign.pick(ours, "hard", sensors=sensors)
        value = survival(flights, campaign.pick(ORACLE, "hard", sensors=sensors))
        words = f"{ours}, hard, sensors {sensors}: survives of what the oracle survives"
        found.append(claim(words, value, "%", ">=", least))
    flights = campaign.pick(ours, "hard")
    best, who = math.nan, ""
    for peer in (*PEERS, ROBUST):
        value = survival(campaign.pick(peer, "hard"))
        if not math.isnan(value) and not value <= best:
            best, who = value, peer
    words = f"{ours}, hard: survival less the best peer's ({who})"
    found.append(claim(words, survival(flights) - best, "points", ">=", 0.0))
    oracle = campaign.pick(ORACLE, "hard")
    reversals = by_group(campaign, ours, "hard", REVERSALS)
    others = {k: r for k, r in flights.items() if r.group not in REVERSALS}
    times = campaign.casting(by_group(campaign, ours, "hard", ("reversal",)))
    found += [
        claim(f"{ours}, reversals: mean nMAE over the oracle's", of_oracle(reversals, oracle), "", "<=", 1.2),
        claim(f"{ours}, hard, no reversals: mean nMAE over the oracle's", of_oracle(others, oracle), "", "<=", 1.5),
        claim(f"{ours}, reversals: time to a suited member, median", median(times), "s", "<=", 0.4),
        claim(f"{ours}, reversals: time to a suited member, worst", max(times, default=math.nan), "s", "<=", 1.3),
    ]
    for air, most in (("light", 2.0), ("moderate", None)):
        still, rough = (
            survival(campaign.pick(ours, "hard", air=a), campaign.pick(ORACLE, "hard", air=a)) for a in ("still", air)
        )
        words = f"{ours}, hard, {air} turbulence: survival lost against still air, of what the oracle survives"
        found.append(claim(words, still - rough, "points", "<", most))
    return found


def easy(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what adaptation costs where one controller is enough (the default cast)."""
    p = paired(campaign.pick(ours, "easy"), campaign.pick(ROBUST, "easy"))
    member = campaign.robust.get("easy", "")
    return [
        claim(f"{ours}, easy: mean nMAE against the best single member ({member})", p.of_means, "%", "<=", 2.0),
        claim(f"{ours}, easy: flights > 5 % worse than it", p.clearly_worse, "%", "<=", 1.0),
    ]


def serl50(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what adaptation gains with the faithful SERL(50) cast."""
    found = []
    for sensors, gain, worse in (("ideal", 35.0, 1.0), ("noise", 25.0, 3.0)):
        p = paired(campaign.pick(ours, "easy", sensors=sensors), campaign.pick(NONE, "easy", sensors=sensors))
        where = f"{ours}, easy, sensors {sensors}"
        found.append(claim(f"{where}: mean nMAE against no adaptation", p.of_means, "%", "<=", -gain))
        found.append(claim(f"{where}: flights > 5 % worse", p.clearly_worse, "%", "<=", worse))
    for preview, sensors, gain in (
        (True, "ideal", 30.0), (True, "noise", 15.0), (False, "ideal", 20.0), (False, "noise", 10.0),
    ):  # fmt: skip
        wanted = {"fault": "F2 centre of gravity 0.25 m aft", "preview": preview, "sensors": sensors}
        p = paired(campaign.pick(ours, "easy", **wanted), campaign.pick(NONE, "easy", **wanted))
        words = f"{ours}, CG shift, preview {'yes' if preview else 'no'}, sensors {sensors}: mean nMAE"
        found.append(claim(words, p.of_means, "%", "<=", -gain))
    return found


def peers(campaign: Campaign, ours: str) -> list[Claim]:
    """Return by how much the best peer is better, in the fault of the easy suite where it is most."""
    flights = campaign.pick(ours, "easy")
    worst, where = math.nan, ""
    for peer in (*PEERS, ROBUST):
        theirs = campaign.pick(peer, "easy")
        for fault in sorted({k[1] for k in flights}):
            p = paired(*({k: r for k, r in row.items() if k[1] == fault} for row in (theirs, flights)))
            if p.both and not p.of_means >= worst:
                worst, where = p.of_means, f"{peer}, {fault}"
    words = f"{ours}, easy: where a peer's mean nMAE is furthest below ({where})"
    return [claim(words, worst, "%", ">=", -10.0)]


def identified(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what identification gains over the frozen nominal model."""

    def both(suite: str, *groups: str) -> tuple[Flights, Flights]:
        pair = (campaign.pick(row, suite) for row in (ours, FROZEN))
        mine, theirs = ({k: r for k, r in row.items() if not groups or r.group in groups} for row in pair)
        return mine, theirs

    found = []
    mine, theirs = both("hard")
    more = survival(mine) - survival(theirs)
    found.append(claim(f"{ours}, hard: survives more than the frozen nominal model", more, "points", ">", 0.0))
    p = paired(*both("easy", "effectiveness"))
    words = f"{ours}, effectiveness: mean nMAE against the frozen nominal model"
    found.append(claim(words, p.of_means, "%", "<=", -10.0))
    worst, where = math.nan, ""
    for suite in campaign.suites:
        for group in sorted({r.group for r in campaign.pick(FROZEN, suite).values()}):
            p = paired(*both(suite, group))
            if p.both and not p.of_means <= worst:
                worst, where = p.of_means, f"{suite}, {group}"
    found.append(claim(f"{ours}: furthest behind the frozen nominal model ({where})", worst, "%", "<=", 2.0))
    return found


def quiet(campaign: Campaign, ours: str) -> list[Claim]:
    """Return false alarms in flights without a fault, and whether they had consequences."""
    flights = {k: r for k, r in healthy(campaign, ours).items() if r.air in ("still", "light")}
    minutes = len(flights) * DURATION / 60.0
    alarms = sum(r.alarms + r.alarms_before for r in flights.values())
    p = paired(flights, healthy(campaign, NONE))
    every = 10.0 * alarms / minutes if minutes else math.nan
    lost = float(p.lost) if p.flights else math.nan
    return [
        claim(f"{ours}: alarms in 10 min without a fault, still air and light turbulence", every, "", "<=", 1.0),
        claim(f"{ours}: of these flights lost that no adaptation flew", lost, f"of {p.flights}", "=", 0.0),
    ]
