"""The flights of a campaign by row: those that were flown as rows, and those that follow from the members' flights."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import msgspec

from scenarios.campaign.rows import DERIVED, MEMBERS, NONE, ORACLE, ROBUST, known_rows
from scenarios.campaign.scores import Record
from scenarios.campaign.statistics import Key, key, mean, suited, time_to_suited
from scenarios.campaign.suites import places
from task.errors import UserError


def _in_order(records: Iterable[Record]) -> list[Record]:
    """Return flights as they are planned: tables and resampled intervals must not tell which was finished first."""
    kept = list(records)
    place = {suite: places(suite) for suite in {r.suite for r in kept}}

    def planned(r: Record) -> tuple[int, str, int, str, str, str, str]:
        of_suite = place[r.suite]
        return r.index, r.suite, of_suite.get(r.fault, len(of_suite)), r.group, r.fault, r.row, r.member

    return sorted(kept, key=planned)


class Campaign:
    """All flights of one half, by row and flight."""

    def __init__(
        self, records: Iterable[Record], champion: str, robust: str = "", oracle_laws: Sequence[str] = ()
    ) -> None:
        """Sort the flights.

        champion: who flies first; robust: the member of that row, found when not given; oracle_laws: rows of laws that
        the oracle may choose besides the members. Raises UserError when one of them is not there.
        """
        self.rows: dict[str, dict[Key, Record]] = defaultdict(dict)
        """Row, then flight."""
        self.members: dict[Key, list[Record]] = defaultdict(list)
        """Flight: one record for each member; with the oracle's laws once these are among its choices."""
        self.flown = 0
        """Flights, those of members among them."""
        self.oracle_laws = tuple(oracle_laws)
        """Laws that the oracle may choose."""
        for record in _in_order(records):
            self.flown += 1
            if record.row == MEMBERS:
                self.members[key(record)].append(record)
            else:
                self.rows[record.row][key(record)] = record
        self.robust: dict[str, str] = {}
        """Suite: the member of its row ``robust``."""
        for suite in {k[0] for k in self.members}:
            self.robust[suite] = robust or self._most_robust(suite)
        self._add_laws()
        for k, flights in self.members.items():
            self._derive(k, flights, champion)
        order = [*DERIVED, *known_rows()]
        names = sorted(self.rows, key=lambda name: (order.index(name) if name in order else len(order), name))
        self.rows = {name: self.rows[name] for name in names}

    def _add_laws(self) -> None:
        """Join the flights of laws with those of the members of the same cells, as members of the law's name."""
        for law in self.oracle_laws:
            if law not in self.rows or not self.members:
                raise UserError(
                    f"--oracle-laws {law}: the oracle needs the flights of this row and those of the members; "
                    f"give --rows members,{law}"
                )
            for k, record in self.rows[law].items():
                if k in self.members:
                    self.members[k].append(msgspec.structs.replace(record, row=MEMBERS, member=law))

    def _most_robust(self, suite: str) -> str:
        """Return the member that survives most flights of a suite; of those the one with the least mean nMAE."""
        flown: dict[str, list[Record]] = defaultdict(list)
        for k, flights in self.members.items():
            if k[0] == suite:
                for record in flights:
                    flown[record.member].append(record)
        return min(
            flown,
            key=lambda m: (-sum(r.survived for r in flown[m]), mean([r.nmae for r in flown[m] if r.survived]), m),
        )

    def _derive(self, k: Key, flights: list[Record], champion: str) -> None:
        by_name = {r.member: r for r in flights}
        wanted = {
            NONE: champion,
            ROBUST: self.robust[k[0]],
            ORACLE: min(flights, key=lambda r: (not r.survived, r.nmae if r.survived else -r.lost_after)).member,
        }
        for row, member in wanted.items():
            if member not in by_name:
                raise UserError(f"--robust {member}: no such member; choose from {', '.join(by_name)}")
            self.rows[row][k] = msgspec.structs.replace(by_name[member], row=row)

    def pick(self, row: str, suite: str = "", **wanted: object) -> dict[Key, Record]:
        """Return the flights of a row, of one suite and of given factors' levels."""
        return {
            k: r
            for k, r in self.rows.get(row, {}).items()
            if (not suite or k[0] == suite) and all(getattr(r, name) == value for name, value in wanted.items())
        }

    def levels(self, factor: str) -> list[object]:
        """Return the levels of a factor that were flown."""
        return list(dict.fromkeys(getattr(r, factor) for row in self.rows.values() for r in row.values()))

    @property
    def suites(self) -> list[str]:
        """Return the suites that were flown."""
        return sorted({k[0] for row in self.rows.values() for k in row})

    def casting(self, flights: Mapping[Key, Record], all_suited: bool = False) -> list[float]:
        """Return the time from the fault until a suited member flies [s], one for each flight that asks for a change.

        Such a flight has a suited member, and it is not the one that flies when the fault comes; inf when none ever
        flew. With ``all_suited`` every flight that has a suited member counts, with 0 where it flies already. A law in
        the cast's place has no such times.
        """
        times = []
        for k, record in flights.items():
            members = self.members.get(k, [])
            if suited(members) and record.switched_to:
                times.append(time_to_suited(record, members))
        return times if all_suited else [at for at in times if at > 0.0]
