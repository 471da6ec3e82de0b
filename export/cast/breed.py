"""Breeds the candidates of a cast, one search after another; each round is a file, and what is there is not redone."""

from __future__ import annotations

import hashlib
import re
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np

from export.cast.cases import EASY, Case
from export.cast.config import CastSettings, SearchSettings
from export.cast.flights import Stage
from export.cast.search import Draw, Judge, search
from export.cast.trials import Drawer, random_case, random_conditions
from export.cast.variants import levelled, mirrored, symmetric, variant_name
from export.mirrors import AXES
from export.network import Network, n_parameters, validate
from sim_bridge.conditions import NOMINAL
from task.config import Settings, load_json, to_json
from task.errors import UserError
from task.files import atomic, make_folder
from task.state import STATE

Report = Callable[[str, bool], None]
"""Takes a line about the work, and whether it stays."""
MAIN, ROBUST = "nominal", "robust"
START_SCALE = 0.1
"""Standard deviation of the random parameters that the main member begins from."""


class Bred(Settings, frozen=True):
    """What one round of one search left: a file in the run's folder ``bred``."""

    case: str
    """It was bred for."""
    round: int
    key: str
    """Hash of the settings that decide it, the cast's seed and shape included."""
    start: str
    """Name of the policy that the search began from."""
    start_cost: float
    """On the tuning trials of the round [% nMAE]."""
    cost: float
    frames: int
    """Simulated in this round."""
    seconds: float
    parameters: tuple[float, ...]


def slug(name: str) -> str:
    """Return a case's name as a file's."""
    return re.sub(r"[^a-z0-9.-]+", "_", name.lower()).strip("_")


class Breeder:
    """A run: its configuration, its folder and everything bred so far."""

    def __init__(self, settings: CastSettings, folder: Path) -> None:
        """Make the folder and read what it holds. Raises UserError when it is of another configuration."""
        self.settings, self.folder = settings, folder
        self.network = Network(layers=settings.layers, input_scale=settings.input_scale)
        validate(self.network, settings.name)
        self.stage = Stage()
        self.judge = Judge(self.stage, self.network, settings.trial)
        self.drawer = Drawer(settings.trial, self.stage.plant)
        self.cases: dict[str, Case] = {case.name: case for case in (*EASY, *settings.cases)}
        self.hard = {case.name for case in settings.cases}
        slugs = [slug(name) for name in (*self.cases, ROBUST)]
        if twice := [name for name in (*self.cases, ROBUST) if slugs.count(slug(name)) > 1]:
            raise UserError(
                f"cases: expected names that differ in letters and digits, got {' and '.join(twice)}; rename one"
            )
        make_folder(folder / "bred", "--out")
        self.bred: dict[tuple[str, int], Bred] = {}
        planned = {name: search_settings for name, _, search_settings in self.plan()}
        for path in sorted((folder / "bred").glob("*.json")):
            one = load_json(path, Bred, "bred policy")
            if one.case not in planned:
                continue  # the configuration no longer asks for it
            if one.key != self._key(one.case, planned[one.case]):
                raise UserError(
                    f"{path}: bred with other settings than the configuration's; give that configuration, choose "
                    "another --out, or delete the file to breed it again"
                )
            self.bred[one.case, one.round] = one

    def plan(self) -> Iterator[tuple[str, int, SearchSettings]]:
        """Yield every round in order: the main member, the specialists, the robust policy."""
        s = self.settings
        for round_ in range(s.main.rounds):
            yield MAIN, round_, s.main
        for name in (*s.bred_for, *(case.name for case in s.cases)):
            for round_ in range(s.specialist.rounds):
                yield name, round_, s.specialist
        for round_ in range(s.robust.rounds):
            yield ROBUST, round_, s.robust

    def _key(self, name: str, search_settings: SearchSettings) -> str:
        """Return a hash of everything that decides a search, except what its opening and its starts are."""
        s = self.settings
        free = msgspec.structs.replace(search_settings, rounds=1)
        parts = [s.seed, s.layers, s.input_scale, s.trial, free, s.gains if name != MAIN else ()]
        parts.append(s.randomised if name == ROBUST else self.cases[name])
        return hashlib.sha256(msgspec.json.encode(parts)).hexdigest()[:16]

    def result(self, name: str) -> np.ndarray | None:
        """Return the parameters (K,) of a search's last round; None while there is none."""
        rounds = [round_ for case, round_ in self.bred if case == name]
        return np.array(self.bred[name, max(rounds)].parameters) if rounds else None

    def breed(self, report: Report, stop: Callable[[], bool] = lambda: False) -> bool:
        """Run the rounds that are missing; return whether none is left."""
        for name, round_, search_settings in self.plan():
            if (name, round_) in self.bred:
                continue
            if stop():
                return False
            self._round(name, round_, search_settings, report)
        return True

    def _round(self, name: str, round_: int, settings: SearchSettings, report: Report) -> None:
        began, frames = time.monotonic(), self.stage.frames
        seed = np.random.SeedSequence([self.settings.seed, zlib.crc32(name.encode()), round_])
        of_start, of_search = seed.spawn(2)
        draw = self.draw(name)
        self.judge.opening = self.result(MAIN) if name in self.hard else None
        start_name, start = self._start(name, round_, draw, np.random.default_rng(of_start))
        done = 0

        def heard(best: float) -> None:
            nonlocal done
            done += 1
            report(f"{name}, round {round_ + 1}: {done} of {settings.iterations}, best {best:.2f} %", False)

        free = symmetric(self.network) if settings.symmetric else np.ones(len(start), dtype=bool)
        found = search(self.judge, draw, np.where(free, start, 0.0), free, settings, of_search, heard)
        one = Bred(
            case=name,
            round=round_,
            key=self._key(name, settings),
            start=start_name,
            start_cost=found.start_cost,
            cost=found.cost,
            frames=self.stage.frames - frames,
            seconds=round(time.monotonic() - began, 1),
            parameters=tuple(found.parameters.tolist()),
        )
        path = self.folder / "bred" / f"{slug(name)}.{round_}.json"
        with atomic(path) as file:
            file.write(to_json(one))
        self.bred[name, round_] = one
        report(f"{name}, round {round_ + 1}: {found.start_cost:.2f} ({start_name}) -> {found.cost:.2f} %", True)

    def draw(self, name: str) -> Draw:
        """Return what draws the trials of a search."""
        if name != ROBUST:
            case = self.cases[name]
            return lambda rng, count: self.drawer.trials(rng, case, count, sudden=name in self.hard)
        randomised = self.settings.randomised
        trims = random_conditions(np.random.default_rng(self.settings.seed), randomised)
        return lambda rng, count: [
            self.drawer.trials(rng, random_case(rng, randomised, trims), 1, sudden=False)[0] for _ in range(count)
        ]

    def _start(self, name: str, round_: int, draw: Draw, rng: np.random.Generator) -> tuple[str, np.ndarray]:
        """Return where a round begins: the last round, random parameters, or the best of what is there."""
        last = self.result(name)
        if last is not None:
            return f"round {round_}", last
        if name == MAIN:
            return "random", START_SCALE * rng.standard_normal(n_parameters(self.network))
        starts = self.variants()
        cost = self.judge(np.array(list(starts.values())), draw(rng, 2)).mean(axis=1)
        best = int(np.argmin(cost))
        return list(starts)[best], list(starts.values())[best]

    def variants(self) -> dict[str, np.ndarray]:
        """Return what a specialist may start from: the main member's mirrors and levels, and all bred before it."""
        main = self.result(MAIN)
        assert main is not None, "the main member is bred first"
        self.stage.plant.reset(NOMINAL)
        alpha = float(self.stage.plant.trim.x[STATE.alpha])
        found: dict[str, np.ndarray] = {}
        for gain in self.settings.gains:
            level = levelled(self.network, main, gain, alpha)
            for axes in ((), *AXES):
                row = mirrored(self.network, level, axes) if axes else level
                found[variant_name(MAIN, gain, axes)] = row
        for case in {case: None for case, _ in self.bred}:
            result = self.result(case)
            if case not in (MAIN, ROBUST) and result is not None:
                found[case] = result
        return found
