"""What the loop asks of whoever flies: a neural policy with live parameters or a classical law."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Policy(Protocol):
    """One answer a sample: :meth:`steer` to a state that can be used, then :meth:`sent` with what went out."""

    @property
    def parameters(self) -> np.ndarray:
        """Live parameters (K,) float32 that the cast changes in place; K = 0 for a policy without any."""

    def reset(self) -> None:
        """Start a new flight: forget everything that was learnt or remembered in the last one."""

    def restart_history(self) -> None:
        """Forget the last samples, not what was learnt: the next increment would span a gap."""

    def steer(self, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the action (3,) [rad] for a state x (12,) and a reference (3,) [rad], not yet limited.

        The array is reused by the next call.
        """

    def sent(self, command: np.ndarray) -> None:
        """Take the command (3,) [rad] that the last gate sent, which need not be what :meth:`steer` asked for."""
