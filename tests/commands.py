"""How a command ended, for tests that call one in this process."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Done:
    """Exit status and what was printed."""

    returncode: int
    stdout: str
    stderr: str
