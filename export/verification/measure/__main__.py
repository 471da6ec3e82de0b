"""Entry of ``python -m export.verification.measure``."""

from __future__ import annotations

from understudy import run

if __name__ == "__main__":
    run("export.verification.measure.command:main")
