"""Tables of events, by which recordings are cut: recording, start, end [s], condition, outcome."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path

from animarl_envs.errors import InputError
from animarl_envs.files import refuse_unfinished

NEEDED = {"recording", "start", "end"}
SHOWN = 10  # recordings


def event_rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """The lines of a table, each with its number.

    Raises
    ------
    InputError
        If it cannot be read or lacks a column.
    """
    refuse_unfinished(path)
    try:
        with path.open(newline="") as file:
            table = csv.DictReader(file)
            rows = [(table.line_num, row) for row in table]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: the event table cannot be read ({error}): check it") from None
    if rows and not set(rows[0][1]) >= NEEDED:
        raise InputError(f"{path}: it lacks a column recording, start or end: add them")
    return rows


def check_recordings(path: Path, recordings: Sequence[str]) -> None:
    """Warn of events of recordings that there are none of: misspelt, or of files left out.

    Raises
    ------
    InputError
        If all are.
    """
    rows = event_rows(path)
    strange = [(line, row["recording"]) for line, row in rows if row["recording"] not in recordings]
    if not strange:
        return
    line, name = strange[0]
    known = ", ".join(recordings[:SHOWN]) + ", ..." * (len(recordings) > SHOWN)
    if len(strange) == len(rows):
        raise InputError(
            f"{path}: line {line} is of recording {name!r} and no line is of any that is imported "
            f"({known}): mend the names"
        )
    warnings.warn(
        f"{path}: {len(strange)} of {len(rows)} events are of recordings that are not imported, "
        f"the first on line {line} ({name!r}; imported: {known})",
        stacklevel=2,
    )
