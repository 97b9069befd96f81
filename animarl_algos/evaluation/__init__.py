"""Rollouts against recordings, statistically."""

from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.tables import Evaluation, evaluate

__all__ = [
    "Evaluation", "RandomPolicy", "Rollouts", "collect_rollouts", "evaluate", "measure",
    "measure_recordings",
]  # fmt: skip
