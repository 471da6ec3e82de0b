"""What a campaign is to show, held against what was flown; a figure without flights to it is left out."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

import msgspec

from runtime.laws.catalogue import LAWS
from scenarios.campaign.design import DURATION
from scenarios.campaign.mirrored import MIRRORED
from scenarios.campaign.report import REVERSALS, by_group, healthy, short
from scenarios.campaign.rows import FROZEN, NONE, ORACLE, ROBUST
from scenarios.campaign.scores import Record
from scenarios.campaign.statistics import Flights, Key, median, of_oracle, paired, stalled, survival
from scenarios.campaign.table import Campaign
from task.results import Claim

TARGETED = ("ideal", "noise")
"""Sensors that targets are stated for; the others are reported only."""
PEERS = (*LAWS, MIRRORED)

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


def still(flights: Flights, *sensors: str) -> dict[Key, Record]:
    """Return the flights that targets are stated for: in still air, with ideal sensors or the thesis's noise."""
    return {k: r for k, r in flights.items() if r.air == "still" and r.sensors in (sensors or TARGETED)}


def hard(campaign: Campaign, ours: str) -> list[Claim]:
    """Return survival, accuracy and speed over the hard suite."""
    flights, oracle = campaign.pick(ours, "hard"), campaign.pick(ORACLE, "hard")
    p = paired(flights, oracle)
    turned = paired(by_group(campaign, ours, "hard", REVERSALS), oracle)
    found = [
        claim(f"{ours}, hard, all: survives of what the oracle survives", survival(flights, oracle), "%"),
        claim(f"{ours}, hard, all: mean nMAE against the oracle's, where both survive", p.of_means, "%"),
        claim(f"{ours}, hard, reversals: mean nMAE against the oracle's, where both survive", turned.of_means, "%"),
        claim(f"{ours}, hard, all: survives where the oracle does not", float(p.saved), f"of {p.flights}"),
    ]
    for sensors, least in (("ideal", 98.0), ("noise", 97.0), ("twice the noise", None)):
        where = f"{ours}, hard, still air, sensors {sensors}"
        kept = still(flights, sensors)
        found.append(claim(f"{where}: survives of what the oracle survives", survival(kept, oracle), "%", ">=", least))
        reversals = {k: r for k, r in kept.items() if r.group in REVERSALS}
        others = {k: r for k, r in kept.items() if r.group not in REVERSALS}
        for name, picked, most in (("reversals", reversals, 1.2), ("no reversals", others, 1.5)):
            words = f"{where}, {name}: nMAE over the oracle's, median"
            found.append(claim(words, of_oracle(picked, oracle), "", "<=", None if least is None else most))
    best, who = math.nan, ""
    for peer in (*PEERS, ROBUST):
        theirs = campaign.pick(peer, "hard")
        ahead = survival(theirs, present(flights)) - survival(flights, present(theirs))
        if not math.isnan(ahead) and not ahead <= best:
            best, who = ahead, peer
    found.append(claim(f"{ours}, hard, all: survival less the best peer's ({who})", 0.0 - best, "points", ">=", 0.0))
    reversed_ = still(by_group(campaign, ours, "hard", ("reversal",)))
    times = campaign.casting(reversed_, all_suited=True)
    asked = campaign.casting(reversed_)
    where = f"{ours}, reversals, still air: time to a suited member"
    found += [
        claim(f"{where}, median (0 where one flies already)", median(times), "s", "<=", 0.4),
        claim(f"{where}, worst", max(times, default=math.nan), "s", "<=", 1.3),
        claim(f"{where}, median where none flies yet ({len(asked)} of {len(times)})", median(asked), "s"),
    ]
    if falling := {k for k in reversed_ if k in oracle and stalled(oracle[k])}:
        rest = campaign.casting({k: r for k, r in reversed_.items() if k not in falling}, all_suited=True)
        words = f"{where}, worst, without {len(falling)} flights of which the best is on a stalled wing"
        found.append(claim(words, max(rest, default=math.nan), "s"))
    calm = survival(still(flights), oracle)
    for air, points in (("light", 2.0), ("moderate", None)):
        rough = {k: r for k, r in flights.items() if r.air == air and r.sensors in TARGETED}
        words = f"{ours}, hard, {air} turbulence: survival lost against still air, of what the oracle survives"
        found.append(claim(words, calm - survival(rough, oracle), "points", "<", points))
    return found


def present(flights: Flights) -> Flights:
    """Return flights as if all had survived: to ask for what another row flew too."""
    return {k: msgspec.structs.replace(r, survived=True) for k, r in flights.items()}


def easy(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what adaptation costs where one controller is enough (the default cast)."""
    found, member = [], campaign.robust.get("easy", "")
    for sensors in TARGETED:
        where = f"{ours}, easy, still air, sensors {sensors}"
        p = paired(still(campaign.pick(ours, "easy"), sensors), campaign.pick(ROBUST, "easy"))
        found += [
            claim(f"{where}: mean nMAE against the best single member ({member})", p.of_means, "%", "<=", 2.0),
            claim(f"{where}: flights > 5 % worse than it", p.clearly_worse, "%", "<=", 1.0),
        ]
    return found


def serl50(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what adaptation gains with the faithful SERL(50) cast."""
    found = []
    for sensors, gain, worse in (("ideal", 35.0, 1.0), ("noise", 25.0, 3.0)):
        p = paired(still(campaign.pick(ours, "easy"), sensors), campaign.pick(NONE, "easy"))
        where = f"{ours}, easy, still air, sensors {sensors}"
        found.append(claim(f"{where}: mean nMAE against no adaptation", p.of_means, "%", "<=", -gain))
        found.append(claim(f"{where}: flights > 5 % worse", p.clearly_worse, "%", "<=", worse))
    for preview, sensors, gain in (
        (True, "ideal", 30.0), (True, "noise", 15.0), (False, "ideal", 20.0), (False, "noise", 10.0),
    ):  # fmt: skip
        wanted = campaign.pick(ours, "easy", fault="F2 centre of gravity 0.25 m aft", preview=preview)
        p = paired(still(wanted, sensors), campaign.pick(NONE, "easy"))
        words = f"{ours}, CG shift, still air, preview {'yes' if preview else 'no'}, sensors {sensors}: mean nMAE"
        found.append(claim(words, p.of_means, "%", "<=", -gain))
    return found


def hindsight(campaign: Campaign) -> list[Claim]:
    """Return what knowing the flights would gain over no adaptation on the easy suite, in still air.

    With each flight's own best member, which no choice of one member can better, and with the one member of which the
    mean is lowest, flown throughout: what needs no adaptation.
    """
    if not campaign.members:
        return []
    found = []
    alone: dict[str, dict[Key, Record]] = {}
    for k, flights in campaign.members.items():
        for record in flights:
            if k[0] == "easy":
                alone.setdefault(record.member, {})[k] = record
    for sensors in TARGETED:
        none = still(campaign.pick(NONE, "easy"), sensors)
        gains = {member: paired(still(flights, sensors), none) for member, flights in alone.items()}
        gains = {member: p for member, p in gains.items() if p.both}
        if not gains:
            continue
        who = min(gains, key=lambda m: gains[m].of_means)
        best = paired(still(campaign.pick(ORACLE, "easy"), sensors), none)
        for words, p in (("each flight's best member", best), (f"{who} throughout", gains[who])):
            where = f"in hindsight, {words}, easy, still air, sensors {sensors}"
            found.append(claim(f"{where}: mean nMAE against no adaptation", p.of_means, "%"))
            found.append(claim(f"{where}: flights > 5 % worse", p.clearly_worse, "%"))
    return [c for c in found if c.value is not None]


def peers(campaign: Campaign, ours: str) -> list[Claim]:
    """Return by how much the best peer is better, in the fault of the easy suite where it is most.

    Once over all flights, and once without those in which the peer holds the attitude of an aircraft that falls.
    """
    flights = still(campaign.pick(ours, "easy"))
    found = []
    for flying in (False, True):
        worst, where, left_out = math.nan, "", 0
        for peer in (*PEERS, ROBUST):
            every = still(campaign.pick(peer, "easy"))
            theirs = {k: r for k, r in every.items() if not (flying and stalled(r))}
            left_out += sum(r.survived for k, r in every.items() if k not in theirs)
            for fault in sorted({k[1] for k in flights}):
                p = paired(*({k: r for k, r in row.items() if k[1] == fault} for row in (theirs, flights)))
                if p.both and not p.of_means >= worst:
                    worst, where = p.of_means, f"{peer}, {fault}"
        words = f"{ours}, easy, still air: where a peer's mean nMAE is furthest below ({where})"
        if not flying:
            found.append(claim(words, worst, "%", ">=", -10.0))
        elif left_out:
            found.append(claim(f"{words}, without {left_out} flights of peers on a stalled wing", worst, "%"))
    return found


def identified(campaign: Campaign, ours: str) -> list[Claim]:
    """Return what identification gains over the frozen nominal model, that of the same preset where it was flown."""
    frozen = f"{ours}-{FROZEN}" if f"{ours}-{FROZEN}" in campaign.rows else FROZEN

    def both(suite: str, *groups: str) -> tuple[Flights, Flights]:
        pair = (campaign.pick(row, suite) for row in (ours, frozen))
        mine, theirs = ({k: r for k, r in row.items() if not groups or r.group in groups} for row in map(still, pair))
        return mine, theirs

    found = []
    mine, theirs = both("hard")
    more = survival(mine, present(theirs)) - survival(theirs, present(mine))
    found.append(
        claim(f"{ours}, hard, still air: survives more than the nominal model ({frozen})", more, "points", ">", 0.0)
    )
    p = paired(*both("easy", "effectiveness"))
    words = f"{ours}, effectiveness, still air: mean nMAE against the nominal model ({frozen})"
    found.append(claim(words, p.of_means, "%", "<=", -10.0))
    worst, where = math.nan, ""
    for suite in campaign.suites:
        for group in sorted({r.group for r in campaign.pick(frozen, suite).values()}):
            p = paired(*both(suite, group))
            if p.both and not p.of_means <= worst:
                worst, where = p.of_means, f"{suite}, {group}"
    found.append(
        claim(f"{ours}: still air, furthest behind the nominal model ({frozen}; {where})", worst, "%", "<=", 2.0)
    )
    return found


def quiet(campaign: Campaign, ours: str) -> list[Claim]:
    """Return false alarms in flights without a fault, and whether they had consequences."""
    flights = {
        k: r for k, r in healthy(campaign, ours).items() if r.air in ("still", "light") and r.sensors in TARGETED
    }
    minutes = len(flights) * DURATION / 60.0
    alarms = sum(r.alarms + r.alarms_before for r in flights.values())
    p = paired(flights, healthy(campaign, NONE))
    every = 10.0 * alarms / minutes if minutes else math.nan
    lost = float(p.lost) if p.flights else math.nan
    return [
        claim(f"{ours}: alarms in 10 min without a fault, still air and light turbulence", every, "", "<=", 1.0),
        claim(f"{ours}: of these flights lost that no adaptation flew", lost, f"of {p.flights}", "=", 0.0),
    ]
