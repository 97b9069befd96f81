"""The row ``auc`` of a verdict: whether a classifier distinguishes rollouts from recordings.

Its area is printed beside that of recordings among themselves, of the locomotion model's
closed-loop tracking, of the same with some actions at random, and of random actions. None of these
excuses it: the row is judged by its own interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.classifier import Telling, among_themselves, tell_apart
from animarl_algos.evaluation.motion import Measure
from animarl_algos.evaluation.null import Tested
from animarl_algos.evaluation.prepared import Prepared, factual
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_algos.evaluation.verdict_rows import BY_LITTLE, DIFFERS, SAME, UNKNOWN, row_of
from animarl_algos.evaluation.windows import WINDOW, Windows, resting_step, window_features
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.resolution import rounded
from animarl_envs.demos.units import RECORDED_SCALE
from animarl_envs.errors import InputError

Floats = NDArray[np.float64]

LITTLE_AUC = 0.60  # up to here it differs by little: two normal curves 0.36 sd apart
FEWEST_DEMOS = 5  # with fewer, parts of them are dealt to the classifier's folds
PART = 15  # windows of such a part
AUC = "auc"


class Tracked(Protocol):
    """Closed-loop tracking of the evaluated demonstrations, frame for frame."""

    @property
    def positions(self) -> Floats:
        """``(frames, individuals, 2)``, arena frame [arena unit]."""
        ...


def followed(demos: Demonstrations, tracking: Tracked) -> Rollouts:
    """The demonstrations as tracking follows them, on the grid on which positions were stored.

    Raises
    ------
    InputError
        If the tracking is of other demonstrations.
    """
    if tracking.positions.shape != demos.positions.shape:
        raise InputError(
            f"the tracking has shape {tracking.positions.shape} and the demonstrations "
            f"{demos.positions.shape}: track the evaluated ones"
        )
    stored = rounded(tracking.positions, demos.resolution())
    return replace(Rollouts.from_demonstrations(demos), positions=stored)


@dataclass(frozen=True, eq=False)
class Classified:
    """What the classifier makes of the rollouts and of what they are read beside."""

    simulated: Telling
    among: Interval
    floor: Interval
    perturbed: Interval
    ceiling: Interval
    block: int | None

    @classmethod
    def of(
        cls,
        prepared: Prepared,
        counted: Rollouts,
        floor: Tracked | None,
        perturbed: Tracked | None,
        baselines: Mapping[str, Rollouts],
        references: Demonstrations | None,
        streams: list[np.random.Generator],
    ) -> Classified:
        demos = prepared.demos
        block = PART if len(np.unique(counted.demo)) < FEWEST_DEMOS else None

        still = resting_step(prepared.recorded)

        def windows(rollouts: Rollouts, of: Demonstrations = demos) -> Windows:
            made = window_features(rollouts, demos.arena, block=block, still=still)
            return made.by_recording(of) if block is None else made

        own = windows(prepared.recorded)
        rng, null_rng = streams
        simulated = tell_apart(own, windows(counted), rng, importance=True)
        ceiling = tracked = shaken = UNDEFINED
        if (random := baselines.get("random")) is not None:
            drawn = prepared.filtered(factual(random, demos))
            ceiling = tell_apart(own, windows(drawn), rng, deals=1).auc
        if floor is not None:
            tracked = tell_apart(own, windows(prepared.filtered(followed(demos, floor))), rng).auc
        if perturbed is not None:
            other = windows(prepared.filtered(followed(demos, perturbed)))
            shaken = tell_apart(own, other, rng, deals=1).auc
        if references is None:
            among = among_themselves(own, null_rng)
        else:
            others = windows(
                prepared.filtered(Rollouts.from_demonstrations(references)), references
            )
            apart = replace(others, group=others.group + own.group.max() + 1)
            among = tell_apart(own, apart, null_rng, deals=1).auc
        return cls(simulated, among, tracked, shaken, ceiling, block)


def auc_row(found: Classified) -> dict[str, Any]:
    """Return the classifier's row. What tracking comes to is printed beside it, not subtracted."""
    auc, among = found.simulated.auc, found.among
    measure = Measure(
        AUC, f"Distinguished by a classifier on {WINDOW:g} s (AUC)", "", "", "", ""
    )  # fmt: skip
    low, high = auc.low - among.estimate, auc.high - among.estimate
    gap = Interval(auc.estimate - among.estimate, low, high)
    tested = Tested(abs(auc.estimate - 0.5), abs(among.high - 0.5), math.nan)
    row = row_of(measure, RECORDED_SCALE, among.estimate, auc.estimate, gap, tested)
    if not math.isfinite(auc.estimate):
        return row | {"judgement": UNKNOWN, "verdict": auc.reason or UNKNOWN}
    if auc.low <= 0.5:
        return row | {"judgement": SAME, "verdict": SAME}
    by = max(found.simulated.importance.items(), key=lambda item: item[1])[0]
    if auc.estimate <= LITTLE_AUC:
        words = f"{BY_LITTLE}: AUC {auc.estimate:.2f}, most of all by {by}"
        return row | {"judgement": BY_LITTLE, "verdict": words}
    return row | {"judgement": DIFFERS, "verdict": f"distinguished, most of all by {by}"}
