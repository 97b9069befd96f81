"""The rows of two judges that are asked which of two is recorded, and what they are read beside.

Boosted trees (:mod:`animarl_algos.evaluation.classifier`) look at two seconds of motion, and at
order in time over up to a quarter of an episode (:mod:`animarl_algos.evaluation.windows`).
Their areas are printed beside those of recordings among themselves, of the locomotion model's
closed-loop tracking (perfect control in this locomotion) and of random actions. None of these
excuses a row: it is judged by its own interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from animarl_algos.evaluation.classifier import Telling, among_themselves, tell_apart
from animarl_algos.evaluation.prepared import Prepared, factual
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Floats, Interval, Ints
from animarl_algos.evaluation.verdict_rows import BY_LITTLE, DIFFERS, UNKNOWN, Row
from animarl_algos.evaluation.windows import (
    WINDOW,
    Windows,
    sequence_windows,
    window_features,
    window_steps,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.resolution import rounded
from animarl_envs.errors import InputError

LITTLE_AUC = 0.60  # up to here it differs by little: two normal curves 0.36 sd apart
STRICTER = 2.33 / 1.96  # a row that differs by chance alone does so in 1 % of cases
FEWEST_DEMOS = 5  # with fewer, parts of them are dealt to the classifier's folds
PART = 15  # windows of such a part
AUC, SEQUENCE = "auc", "auc_sequence"


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
class Judge:
    """What one judge makes of the rollouts, and of what they are read beside.

    ``areas`` are those under the curve, by name: of recordings ``among`` themselves, of closed-loop
    tracking (``floor``), of such tracking with some actions at random (``perturbed``), and of
    random actions (``ceiling``).
    """

    key: str
    label: str
    simulated: Telling
    areas: Mapping[str, Interval] = field(default_factory=dict)

    def row(self) -> Row:
        """Return its row: what tracking comes to is printed beside it, not subtracted."""
        auc, among = self.simulated.auc, self.areas.get("among", UNDEFINED)
        row = Row(
            measure=self.key,
            label=self.label,
            recorded=among.estimate,
            simulated=auc.estimate,
            difference=auc.estimate - 0.5,
            difference_low=auc.low - 0.5,
            difference_high=auc.high - 0.5,
            distance=abs(auc.estimate - 0.5),
            null=abs(among.high - 0.5),
        )
        if not math.isfinite(auc.estimate):
            words = f"{UNKNOWN}: {auc.reason}" if auc.reason else UNKNOWN
            return replace(row, judgement=UNKNOWN, verdict=words, reason=auc.reason)
        if auc.estimate - STRICTER * (auc.estimate - auc.low) <= 0.5:
            return row
        by = max(self.simulated.importance.items(), key=lambda item: item[1])[0]
        if auc.estimate <= LITTLE_AUC:
            words = f"{BY_LITTLE}: AUC {auc.estimate:.2f}, most of all by {by}"
            return replace(row, judgement=BY_LITTLE, verdict=words)
        words = f"distinguished, most of all by {by}"
        return replace(row, judgement=DIFFERS, verdict=words)


def judge_windows(
    prepared: Prepared,
    counted: Rollouts,
    sides: Mapping[str, Rollouts],
    references: Demonstrations | None,
    streams: list[np.random.Generator],
) -> tuple[Judge, bool]:
    """Ask about two seconds of motion; also whether parts of demonstrations were dealt.

    ``sides`` is what the rollouts are read beside, smoothed as the recordings; ``references`` are
    other recordings, by default halves of the evaluated ones are compared.
    """
    demos = prepared.demos
    block = PART if len(np.unique(counted.demo)) < FEWEST_DEMOS else None

    def windows(rollouts: Rollouts, of: Demonstrations = demos) -> Windows:
        made = window_features(rollouts, demos.arena, block=block, still=prepared.rest)
        return made.by_recording(of) if block is None else made

    label = f"Distinguished by a classifier on {WINDOW:g} s (AUC)"
    judge, own = _judge(AUC, label, windows, prepared, counted, sides, streams[0])
    if references is None:
        among = among_themselves(own, streams[1])
    else:
        others = windows(prepared.filtered(Rollouts.from_demonstrations(references)), references)
        apart = replace(others, group=others.group + own.group.max() + 1)
        among = tell_apart(own, apart, streams[1], deals=1).auc
    return replace(judge, areas={"among": among, **judge.areas}), block is not None


def judge_sequences(
    prepared: Prepared,
    counted: Rollouts,
    sides: Mapping[str, Rollouts],
    group: Ints,
    rng: np.random.Generator,
) -> Judge:
    """Ask about order in time; ``group`` ``(starts,)`` is the recording of each start."""
    steps = window_steps(prepared.recorded)

    def windows(rollouts: Rollouts) -> Windows:
        return sequence_windows(rollouts, prepared.demos.arena, prepared.rest, steps, group)

    label = f"Distinguished by order in time over {steps * prepared.recorded.dt:.3g} s (AUC)"
    sides = {name: one for name, one in sides.items() if name != "perturbed"}  # it takes time
    judge, own = _judge(SEQUENCE, label, windows, prepared, counted, sides, rng)
    return replace(judge, areas={"among": among_themselves(own, rng, halves=1), **judge.areas})


def _judge(
    key: str,
    label: str,
    windows: Callable[[Rollouts], Windows],
    prepared: Prepared,
    counted: Rollouts,
    sides: Mapping[str, Rollouts],
    rng: np.random.Generator,
) -> tuple[Judge, Windows]:
    own = windows(prepared.recorded)
    simulated = tell_apart(own, windows(counted), rng, importance=True)
    areas = {name: tell_apart(own, windows(one), rng, deals=1).auc for name, one in sides.items()}
    return Judge(key, label, simulated, areas), own


def read_beside(
    prepared: Prepared,
    floor: Tracked | None,
    perturbed: Tracked | None,
    baselines: Mapping[str, Rollouts],
) -> dict[str, Rollouts]:
    """Return what rollouts are read beside, smoothed as the recordings."""
    demos, sides = prepared.demos, {}
    if (random := baselines.get("random")) is not None:
        sides["ceiling"] = factual(random, demos)
    for name, tracking in (("floor", floor), ("perturbed", perturbed)):
        if tracking is not None:
            sides[name] = followed(demos, tracking)
    return {name: prepared.filtered(one) for name, one in sides.items()}
