"""The quick campaign as a newcomer flies it, with the cast that is there: one fault of it here."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import msgspec
import pyarrow.parquet as pq
import pytest

from runtime.population import load_population
from scenarios.campaign.command import QUICK
from task.files import find_population
from task.results import Result

COMMAND = (
    sys.executable, "-m", "scenarios.campaign", "--quick", "--half", "tuning", "--references", "1", "--jobs", "1",
    "--fault", "elevator x -1", "--oracle-laws", "pid",
)  # fmt: skip


def fly(folder) -> subprocess.CompletedProcess:
    return subprocess.run([*COMMAND, "--out", folder], capture_output=True, text=True, timeout=100, check=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of a quick campaign that nobody stopped."""
    folder = tmp_path_factory.mktemp("quick")
    done = fly(folder)
    assert done.returncode == 0, done.stderr
    assert "seconds a flight: members" in done.stdout
    return folder


def test_it_leaves_claims_tables_pictures_and_flights(whole):
    assert "elevator x -1" in QUICK
    found = msgspec.json.decode((whole / "campaign.json").read_bytes(), type=Result)
    claims = {c.claim: c for c in found.claims}
    assert claims["ensemble, hard, all: survives of what the oracle survives"].value in (0.0, 100.0)
    assert any(c.target == ">= 0" and c.holds is not None for c in found.claims)
    titles = {t.title for t in found.tables}
    assert {"Suite hard: every row", "Suite hard: median nMAE over the oracle's, by group"} <= titles
    every = next(t for t in found.tables if t.title.endswith("every row"))
    rows = [row[0] for row in every.rows]
    assert rows == ["none", "robust", "oracle", "understudy", "structured", "ensemble", "pid", "indi-rls-signfree"]
    flights = pq.read_table(whole / "campaign.parquet")
    assert len(flights) == found.runs == 5 + len(load_population(find_population("citation")).members)
    assert any("the laws pid among them" in note for note in found.notes)
    assert (whole / "campaign_hard.png").stat().st_size > 10_000
    assert "# " in (whole / "report.md").read_text()


def test_killed_and_started_again_it_gives_the_same_file(whole, tmp_path):
    journal = tmp_path / "journal.jsonl"
    with subprocess.Popen([*COMMAND, "--out", tmp_path], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as begun:
        until = time.monotonic() + 60.0
        while not (journal.exists() and b"\n" in journal.read_bytes()) and time.monotonic() < until:
            time.sleep(0.02)
        os.kill(begun.pid, signal.SIGKILL)
    before = journal.read_bytes()
    assert 1 <= before.count(b"\n") < 5
    assert not (tmp_path / "campaign.parquet").exists()
    done = fly(tmp_path)
    assert done.returncode == 0, done.stderr
    assert journal.read_bytes().startswith(before)
    assert (tmp_path / "campaign.parquet").read_bytes() == (whole / "campaign.parquet").read_bytes()


POOL = """
import multiprocessing, os, signal, time
from concurrent.futures import ProcessPoolExecutor
from scenarios.campaign.work import end_with_parent
if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), end_with_parent)
    print(pool.submit(os.getpid).result(), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_after_a_kill_no_process_of_the_pool_is_left(tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    killed = subprocess.run([sys.executable, tmp_path / "pool.py"], stdout=subprocess.PIPE, timeout=60, check=False)
    assert killed.returncode == -signal.SIGKILL
    worker, until = int(killed.stdout), time.monotonic() + 10.0
    while alive(worker) and time.monotonic() < until:
        time.sleep(0.05)
    left = alive(worker)
    if left:
        os.kill(worker, signal.SIGKILL)
    assert not left


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
