"""Entry of ``python -m export.study``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("export.study.command:study")
