"""Entry of ``python -m scenarios.shipped``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("scenarios.shipped.command:main")
