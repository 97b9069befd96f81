"""The leaderboard as a page: its measures as dots with intervals, and all tables to sort."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from animarl_algos.benchmark.measured import Measured, Score, differences, labels
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report.figures import interval_rows
from animarl_algos.report.page import (
    Block,
    Gallery,
    Group,
    Page,
    Pairs,
    Row,
    Section,
    Sentences,
    Table,
)
from animarl_algos.report.provenance import flattened
from animarl_algos.report.style import Image, to_image

READING = (
    "Rollouts from the starts of the test split, which training, tuning and choosing never see.",
    "Outcome, duration, path length and speed are differences to the recordings; lower is better "
    "everywhere else.",
    "Ranks go by the energy score of duration, path length and speed together, as far as paired "
    "intervals tell two methods apart; recordings and tracking know where the recordings go and "
    "are not ranked.",
    "With several seeds an interval speaks of training runs like these, with one of this network.",
)
CAPTION = (
    "Dots with 95 % intervals over demonstrations and seeds, of the AUC over demonstrations alone. "
    "Grey bars, of differences to the recordings: what chance alone gives in 95 % of cases. "
    "Dashed: no difference; for the AUC what recordings reach among themselves, for energy scores "
    "and DTW what other recordings of the same condition come to."
)


def leaderboard_page(
    scores: Mapping[str, Sequence[Score]],
    ranks: Mapping[str, Mapping[str, Any]],
    synthetic: Mapping[str, bool],
    starts: Mapping[str, str],
    versions: Mapping[str, Any],
    missing: Sequence[tuple[str, str]] = (),
) -> str:
    """The page as HTML; the same scores give the same bytes.

    Parameters
    ----------
    scores
        By set of demonstrations, in the order of their rows.
    ranks
        By set and method, for those that have one.
    synthetic
        By set, whether its demonstrations were generated.
    starts
        By set, from where rollouts began, in words.
    versions
        Of what the numbers depend on.
    missing
        Rows that are not there, each with the reason.
    """
    sections = [Section("reading", "How to read it", [Sentences(READING)])]
    for name, some in scores.items():
        sections.append(Section(name, name, list(_blocks(some, ranks[name]))))
    if missing:
        lacking = [Row([row, why]) for row, why in missing]
        listed = Table("Rows that are not there", ["Row", "Why"], [Group("", lacking)], "")
        sections.append(Section("missing", "Not there", [listed]))
    sections.append(Section("versions", "Versions", [Pairs("Versions", flattened(dict(versions)))]))
    return Page(
        title="Leaderboard",
        kind="Every method, every set of demonstrations, every seed",
        synthetic=bool(scores) and all(synthetic[name] for name in scores),
        facts=[
            (name, f"{starts[name]}{', synthetic' if synthetic[name] else ''}") for name in scores
        ],
        sections=sections,
    ).html()


def _blocks(scores: Sequence[Score], ranks: Mapping[str, Any]) -> Iterator[Block]:
    yield Gallery([one for key in _drawn() if (one := _picture(key, scores))], CAPTION)
    rows = [
        Row(
            [one.method, str(ranks.get(one.method, "–")), *(_cell(one.of(key)) for key in labels())]
        )
        for one in scores
    ]
    heads = [
        labels()[key] + (f"\n({unit})" if (unit := scores[0].of(key).unit) else "")
        for key in labels()
    ]
    yield Table(
        "All measures",
        ["Method", "Rank", *heads],
        [Group("", rows)],
        "Estimates; intervals and nulls of every one are in leaderboard.csv. Endings to path "
        "length are distances and differences to the recordings.",
    )


def _drawn() -> tuple[str, ...]:
    own = (metric.key for metric in differences())
    return ("realism", "auc", "auc_sequence", "energy", *own, "dtw_per_step", "dtw_first_second")


def _cell(one: Measured) -> str:
    return f"{one.value:.3g}" if math.isfinite(one.value) else "–"


def _picture(key: str, scores: Sequence[Score]) -> Image | None:
    """One measure of all methods that have it."""
    found = {one.method: one.of(key) for one in scores if math.isfinite(one.of(key).value)}
    if not found:
        return None
    means = {name: Interval(one.value, one.low, one.high) for name, one in found.items()}
    bands, reference = None, 0.0
    if key in {metric.key for metric in differences()}:
        bands = {name: Interval(0.0, -one.null, one.null) for name, one in found.items()}
    else:
        nulls = [one.null for one in found.values() if math.isfinite(one.null)]
        reference = sum(nulls) / len(nulls) if nulls else math.nan
    unit, label = next(iter(found.values())).unit, labels()[key]
    figure = interval_rows(
        means,
        unit or labels()[key],
        title=labels()[key],
        reference=reference,
        bands=bands,
    )
    return to_image(figure, f"{label} of every method, with intervals")
