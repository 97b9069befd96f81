"""Whether a simulator can be believed at all: gaps so large that the rest of a page is idle."""

from __future__ import annotations

import math

from animarl_algos.evaluation.verdict import WORSE, Verdict
from animarl_algos.evaluation.verdict_rows import SAME

HALF = 0.5  # of the recorded value: a larger gap is implausible
LEAST_SHARE = 0.1  # of episodes, that a gap of shares has at least
LENGTHS = ("median_speed", "duration")
OUTCOMES = ("reached", "target_out", "pursuer_out")


def implausible(verdict: Verdict) -> list[str]:
    """What is off by more than half of what was recorded, and whether training made it worse.

    Median speed, duration and the share of each ending, where chance does not explain it, are
    looked at. One sentence each; none where nothing is.
    """
    found = []
    if WORSE in verdict.words:
        found.append(
            "An untrained network comes nearer to the recordings than the trained one: train "
            "longer, on more episodes, or with another learner, before anything is concluded."
        )
    known = set(verdict.table["measure"])
    for key in (*LENGTHS, *OUTCOMES):
        if key not in known:
            continue
        row = verdict.row(key)
        recorded, simulated = float(row["recorded"]), float(row["simulated"])
        share = key in OUTCOMES
        least = max(HALF * abs(recorded), LEAST_SHARE if share else 0.0)
        if not math.isfinite(recorded + simulated) or abs(simulated - recorded) <= least:
            continue
        if share and row["judgement"] == SAME:  # shares of few episodes are off by half by chance
            continue
        values = (
            f"{100 * simulated:.0f} % simulated, {100 * recorded:.0f} % recorded"
            if share
            else f"{simulated:.3g} {row['unit']} simulated, {recorded:.3g} {row['unit']} recorded"
        )
        found.append(f"{row['label']} is off by more than half: {values}.")
    return found
