"""The last commands sent, as the imagination asks for them."""

from __future__ import annotations

import numpy as np

from task.state import N_ACTION


class CommandHistory:
    """The last ``length`` commands [rad], oldest first; before the first one since a restart, that one stands."""

    def __init__(self, length: int) -> None:
        self._ring = np.zeros((length, N_ACTION), dtype=np.float32)
        self._slots = list(self._ring)
        self.restart()

    def restart(self) -> None:
        """Forget: the next command is the first."""
        self._sent = 0

    def push(self, command: np.ndarray) -> None:
        """Take the command (3,) that was just sent."""
        if self._sent == 0:
            self._ring[:] = command
        else:
            np.copyto(self._slots[self._sent % len(self._slots)], command, casting="same_kind")
        self._sent += 1

    def latest(self) -> np.ndarray:
        """Return a copy, (length, 3) float32; zeros before anything was sent."""
        if self._sent == 0:
            return np.zeros_like(self._ring)
        return np.roll(self._ring, -(self._sent % len(self._slots)), axis=0)
