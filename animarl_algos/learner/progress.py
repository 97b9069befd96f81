"""Progress: a bar on a terminal, and lines with an estimate in a log."""

import sys
from typing import Any

from tqdm import tqdm as lines
from tqdm.auto import tqdm

LOG_EVERY = 30.0  # [s] between lines of progress where there is no terminal


class Log:
    """Standard error for logs: each state of a progress bar becomes a line of its own."""

    def write(self, text: str) -> None:
        """Write a text, each state of the bar on a line of its own."""
        if line := text.strip("\r\n "):
            sys.stderr.write(f"{line}\n")

    def flush(self) -> None:
        """Flush the standard error."""
        sys.stderr.flush()


def progress_display(
    what: str, unit: str, total: int, *, done: int = 0, disable: bool = False
) -> tqdm:
    """Return a progress bar; in a log a line every ``LOG_EVERY`` s says how long it will take."""
    known: dict[str, Any] = {"desc": what, "unit": unit, "total": total, "initial": done}
    if sys.stderr.isatty():
        return tqdm(**known, disable=disable)
    form = "{desc}: {n_fmt} of {total_fmt} {unit}s after {elapsed}, about {remaining} left"
    often: dict[str, Any] = {"miniters": 1, "mininterval": LOG_EVERY, "delay": LOG_EVERY}
    return lines(**known, **often, file=Log(), bar_format=form, disable=disable)
