"""The one error that a user is meant to read."""

from __future__ import annotations


class UserError(Exception):
    """Bad input from outside: a file, a parameter, a scenario, the environment.

    The message is one line that says what, where, expected and got, and what to do. Commands print
    it without a traceback and leave with exit code 2; anything else that is raised is a defect.
    """
