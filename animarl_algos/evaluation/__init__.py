"""Rollouts against recordings, statistically."""

from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.tables import Evaluation, evaluate
from animarl_algos.evaluation.verdict import Verdict, verdict

__all__ = [
    "Evaluation", "RandomPolicy", "Rollouts", "Verdict", "collect_rollouts", "evaluate",
    "measure", "measure_recordings", "verdict",
]  # fmt: skip
