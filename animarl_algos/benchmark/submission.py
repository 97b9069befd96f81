"""Submissions: somebody's rollouts, checked and scored without running their code.

A submission is a file of rollouts as every run holds them (``runs/mine/rollouts/*.npz``), or as
:meth:`~animarl_algos.evaluation.rollouts.Rollouts.save` writes them: positions in the arena frame
[arena unit] from the start of a packaged test episode on, which ``demo`` counts. The outcome is
checked against the last positions, the steps between them against how fast the species is, and all
of them against the recording.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_algos.benchmark.scores import Score, score
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_envs.checks import printable
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError
from animarl_envs.locomotion import residual
from animarl_envs.species import get_species

SLACK = 0.02  # of the contact radius, for rounded positions
PUSHES = 4.0  # times the thrust: a fit of many magnitudes has more than twice the one of a single


def score_submission(path: str | Path, species: str, *, resamples: int = RESAMPLES) -> Score:
    """Check a submission and measure it against the packaged test split of ``species``.

    InputError names the rollout that is not from a test start, or could not have been made.
    """
    rollouts, demos = read_submission(Path(path), species)
    return replace(score(rollouts, demos, resamples=resamples), data=species, kind="method")


def read_submission(path: Path, species: str) -> tuple[Rollouts, Demonstrations]:
    """The rollouts of a file, and the packaged demonstrations, all splits, that they are of.

    Only rollouts in the recorded condition, told no other one, count.
    """
    if species not in packaged_names():
        raise InputError(
            f"--species {printable(species)}: choose among {', '.join(packaged_names())}"
        )
    made, demos = Rollouts.load(path), load_packaged(species)
    test = demos.select(split="test")
    for key in ("individuals", "roles", "dt"):
        if getattr(made, key) != getattr(test, key):
            raise InputError(
                f"{path}: its {key} ({getattr(made, key)}) are not those of {species} "
                f"({getattr(test, key)}): name the species that was rolled out"
            )
    if made.demo.min() < 0 or made.demo.max() >= len(test):
        wrong = int(np.flatnonzero((made.demo < 0) | (made.demo >= len(test)))[0])
        raise InputError(
            f"{path}: rollout {wrong}: demo is {made.demo[wrong]}: there are 0 to {len(test) - 1}"
        )
    made = made.factual(test)
    if len(set(zip(made.demo.tolist(), made.seed.tolist(), made.repetition.tolist()))) < len(made):
        raise InputError(
            f"{path}: two rollouts have the same demo, seed and repetition: count repetitions up"
        )
    if missing := set(range(len(test))) - set(made.demo.tolist()):
        raise InputError(f"{path}: no rollout is from test episode {min(missing)}: leave none out")
    fastest = float(np.linalg.norm(demos.velocities(), axis=2).max()) * demos.dt
    widest = float(np.abs(demos.positions).max())
    for i, demo in enumerate(made.demo.tolist()):
        place, positions = f"{path}: rollout {i}", made.path(i)
        _check_start(positions, demo, place, test)
        _check_moves(positions, place, test, fastest, widest)
        _check_made(positions, demo, place, test)
        _check_outcome(int(made.outcome[i]), positions, place, test)
    return replace(made, method=printable(made.method)), demos


def _check_start(path: NDArray[np.float64], demo: int, place: str, test: Demonstrations) -> None:
    """As many frames as an episode may have, from where the recording began."""
    species = get_species(test.species)
    if not 2 <= len(path) <= species.time_limit + 1:
        raise InputError(
            f"{place}: it has {len(path)} frames, and an episode 2 to {species.time_limit + 1}: "
            "give every frame"
        )
    start = test.positions[test.offsets[demo]]
    if np.abs(path[0] - start).max() > SLACK * species.contact_radius:
        raise InputError(f"{place}: it does not begin where test episode {demo} began")


def _check_moves(
    path: NDArray[np.float64], place: str, test: Demonstrations, fastest: float, widest: float
) -> None:
    """Nobody is where, or takes a step that, no animal and no locomotion of theirs could.

    ``fastest`` and ``widest`` are the longest recorded step and the largest coordinate.
    """
    species = get_species(test.species)
    damping = np.array([own.damping for own in species.locomotion])
    push = PUSHES * np.array([own.thrust for own in species.locomotion]) * species.dt**2
    step = max(fastest, float((push / damping).max()))
    boundary = species.arena.boundary
    most = max(widest, boundary) + step  # who is out has ended the episode
    if not np.isfinite(boundary):
        most = widest + species.time_limit * step
    if (far := float(np.abs(path).max())) > most:
        raise InputError(
            f"{place}: a coordinate is {far:.3g} in size, and {most:.3g} is the most: "
            "give positions in the arena frame, in arena units"
        )
    steps = np.linalg.norm(np.diff(path, axis=0), axis=2)
    before = np.concatenate([np.full_like(steps[:1], fastest), np.maximum(steps[:-1], fastest)])
    added = [
        residual(steps[:, k], before[:, k], own.damping) for k, own in enumerate(species.locomotion)
    ]
    beyond = np.minimum(np.stack(added, axis=1) - push, steps - fastest)
    if (beyond > 0).any():
        frame, who = np.argwhere(beyond > 0)[0].tolist()
        could = steps[frame, who] - beyond[frame, who]
        raise InputError(
            f"{place}: {test.individuals[who]} moves {steps[frame, who]:.3g} from frame {frame} to "
            f"{frame + 1}, where {could:.3g} is the most that it could: give every "
            "frame as it was simulated"
        )


def _check_outcome(
    outcome: int, path: NDArray[np.float64], place: str, test: Demonstrations
) -> None:
    """Reached if and only if the target, or the source at the origin, was in reach at the end.

    Else somebody is out, or the time limit has passed.
    """
    species = get_species(test.species)
    radius = species.contact_radius
    if "target" in test.roles:
        target = test.roles.index("target")
        goal, movers = path[-1, target], np.delete(path[-1], target, axis=0)
    elif test.has_goal:
        goal, movers = np.zeros(2), path[-1]
    else:
        goal, movers = np.full(2, np.inf), path[-1]  # nobody can be reached
    if outcome not in (TIME_OUT, TARGET_OUT, PURSUER_OUT) and not 1 <= outcome <= len(movers):
        raise InputError(f"{place}: outcome {outcome} is none: see its codes")
    distance = np.linalg.norm(movers - goal, axis=1).min()
    if outcome > 0 and distance > radius * (1 + SLACK):
        raise InputError(
            f"{place}: it claims that the goal was reached, which is {distance:.3g} away at the end"
        )
    if outcome == TIME_OUT and distance < radius * (1 - SLACK):
        raise InputError(
            f"{place}: it ends in reach of the goal and claims that it was not reached"
        )
    if outcome == TIME_OUT and len(path) <= species.time_limit:
        raise InputError(
            f"{place}: it claims that time ran out, with {len(path)} of {species.time_limit + 1} "
            "frames: roll out until the episode ends"
        )
    if outcome in (TARGET_OUT, PURSUER_OUT):
        is_target = np.array([role == "target" for role in test.roles])
        left = path[-1, is_target == (outcome == TARGET_OUT)]
        beyond = replace(species.arena, rebound=False)
        if beyond.contains(left, -SLACK * radius).all():
            raise InputError(
                f"{place}: it claims that somebody left the arena, and all of them are within it "
                "at the end: give the outcome with which the episode ended"
            )


def _check_made(path: NDArray[np.float64], demo: int, place: str, test: Demonstrations) -> None:
    """Not what was recorded, wherever warm-up and a second more leave enough to tell."""
    species = get_species(test.species)
    recorded = test.positions[test.offsets[demo] : test.offsets[demo + 1]]
    common = min(len(path), len(recorded))
    if common <= species.warmup + 1 + max(1, round(1 / species.dt)):
        return
    if np.abs(path[:common] - recorded[:common]).max() <= SLACK * species.contact_radius:
        raise InputError(
            f"{place}: it is the recording of test episode {demo} itself, frame by frame: "
            "give what the method did from its start"
        )
