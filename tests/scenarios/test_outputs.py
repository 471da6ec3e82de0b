"""Outputs are seen to before anything flies; nothing that is not a flight's own is touched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from scenarios import cli, run
from scenarios.outputs import LOCK, claimed
from scenarios.run import Job, Result, fly, inputs_digest
from task.config import load_json
from task.errors import UserError


@pytest.fixture
def job(make_result: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Job:
    """Return a flight of a law that takes no time: what it leaves is written by hand."""
    made = make_result("pid")

    def flown(job: Job, *_: object) -> None:
        (job.folder / "flight.ulg").write_text("new")

    monkeypatch.setattr(run, "_fly_processes", flown)
    monkeypatch.setattr(run, "load_result", lambda job, seconds, reused: replace(made, job=job, reused=reused))
    (tmp_path / "cast").mkdir()
    (tmp_path / "cast" / "manifest.json").touch()
    return replace(made.job, population=tmp_path / "cast", folder=tmp_path / "out")


def test_what_others_left_in_the_folder_stays(job: Job) -> None:
    job.folder.mkdir()
    for name in ("notes.txt", "flight.ulg", "flight.2.ulg", "flight.2.config.json", "flight.mine.ulg"):
        (job.folder / name).write_text("old")
    (job.folder / "pictures").mkdir()
    fly(job)
    assert sorted(path.name for path in job.folder.iterdir()) == [
        "finished.json", "flight.mine.ulg", "flight.ulg", "notes.txt", "pictures",
    ]  # fmt: skip
    assert (job.folder / "flight.ulg").read_text() == "new"


def test_a_folder_in_a_files_place_is_said_before_anything_is_removed(job: Job) -> None:
    fly(job)
    (job.folder / "truth.npz").mkdir()
    with pytest.raises(UserError, match=r"truth\.npz: is a folder where a flight writes a file"):
        fly(job, fresh=True)
    assert (job.folder / "flight.ulg").exists()
    assert fly(job).reused


@pytest.mark.parametrize("text", ["", '{"inputs": "a', "[]"])
def test_a_damaged_record_is_flown_again(job: Job, text: str) -> None:
    fly(job)
    (job.folder / "finished.json").write_text(text)
    assert not fly(job).reused
    assert load_json(job.folder / "finished.json", run.Finished).inputs == inputs_digest(job)
    assert fly(job).reused


def test_two_commands_do_not_fly_into_one_folder(tmp_path: Path) -> None:
    with claimed(tmp_path), pytest.raises(UserError, match="another command flies there now"), claimed(tmp_path):
        pass
    with claimed(tmp_path):
        assert (tmp_path / LOCK).exists()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--out", "file/out"), "cannot be written: Not a directory"),
        (("--out", "file"), "cannot be written"),
        (("--out", "/proc/out"), "cannot be written"),
        (("--picture", "/proc/x.png"), "cannot be written"),
        (("--picture", "folder"), "folder: is a folder; expected the name of a file"),
    ],
)
def test_outputs_that_cannot_be_are_said_before_anything_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "fly_scenario", lambda *_: pytest.fail("flew"))
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    ended = CliRunner().invoke(cli.fly, ["nominal", *options])
    assert isinstance(ended.exception, UserError)
    assert line in str(ended.exception)
    assert "\n" not in str(ended.exception)
