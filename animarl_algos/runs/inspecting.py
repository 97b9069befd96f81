"""One test demonstration of a run, looked at closely: rollouts from its start, values along it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from animarl_algos.evaluation.comparison import write_tables
from animarl_algos.evaluation.metrics import measure
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats, Ints
from animarl_algos.report import style
from animarl_algos.report.figures import path_panels
from animarl_algos.report.inputs import PageInputs, provenance
from animarl_algos.report.page import Gallery, Page, Section, Text
from animarl_algos.report.style import method_label, to_image
from animarl_algos.runs.evaluating import command, refuse_run_folder
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_set import RunSet
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import first_pursuer
from animarl_envs.locomotion import NUM_DIRECTIONS
from animarl_envs.species import Species
from animarl_envs.worlds import demonstration_observations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DIRECTIONS = {0: "towards focus", 3: "right", 6: "away", 9: "left"}
DIVERGING = "RdBu_r"


@dataclass(frozen=True, eq=False, kw_only=True)
class Inspected(PageInputs):
    """One episode: the recording, the rollouts from its start by method, what was valued.

    ``metrics`` has a row per episode.
    """

    species: Species
    learner: str
    episode: int
    recording: Rollouts
    rollouts: Mapping[str, Rollouts]
    decisions: Decisions
    metrics: pd.DataFrame

    @cached_property
    def steps(self) -> pd.DataFrame:
        """A row per frame, individual and episode: place [arena unit], speed [arena unit / s].

        ``speed`` is that of the step which led to the frame; the first frame has none.
        """
        parts = []
        for some in ({self.recording.method: self.recording} | dict(self.rollouts)).values():
            for i in range(len(some)):
                path = some.path(i)
                speed = np.full(path.shape[:2], np.nan)
                speed[1:] = np.linalg.norm(np.diff(path, axis=0), axis=-1) / some.dt
                frames, num = path.shape[:2]
                step = np.repeat(np.arange(frames), num)
                columns = {
                    "method": some.method,
                    "demo": some.demo[i],
                    "repetition": some.repetition[i],
                    "cue": some.cue[i],
                    "step": step,
                    "time": step * some.dt,
                    "individual": np.tile(np.array(some.individuals), frames),
                    "x": path[..., 0].ravel(),
                    "y": path[..., 1].ravel(),
                    "speed": speed.ravel(),
                    "reason": np.where(step == 0, "no step leads to the first frame", ""),
                }
                parts.append(pd.DataFrame(columns))
        return pd.concat(parts, ignore_index=True)

    @cached_property
    def values(self) -> pd.DataFrame:
        """A row per step and action: its value, its advantage, whether it was the recorded."""
        q, (steps, actions) = self.decisions.q, self.decisions.q.shape
        step, action = (each.ravel() for each in np.indices((steps, actions)))
        columns = {
            "individual": self.decisions.individual,
            "demo": self.decisions.demo,
            "step": step,
            "time": step * self.demos.dt,
            "action": action,
            "q": q.ravel(),
            "advantage": (q - q.mean(axis=1, keepdims=True)).ravel(),
            "demonstrated": action == np.repeat(self.decisions.actions, actions),
        }
        return pd.DataFrame(columns)


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
    run = Run(Path(folder))
    stored = run.rollouts()
    test = run.demos.select(split="test")
    if not 0 <= episode < test.num_episodes:
        raise InputError(
            f"{run.path}: there is no test episode {episode}: choose one of 0 to "
            f"{test.num_episodes - 1}"
        )
    rollouts = {name: some.select(some.demo == episode) for name, some in stored.items()}
    recording = Rollouts.from_demonstrations(test).select(np.array([episode]))
    model, runs = run.policy, RunSet.of(run)
    decisions = decide_along(
        model.policy,
        run.species,
        test,
        episode,
        condition_flag=model.layout.condition_flag,
        focal=run.settings.focal,
    )
    measured = [measure(one, test) for one in ({recording.method: recording} | rollouts).values()]
    return Inspected(
        learner=method_name(run.settings.algo),
        episode=episode,
        demos=test,
        recording=recording,
        rollouts=rollouts,
        decisions=decisions,
        metrics=pd.concat(measured, ignore_index=True),
        command=command("inspect", [folder], "--episode", str(episode)),
        **runs.page_inputs(),
    )


def inspect_run(folder: str | Path, episode: int, out: str | Path) -> Inspected:
    """What :func:`inspect_episode` finds, written to ``out``: all of it or nothing.

    ``out`` gets ``steps``, ``values`` and ``metrics`` as CSV and Parquet, ``figures/`` as SVG, PNG
    and PDF, and ``report.html``. The same run gives the same bytes.
    """
    refuse_run_folder(out)
    found = inspect_episode(folder, episode)
    tables = {"steps": found.steps, "values": found.values, "metrics": found.metrics}
    with all_files_or_none(out) as part:
        write_tables(tables, part)
        episode_page(found).write(part)
    return found


def episode_page(found: Inspected) -> Page:
    """Return the page: paths from the start, and what was valued along the recorded one."""
    path, decisions, learner = found.recording.path(0), found.decisions, method_label(found.learner)
    paths = [(found.recorded, path)]
    paths += [(method_label(name), some.path(0)) for name, some in found.rollouts.items()]
    known = decisions.actions >= 0
    first = int((decisions.q.argmax(axis=1) == decisions.actions)[known].sum())
    images = (
        to_image(path_panels(paths, path, found.stage), "Paths from the start of the episode"),
        to_image(values_along_path(decisions, found.demos.dt), "Action values along the recording"),
    )
    captions = (
        "The demonstration and the first rollout of each method from its start; 'animarl watch "
        "--beside' plays them, and the table 'metrics' has a row for each.",
        f"What {learner} values for {decisions.individual} while everybody moves as "
        f"{found.recorded}. Above, the mean of Q over actions and the best action's; below, the "
        "advantage of each direction of acceleration, angles taken from the direction to its "
        "focus; dots: the actions found in the demonstration.",
    )
    return Page(
        title=f"{found.species.title}: test episode {found.episode}",
        kind="One episode",
        synthetic=found.demos.synthetic,
        facts=[("Episode", str(found.demos.recording[found.episode])), ("Method", learner)],
        sections=[
            Section("episodes", "Paths", [Gallery(images[:1], captions[0])]),
            Section(
                "decisions",
                "Decisions along the demonstration",
                [
                    Text(
                        f"The action of highest value of {decisions.individual} is the "
                        f"{found.recorded} one in {first} of {int(known.sum())} steps."
                    ),
                    Gallery(images[1:], captions[1]),
                ],
            ),
            Section("provenance", "How this was made", list(provenance(found, "page"))),
        ],
    )


@dataclass(frozen=True, eq=False)
class Decisions:
    """Action values of one ``individual`` in the demonstration ``demo`` of the evaluated set.

    ``q`` ``(steps, actions)`` are those before each recorded step, ``actions`` ``(steps,)`` what
    inverse dynamics finds in it.
    """

    individual: str
    demo: int
    q: Floats
    actions: Ints


def decide_along(
    policy: Any,
    species: Species,
    demos: Demonstrations,
    demo: int,
    *,
    condition_flag: bool = False,
    focal: str | None = None,
) -> Decisions:
    """What ``policy`` values in one demonstration, where all move as recorded.

    Parameters
    ----------
    policy
        Of all individuals, in the order of ``demos``, or of ``focal`` alone; its ``advance`` gives
        Q-values ``(slots, actions)`` and the next memory.
    species
        As the policy was trained in; its locomotion tells the recorded actions.
    condition_flag
        Whether the condition is the last component of an observation.
    focal
        The individual that learned, whose values are told. If all did: those of the first that
        moves towards the target or source.
    """
    one = demos.select(episodes=[demo])
    steps = int(one.lengths[0]) - 1
    who = first_pursuer(one.roles) if focal is None else one.individuals.index(focal)
    slots = np.arange(len(one.roles)) if focal is None else np.array([who])
    observations: NDArray[np.float32] = demonstration_observations(species, one)[:, slots]
    if condition_flag:
        column = np.full((*observations.shape[:2], 1), one.condition[0], dtype=np.float32)
        observations = np.concatenate([observations, column], axis=2)
    actions = demonstrated_actions(one, species.locomotion).astype(np.int64)
    values = np.empty((steps, species.num_actions))
    state: Any = None
    for t in range(steps):
        q_values, hidden, _ = policy.advance(observations[t], state, np.zeros(len(slots), bool))
        values[t] = q_values[slots.tolist().index(who)]
        state = (hidden, np.maximum(actions[t, slots], 0))
    return Decisions(one.individuals[who], demo, values, actions[:steps, who])


def action_labels(num_actions: int) -> dict[int, str]:
    """Return names of actions for an axis: four directions of each thrust magnitude, and coasting.

    With several magnitudes, the number in front counts them from the largest.
    """
    thrusts = (num_actions - 1) // NUM_DIRECTIONS
    labels = {
        NUM_DIRECTIONS * m + k: name if thrusts == 1 else f"{m + 1}: {name}"
        for m in range(thrusts)
        for k, name in DIRECTIONS.items()
    }
    return labels | {num_actions - 1: "coast"}


def values_along_path(decisions: Decisions, dt: float) -> Figure:
    """Draw the state value and the advantage of each action along a demonstration.

    Dots are the actions that were found in it; ``dt`` is one decision step [s].
    """
    q, known = decisions.q, decisions.actions >= 0
    time = np.arange(len(q)) * dt
    with style.figure_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.6, 3.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1, 2.2])
        above.plot(time, q.mean(axis=1), color=style.TARGET.hex, label="mean over actions")
        above.plot(time, q.max(axis=1), color=style.BLUE.hex, linewidth=1.0, label="best action")
        above.set(ylabel="Q", title=decisions.individual)
        above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)  # above the curves
        advantage = (q - q.mean(axis=1, keepdims=True)).T
        reach = float(np.abs(advantage).max()) or 1.0
        edges = np.append(time, time[-1] + dt) - dt / 2
        mesh = below.pcolormesh(
            edges, np.arange(q.shape[1] + 1) - 0.5, advantage, cmap=DIVERGING, vmin=-reach,
            vmax=reach, rasterized=True,
        )  # fmt: skip
        below.plot(
            time[known], decisions.actions[known], ".", color=style.TARGET.hex, markersize=3.5,
            markeredgewidth=0,
        )  # fmt: skip
        labels = action_labels(q.shape[1])
        below.set_yticks(list(labels), list(labels.values()))
        below.invert_yaxis()
        below.set(xlabel="Time (s)", ylabel="Acceleration")
        figure.colorbar(mesh, ax=below, label="Advantage", pad=0.01)
    return figure
