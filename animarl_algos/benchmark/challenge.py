"""The challenge: simulate the animals of frozen test episodes, ``ROLLOUTS`` times from every start.

Its form is that of the Waymo Open Sim Agents Challenge (Montali et al. 2023, arXiv 2305.12032). An
entry is a file of rollouts, as in :mod:`animarl_algos.benchmark.scores`, and the row of the table
that its score makes. ``challenge.csv`` freezes the sets: an entry counts only against
demonstrations with the fingerprint written there.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from animarl_algos.benchmark.scores import REALISM, Score, read_submission, score
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError, printable
from animarl_envs.files import write_then_rename

ROLLOUTS = 32  # from every start
COLUMNS = ("set", "entry", "realism", "low", "high", "verdict", "sha256")
START_COLUMNS = ("episode", "condition", "individual", "role", "x", "y", "vx", "vy")


@cache
def frozen_sets() -> dict[str, str]:
    """Return the fingerprint of each set of the challenge, by name."""
    with Path(__file__).with_name("challenge.csv").open() as file:
        return {row["set"]: row["fingerprint"] for row in csv.DictReader(file)}


def load_set(name: str, data: str | Path | None = None) -> Demonstrations:
    """Return the demonstrations of a set of the challenge, all splits.

    Those of living animals do not come with the package: ``data`` is the user's file.

    Raises InputError if there is no such set, or its demonstrations are not the frozen ones.
    """
    frozen = frozen_sets()
    if name not in frozen:
        raise InputError(
            f"{printable(name)} is no set of the challenge: choose among {', '.join(frozen)}"
        )
    if data is None and name not in packaged_names():
        raise InputError(f"{name} does not come with the package: name its file with --data")
    demos = load_packaged(name) if data is None else Demonstrations.load(data)
    if demos.fingerprint() != frozen[name]:
        raise InputError(
            f"{data or name}: its fingerprint is {demos.fingerprint()}, and the set {name} of the "
            f"challenge has {frozen[name]}: make the file as docs/challenge.md says"
        )
    return demos


def write_starts(demos: Demonstrations, out: Path) -> None:
    """Write position and velocity of every individual at the start of each test episode, as CSV.

    Lengths are in arena units, velocities in arena units per second.
    """
    test = demos.select(split="test")
    rows = []
    for episode in range(len(test)):
        first, velocity = test.path(episode)[0], test.initial_velocity[episode]
        for i, (name, role) in enumerate(zip(test.individuals, test.roles, strict=True)):
            state = (repr(float(value)) for value in (*first[i], *velocity[i]))
            rows.append((episode, int(test.condition[episode]), name, role, *state))
    _write(out, START_COLUMNS, rows)


def score_entry(
    path: Path, name: str, data: str | Path | None = None, *, resamples: int = RESAMPLES
) -> Score:
    """Check and score an entry.

    Raises InputError if it has not ``ROLLOUTS`` rollouts of one seed from every start.
    """
    demos = load_set(name, data)
    made = read_submission(path, name, demos)
    if len(np.unique(made.seed)) > 1:
        raise InputError(f"{path}: an entry is of one seed, and it has {len(np.unique(made.seed))}")
    counts = np.bincount(made.demo)
    if (counts != ROLLOUTS).any():
        start = int(np.flatnonzero(counts != ROLLOUTS)[0])
        raise InputError(
            f"{path}: {counts[start]} rollouts are from test episode {start}: an entry has "
            f"{ROLLOUTS} from every start"
        )
    return score(made, demos, resamples=resamples)


def row_of(scored: Score, name: str, path: Path) -> dict[str, str]:
    """Return the row of the table that a scored entry makes, with the hash of its file."""
    realism = scored.by_measure[REALISM]
    measured = (realism[key] for key in ("value", "low", "high"))
    numbers = (f"{value:.3f}" if np.isfinite(value) else "" for value in measured)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return dict(zip(COLUMNS, (name, scored.method, *numbers, scored.words, digest), strict=True))


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table; none if there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def add_row(row: Mapping[str, str], path: Path) -> None:
    """Write a row into a table, in the place of an earlier one of the same set and entry."""
    key = (row["set"], row["entry"])
    kept = [old for old in read_table(path) if (old["set"], old["entry"]) != key]
    order = list(frozen_sets())
    rows = sorted([*kept, row], key=lambda r: (order.index(r["set"]), -float(r["realism"])))
    _write(path, COLUMNS, [tuple(each[name] for name in COLUMNS) for each in rows])


def _write(path: Path, heading: Sequence[str], rows: Sequence[tuple[object, ...]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with write_then_rename(path) as part, part.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([heading, *rows])
