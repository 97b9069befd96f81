"""Rollouts against recordings, statistically.

What looks at whole runs (``evaluate_runs``, ``compare_runs``) is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.comparison import Evaluation, evaluate
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.evaluation.verdict import Verdict, verdict

if TYPE_CHECKING:
    from animarl_algos.runs.evaluating import compare_runs, evaluate_runs

__all__ = [
    "Evaluation",
    "RandomPolicy",
    "Rollouts",
    "Verdict",
    "collect_rollouts",
    "compare_runs",
    "evaluate",
    "evaluate_runs",
    "measure",
    "measure_recordings",
    "teams_of",
    "verdict",
]

_OF_RUNS = {
    "compare_runs": "evaluating",
    "evaluate_runs": "evaluating",
}


def __getattr__(name: str) -> Any:
    if name not in _OF_RUNS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"animarl_algos.runs.{_OF_RUNS[name]}"), name)
