"""Evaluation: rollouts against recordings, statistically, and a report to show."""

from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.evaluation import Evaluation, evaluate
from animarl_algos.evaluation.inputs import ReportInputs
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.report import write_report
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.terminal import evaluation_table

__all__ = [
    "Evaluation", "RandomPolicy", "ReportInputs", "Rollouts", "collect_rollouts", "evaluate",
    "evaluation_table", "measure", "measure_recordings", "write_report",
]  # fmt: skip
