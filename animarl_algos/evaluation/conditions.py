"""Recordings of two conditions compared with each other, before any simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animarl_algos.evaluation.verdict_rows import (
    AS_BUILT,
    JUDGEMENTS,
    Comparison,
    Questions,
    Row,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError


@dataclass(frozen=True)
class ComparedConditions:
    """Rows of a comparison of the second condition with the first.

    ``names`` are those of the conditions, ``recordings`` how many each has.
    """

    names: tuple[str, str]
    recordings: tuple[int, int]
    rows: tuple[Row, ...]

    @property
    def headline(self) -> str:
        """How many questions have which word."""
        words = [row.judgement for row in self.rows]
        counts = [f"{words.count(word)} {word}" for word in JUDGEMENTS if word in words]
        sides = " and ".join(
            f"{number} of {name}" for name, number in zip(self.names, self.recordings)
        )
        return f"Recordings: {sides}. Of {len(words)} questions: {', '.join(counts)}."


def compare_conditions(
    demos: Demonstrations,
    names: Sequence[str] | None = None,
    questions: Questions = AS_BUILT,
    *,
    seed: int = 0,
) -> ComparedConditions:
    """Compare recordings of two conditions by all metrics of a verdict.

    Parameters
    ----------
    demos
        Recordings of two conditions or more, all splits.
    names
        Which two, by name or number; by default the first two.
    questions
        Tolerances and primary measures.
    seed
        Of the exchanges of recordings between the conditions.

    Raises
    ------
    InputError
        If there are fewer than two conditions, or one is named that is not there.
    """
    given = demos.provenance.get("conditions") or []
    there = np.unique(demos.condition).tolist()
    known = {str(given[index] if index < len(given) else index): index for index in there}
    chosen = list(known)[:2] if names is None else [name.strip() for name in names]
    if len(chosen) != 2 or set(chosen) - set(known) or len(set(chosen)) < 2:
        raise InputError(
            f"{demos.name}: two different conditions are needed, and it has "
            f"{', '.join(known)}: give two of them with --conditions, or join files with "
            "'animarl data merge --conditions'"
        )
    sides = [
        demos.select(episodes=np.flatnonzero(demos.condition == known[name])) for name in chosen
    ]
    comparison = Comparison.between(sides[0], sides[1], np.random.default_rng(seed), questions)
    return ComparedConditions(
        (chosen[0], chosen[1]),
        (len(np.unique(sides[0].recording)), len(np.unique(sides[1].recording))),
        tuple(comparison.rows()),
    )
