"""One test demonstration of a run, looked at closely: rollouts from its start, values along it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from animarl_algos.evaluation.decisions import Decisions, decide_along
from animarl_algos.evaluation.metrics import measure
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.tidy import write_tables
from animarl_algos.report.inputs import InspectionInputs
from animarl_algos.report.inspection_page import inspection_page
from animarl_algos.runs.evaluating import command, refuse_run_folder
from animarl_algos.runs.machine import wall_times
from animarl_algos.runs.rolling_out import stored_rollouts
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_world import world_in_words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none


@dataclass(frozen=True, eq=False)
class Inspected:
    """One episode: the recording, the rollouts from its start by method, what was valued.

    ``steps`` has a row per frame, individual and episode; ``values`` one per step and action;
    ``metrics`` one per episode.
    """

    recording: Rollouts
    rollouts: dict[str, Rollouts]
    decisions: Decisions
    steps: pd.DataFrame
    values: pd.DataFrame
    metrics: pd.DataFrame


def inspect_episode(folder: str | Path, episode: int) -> Inspected:
    """Gather what a run holds of one demonstration of its test split.

    Parameters
    ----------
    episode
        Its number in the test split, from 0; that of the column ``demo`` in all tables.

    Raises
    ------
    InputError
        If the folder is no run, is not trained or has no rollouts, or there is no such episode.
    """
    return _inspect(Run(Path(folder)), episode)


def _inspect(run: Run, episode: int) -> Inspected:
    stored = stored_rollouts(run)
    demos = run.demos
    test = demos.select(split="test")
    if not 0 <= episode < test.num_episodes:
        raise InputError(
            f"{run.path}: there is no test episode {episode}: choose one of 0 to "
            f"{test.num_episodes - 1}"
        )
    rollouts = {name: some.select(some.demo == episode) for name, some in stored.items()}
    recording = Rollouts.from_demonstrations(test).select(np.array([episode]))
    model = run.policy
    decisions = decide_along(
        model.policy,
        run.species,
        test,
        condition_flag=model.layout.condition_flag,
        focal=run.settings.focal,
        demo=episode,
    )
    everything = {recording.method: recording, **rollouts}
    return Inspected(
        recording=recording,
        rollouts=rollouts,
        decisions=decisions,
        steps=pd.concat([step_table(r) for r in everything.values()], ignore_index=True),
        values=value_table(decisions, test.dt),
        metrics=pd.concat([measure(r, test) for r in everything.values()], ignore_index=True),
    )


def inspect_run(folder: str | Path, episode: int, out: str | Path) -> Inspected:
    """What :func:`inspect_episode` finds, written to ``out``: all of it or nothing.

    ``out`` gets ``steps``, ``values`` and ``metrics`` as CSV and Parquet, ``figures/`` as SVG, PNG
    and PDF, and ``report.html``. The same run gives the same bytes.
    """
    refuse_run_folder(out)
    run = Run(Path(folder))
    found = _inspect(run, episode)
    test: Demonstrations = run.demos.select(split="test")
    species = run.species
    inputs = InspectionInputs(
        learner=method_name(run.settings.algo),
        episode=episode,
        demos=test,
        species=species,
        recording=found.recording,
        rollouts=found.rollouts,
        decisions=found.decisions,
        metrics=found.metrics,
        world=world_in_words(species),
        environment=run.environment_options,
        machine=run.record["machine"],
        wall_time=wall_times(run.path),
        versions=run.record["versions"],
        command=command("inspect", [folder], "--episode", str(episode)),
    )
    page = inspection_page(inputs)
    tables = {"steps": found.steps, "values": found.values, "metrics": found.metrics}
    with all_files_or_none(out) as part:
        write_tables(tables, part)
        page.write(part)
    return found


def step_table(rollouts: Rollouts) -> pd.DataFrame:
    """One row per frame and individual: where it is [arena unit] and how fast [arena unit / s].

    ``speed`` is that of the step which led to the frame; the first frame has none.
    """
    parts = []
    for i in range(len(rollouts)):
        path = rollouts.path(i)
        speed = np.full(path.shape[:2], np.nan)
        speed[1:] = np.linalg.norm(np.diff(path, axis=0), axis=-1) / rollouts.dt
        frames, num = path.shape[:2]
        step = np.repeat(np.arange(frames), num)
        first = step == 0
        parts.append(
            pd.DataFrame(
                {
                    "method": rollouts.method,
                    "demo": rollouts.demo[i],
                    "repetition": rollouts.repetition[i],
                    "cue": rollouts.cue[i],
                    "step": step,
                    "time": step * rollouts.dt,
                    "individual": np.tile(np.array(rollouts.individuals), frames),
                    "x": path[..., 0].ravel(),
                    "y": path[..., 1].ravel(),
                    "speed": speed.ravel(),
                    "reason": np.where(first, "no step leads to the first frame", ""),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def value_table(decisions: Decisions, dt: float) -> pd.DataFrame:
    """One row per step and action: its value, its advantage, and whether it was the recorded."""
    steps, actions = decisions.q.shape
    advantage = decisions.q - decisions.q.mean(axis=1, keepdims=True)
    step = np.repeat(np.arange(steps), actions)
    action = np.tile(np.arange(actions), steps)
    return pd.DataFrame(
        {
            "individual": decisions.individual,
            "demo": decisions.demo,
            "step": step,
            "time": step * dt,
            "action": action,
            "q": decisions.q.ravel(),
            "advantage": advantage.ravel(),
            "demonstrated": action == np.repeat(decisions.actions, actions),
        }
    )
