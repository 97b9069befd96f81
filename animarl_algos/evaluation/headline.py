"""What a verdict says in words: its headline, and what stands beside it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.verdict_rows import (
    ALIKE,
    DIFFERS,
    JUDGEMENTS,
    LITTLE,
    UNKNOWN,
    Row,
    farness,
    lower_first,
    rounded_count,
)

MOST_COMPLAINTS = 3  # of one sentence
NOTICED = ("mean_speed", "duration", "turning", "nearest_neighbour")  # changes beside the headline
HALF = 0.5  # of the recorded value: a larger gap is implausible
LEAST_SHARE = 0.1  # of episodes, that an implausible gap of shares has at least
SHARES = ("reached", "target_out", "pursuer_out")  # the last two: by leaving


def count_judgements(rows: Iterable[Row]) -> dict[str, int]:
    """Return how many questions have each word."""
    words = [row.judgement for row in rows]
    return {word: words.count(word) for word in JUDGEMENTS}


def list_complaints(rows: Iterable[Row]) -> tuple[str, ...]:
    """Return what differs, each thing once, farthest from alike first; classifiers come last.

    Which of them left is not listed where somebody was outside the arena.
    """
    wrong = [row for row in rows if row.judgement == DIFFERS]
    wrong.sort(key=lambda row: (row.measure not in (AUC, SEQUENCE), farness(row)), reverse=True)
    if any(row.measure == "leaving" for row in wrong):
        wrong = [row for row in wrong if row.measure not in SHARES[1:]]
    return tuple(dict.fromkeys(row.verdict for row in wrong))


def write_headline(rows: Sequence[Row], recordings: int) -> str:
    """Return how many questions have which word, what differs, and how many recordings would tell.

    ``recordings`` is the number of those that were compared.
    """
    counts = count_judgements(rows)
    parts = [
        _count(counts[ALIKE], "are alike", "is alike"),
        _count(counts[LITTLE], "differ a little", "differs a little"),
    ]
    if counts[DIFFERS]:
        part = _list(list_complaints(rows), "; ", "; and ")
        parts.append(f"{_count(counts[DIFFERS], 'differ', 'differs')} ({part})")
    if counts[UNKNOWN]:
        part = _count(counts[UNKNOWN], "are not known", "is not known")
        part += f": {_count(recordings, 'recordings are', 'recording is')} too few"
        unknown = [row.needed for row in rows if row.judgement == UNKNOWN]
        needed = sorted(number for number in unknown if math.isfinite(number))
        if needed:
            half, most = (rounded_count(needed[i]) for i in ((len(needed) - 1) // 2, -1))
            part += f"; about {half:,} would tell"
            part += f" half of them, about {most:,} all" if most > half else ""
        parts.append(part)
    return f"Of {_count(len(rows), 'questions', 'question')} {', '.join(filter(None, parts))}."


def detectable_changes(rows: Iterable[Row]) -> dict[str, float]:
    """Return the smallest changes that these recordings show, as parts of the recorded mean."""
    return {
        lower_first(row.label): row.detectable / abs(row.recorded)
        for row in rows
        if row.measure in NOTICED and row.recorded and math.isfinite(row.detectable)
    }


def compare_with_law(rows: Iterable[Row]) -> str:
    """Return in which questions the simulator is nearer to the recordings than a simple law."""
    known = [row for row in rows if math.isfinite(row.law + row.simulated)]
    if not known:
        return ""
    better = [row for row in known if abs(row.value) < abs(row.law - row.recorded)]
    worse = [lower_first(row.label) for row in known if row not in better]
    sentence = f"The simulator beats a simple law in {len(better)} of {len(known)} questions"
    return f"{sentence}; it does not in {_list(worse, ', ', ' and ')}." if worse else f"{sentence}."


def list_implausible(rows: Iterable[Row], worse_than_untrained: bool) -> list[str]:
    """Return what is off by more than half of what was recorded, and whether training harmed.

    Median speed, duration and the share of each ending, where they are not merely unknown, are
    looked at. One sentence each; none where nothing is.
    """
    sentences = []
    if worse_than_untrained:
        sentences.append(
            "An untrained network comes nearer to the recordings than the trained one: train "
            "longer, on more episodes, or with another learner, before anything is concluded."
        )
    by_measure = {row.measure: row for row in rows}
    for key in ("median_speed", "duration", *SHARES):
        if (row := by_measure.get(key)) is None:
            continue
        share = key in SHARES
        least = max(HALF * abs(row.recorded), LEAST_SHARE if share else 0.0)
        if not abs(row.simulated - row.recorded) > least:
            continue
        if share and row.judgement != DIFFERS:  # few are off by half by chance
            continue
        values = (
            f"{100 * row.simulated:.0f} % simulated, {100 * row.recorded:.0f} % recorded"
            if share
            else f"{row.simulated:.3g} {row.unit} simulated, {row.recorded:.3g} {row.unit} recorded"
        )
        sentences.append(f"{row.label} is off by more than half: {values}.")
    return sentences


def _count(count: int, many: str, one: str) -> str:
    """Return how many there are, in words; nothing of none."""
    return f"{count} {one if count == 1 else many}" if count else ""


def _list(names: Sequence[str], between: str, last: str) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - MOST_COMPLAINTS
    return between.join(names[:MOST_COMPLAINTS]) + (f"{last}{more} more" if more > 0 else "")
