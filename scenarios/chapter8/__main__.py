"""Entry of ``python -m scenarios.chapter8``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("scenarios.chapter8.command:main")
