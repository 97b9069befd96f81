"""Rows that hold several individuals, each with a column of its name, become a row for each."""

import itertools
from dataclasses import replace

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.importing.table_columns import Columns
from animarl_envs.importing.tables import TextColumn


def stack_slots(
    number: dict[str, Floats], word: dict[str, TextColumn], columns: Columns
) -> tuple[dict[str, Floats], dict[str, TextColumn], Columns, Ints]:
    """Return a row for each individual, where rows hold several that columns name.

    Last is the row of the table that each is of.
    """
    slots = list(columns.tracks)
    own = {name: [p for p in columns.positions if p.individual == name] for name in slots}
    first = own[slots[0]]
    rows = [np.flatnonzero(word[column].number >= 0) for column in columns.tracks.values()]
    entries = sorted(set(itertools.chain(*(word[c].entries for c in columns.tracks.values()))))
    owners = [
        np.searchsorted(entries, np.array(word[column].entries))[word[column].number[at]]
        for column, at in zip(columns.tracks.values(), rows, strict=True)
    ]
    order = np.concatenate(rows)
    used = set(
        itertools.chain(
            *(p.columns for p in columns.positions), (p.score for p in columns.positions)
        )
    )
    stacked = {name: values[order] for name, values in number.items() if name not in used}
    for at, position in enumerate(first):
        for k, column in enumerate((*position.columns, position.score)):
            parts = [(*own[name][at].columns, own[name][at].score)[k] for name in slots]
            if column is not None:
                values = [number[str(part)][rows_] for part, rows_ in zip(parts, rows, strict=True)]
                stacked[column] = np.concatenate(values)
    words = {
        name: TextColumn(value.entries, value.number[order])
        for name, value in word.items()
        if name not in columns.tracks.values()
    }
    column = columns.tracks[slots[0]]
    words[column] = TextColumn(entries, np.concatenate(owners).astype(np.int64))
    positions = tuple(replace(position, individual="") for position in first)
    return (
        stacked,
        words,
        replace(columns, individual=column, positions=positions, tracks={}),
        order,
    )
