"""How every command says what is wrong: one line and an exit code, no traceback."""

from __future__ import annotations

import os
import subprocess
import sys

import click
import pytest

from task.errors import UserError
from understudy import INTERRUPTED, run


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (UserError("x: expected y"), 2, "understudy: x: expected y\n"),
        (click.UsageError("no such option"), 2, "Error: no such option\n"),
        (KeyboardInterrupt(), INTERRUPTED, "\nunderstudy: stopped\n"),
        (SystemExit(3), 3, ""),
        (None, 0, ""),
    ],
)
def test_what_a_command_raises_becomes_a_line_and_a_code(raised, code, said, capsys, monkeypatch):
    @click.command()
    def command():
        if raised is not None:
            raise raised

    monkeypatch.setattr(sys, "argv", ["command"])
    monkeypatch.setenv("MPLBACKEND", "agg")
    with pytest.raises(SystemExit) as left:
        run(command)
    assert left.value.code == code
    assert capsys.readouterr().err.endswith(said)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bench.scheduling", "--population", "zzz"], "understudy: zzz: no such population"),
        (["bench.verification", "--runs", "/nowhere"], "understudy: /nowhere"),
        (["bench.link", "--rounds", "0"], "Invalid value for '--rounds'"),
        (["bench.decision", "--references", "0"], "Invalid value for '--references'"),
        (["bench.train", "--seconds", "0"], "Invalid value for '--seconds'"),
        (["bench.cast_shapes", "--zzz"], "No such option"),
        (["export.study", "zzz"], "No such command"),
        (["export.verification.measure", "--zzz"], "No such option"),
        (["scenarios.chapter8", "--references", "0"], "Invalid value for '--references'"),
        (["scenarios.shipped", "--scenario", "zzz"], "zzz"),
        (["understudy", "results", "--out", "/proc/x.md"], "understudy: /proc: cannot be written: "),
    ],
)
def test_bad_input_is_no_traceback(arguments, said):
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "MPLBACKEND": "nonsense"}
    done = subprocess.run(
        [sys.executable, "-m", *arguments], capture_output=True, text=True, timeout=60, check=False, env=environment
    )
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
