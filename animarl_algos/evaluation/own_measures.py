"""Measures of the user's own: a function in a file, registered like any other metric.

``my_index.py:axis_index`` names a function of ``positions`` ``(frames, individuals, 2)``, ``dt``
[s] and ``roles``, with positions in the unit of the recordings from the centre of the arena. It
returns a number, or one for each animal, frame, or frame and animal; their mean stands for the
episode. The function may have attributes: ``unit`` (empty by default) and ``tolerance``, one of
:data:`~animarl_algos.evaluation.metrics.TOLERANCES` (``"spread"`` by default).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.evaluation.metrics import METRICS, OF_SPREAD, TOLERANCES, Metric, add_metric
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

OwnFunction = Callable[..., Any]


def register_measures(named: Iterable[str] | None, *, chooses: bool = False) -> list[Metric]:
    """Load functions named ``FILE.py:FUNCTION`` and register each as a metric.

    Their files are run. One that was registered before under the same name is replaced. With
    ``chooses`` the choice of acting judges rollouts by them, too. Raises InputError if a file or a
    function is not there, or the name is that of another metric.
    """
    metrics = []
    for name in named or ():
        metric = replace(own_metric(load_function(name), name), chooses=chooses)
        METRICS[:] = [one for one in METRICS if one.own is None or one.key != metric.key]
        add_metric(metric)
        metrics.append(metric)
    return metrics


def measure_source(name: str) -> str:
    """Return the text of the file that ``FILE.py:FUNCTION`` names."""
    return Path(name.rpartition(":")[0]).read_text("utf-8")


def load_function(name: str) -> OwnFunction:
    """Run a file and return the function of it that ``FILE.py:FUNCTION`` names."""
    file, _, function = name.rpartition(":")
    path = Path(file)
    if not file or not function or path.suffix != ".py":
        raise InputError(f"--measure {name}: give FILE.py:FUNCTION, such as my_index.py:axis_index")
    if not path.exists():
        raise InputError(f"--measure {name}: there is no file {path}: check its name")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None  # of every file that ends in .py
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(
            f"--measure {name}: {path} cannot be run ({type(error).__name__}: {error}): run it "
            "with Python first"
        ) from error
    attribute = getattr(module, function, None)
    if not callable(attribute):
        raise InputError(f"--measure {name}: {path} has no function {function}: check its name")
    loaded: OwnFunction = attribute
    return loaded


def own_metric(function: OwnFunction, name: str) -> Metric:
    """Return the metric of a function; ``name`` is how the user named it."""
    key = name.rpartition(":")[2]
    tolerance = getattr(function, "tolerance", OF_SPREAD)
    if tolerance not in TOLERANCES:
        raise InputError(
            f"--measure {name}: its tolerance is {tolerance!r}: choose one of "
            f"{', '.join(TOLERANCES)}"
        )
    label = key.replace("_", " ")
    label = label[:1].upper() + label[1:]
    return Metric(
        key=key,
        label=label,
        unit=str(getattr(function, "unit", "")),
        measure=lambda episodes: own_values(
            function, episodes.rollouts, episodes.prepared.unit.per_arena_unit, name
        ),
        own=lambda rollouts, scale: own_values(function, rollouts, scale, name),
        tolerance=tolerance,
        heading=label.lower(),
        caption=f"{label}, a measure of your own ({name}).",
    )


def own_values(function: OwnFunction, rollouts: Rollouts, scale: float, name: str) -> Floats:
    """Return the value of each episode, ``(rollouts,)``; NaN where the function gives none."""
    means = np.full(len(rollouts), np.nan)
    for i in range(len(rollouts)):
        try:
            values = np.asarray(
                function(scale * rollouts.path(i), rollouts.dt, rollouts.roles), dtype=np.float64
            )
        except Exception as error:
            raise InputError(
                f"--measure {name}: it fails on episode {i} of {len(rollouts)} "
                f"({type(error).__name__}: {error}): it must take positions (frames, individuals, "
                "2), dt and roles, and return numbers"
            ) from error
        known = values[np.isfinite(values)]
        means[i] = known.mean() if known.size else np.nan
    return means


def measured_recordings(metrics: Iterable[Metric], demos: Demonstrations) -> list[str]:
    """Return a line for each metric: its mean over recordings, and how much these differ."""
    lines = []
    names, unit = np.unique(demos.recording, return_inverse=True)
    prepared = Prepared(demos)
    for metric in metrics:
        values = metric.measure(prepared.episodes(prepared.recorded))
        each = [np.nanmean(values[unit == i]) for i in range(len(names))]
        spread = f", standard deviation {np.std(each, ddof=1):.3g}" if len(each) > 1 else ""
        mean = f"{np.mean(each):.3g} {metric.unit}".rstrip()
        lines.append(f"{metric.label}: mean {mean} over {len(names)} recordings{spread}")
    return lines
