"""Small tables beside recordings: events, metadata, indices; a line each, cells by column."""

from __future__ import annotations

import csv
from pathlib import Path

from animarl_envs.errors import InputError
from animarl_envs.files import refuse_unfinished

SEPARATORS = ",;\t"
Rows = list[tuple[int, dict[str, str]]]


def read_rows(path: Path, needed: set[str]) -> tuple[Rows, list[str]]:
    """Return each line with its number and its cells by column, and the names of the columns.

    Raises
    ------
    InputError
        If it cannot be read, lacks a needed column, or has a line of another length.
    """
    from animarl_envs.importing.readers.text_layout import encoding_of  # readers import recipes

    refuse_unfinished(path)
    try:
        with path.open(newline="", encoding=encoding_of(path)) as file:
            header = file.readline()
            separator = max(SEPARATORS, key=header.count)
            file.seek(0)
            table = [(i, row) for i, row in enumerate(csv.reader(file, delimiter=separator), 1)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: it cannot be read ({error}): check it") from None
    names = [name.strip().lower() for name in table[0][1]] if table else []
    if lacking := sorted(needed - set(names)):
        raise InputError(
            f"{path}: it lacks the column {lacking[0]} (it has {', '.join(names) or 'none'}): add "
            "it"
        )
    if len(set(names)) < len(names):
        raise InputError(f"{path}: two columns have one name: rename one of them")
    rows: Rows = []
    for number, cells in table[1:]:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(names):
            raise InputError(
                f"{path}: line {number} has {len(cells)} cells, the header {len(names)}: correct it"
            )
        rows.append((number, dict(zip(names, (cell.strip() for cell in cells), strict=True))))
    return rows, names
