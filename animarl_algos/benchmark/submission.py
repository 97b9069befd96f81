"""Submissions: somebody's rollouts as one JSON, checked and scored without running their code.

    {"format": "animarl-submission", "version": 1, "method": "mine", "species": "agent",
     "fingerprint": "...", "episodes": 100,
     "rollouts": [{"demo": 0, "seed": 0, "repetition": 0, "outcome": 1,
                   "positions": [[[x, y], ... one per individual], ... one per frame]}, ...]}

``demo`` counts the packaged test episodes, whose fingerprint it gives. Positions are in the arena
frame [arena unit], from the recorded start on; the outcome is checked against the last of them, the
steps between them against how fast the species is, and all of them against the recording.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.benchmark.pieces import write_json
from animarl_algos.benchmark.scores import Score, score
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_envs.checks import printable
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError
from animarl_envs.files import refuse_special
from animarl_envs.locomotion import residual
from animarl_envs.species import get_species

FORMAT, VERSION = "animarl-submission", 1
HEAD = ("format", "version", "method", "species", "fingerprint", "episodes", "rollouts")
OF_EACH = ("demo", "seed", "repetition", "outcome", "positions")
LARGEST = 512 * 2**20  # [bytes]
SLACK = 0.02  # of the contact radius, for rounded positions
PUSHES = 4.0  # times the thrust: a fit of many magnitudes has more than twice the one of a single


def score_submission(path: str | Path, *, resamples: int = RESAMPLES) -> Score:
    """Check a submission and measure it against the packaged test split.

    InputError names the rollout that is not from a test start, or could not have been made.
    """
    path = Path(path)
    rollouts, demos = read_submission(path)
    return replace(score(rollouts, demos, resamples=resamples), data=demos.species, kind="method")


def read_submission(path: Path) -> tuple[Rollouts, Demonstrations]:
    """The rollouts of a file, and the packaged demonstrations, all splits, that they are of."""
    content = _content(path)
    name = content["species"]
    if name not in packaged_names():
        raise InputError(
            f"{path}: species is {_short(name)}: choose among {', '.join(packaged_names())}"
        )
    demos = load_packaged(name)
    test = demos.select(split="test")
    if content["fingerprint"] != test.fingerprint():
        raise InputError(
            f"{path}: its fingerprint is {_short(content['fingerprint'])} and that of the packaged "
            f"test split {test.fingerprint()}: roll out from the starts of this version"
        )
    listed = content["rollouts"]
    if not isinstance(listed, list) or content["episodes"] != len(listed):
        held = len(listed) if isinstance(listed, list) else "no list of"
        raise InputError(
            f"{path}: it claims {_short(content['episodes'])} episodes and holds {held} rollouts: "
            "give every one"
        )
    if not listed:
        raise InputError(f"{path}: it holds no rollout: give one for each test start at least")
    fastest = float(np.linalg.norm(demos.velocities(), axis=2).max()) * demos.dt
    widest = float(np.abs(demos.positions).max())
    paths = []
    for i, one in enumerate(listed):
        place = f"{path}: rollout {i}"
        positions = _checked(one, place, test)
        _check_moves(positions, place, test, fastest, widest)
        _check_made(positions, one["demo"], place, test)
        _check_outcome(one["outcome"], positions, place, test)
        paths.append(positions)
    columns = {key: np.array([one[key] for one in listed]) for key in OF_EACH[:-1]}
    keys = set(zip(*(columns[key].tolist() for key in OF_EACH[:3])))
    if len(keys) < len(listed):
        raise InputError(
            f"{path}: two rollouts have the same demo, seed and repetition: count repetitions up"
        )
    if missing := set(range(len(test))) - set(columns["demo"].tolist()):
        raise InputError(f"{path}: no rollout is from test episode {min(missing)}: leave none out")
    made = Rollouts(
        method=printable(content["method"]),
        individuals=test.individuals,
        roles=test.roles,
        dt=test.dt,
        positions=np.concatenate(paths),
        lengths=np.array([len(one) for one in paths]),
        outcome=columns["outcome"],
        condition=test.condition[columns["demo"]],
        cue=np.full(len(paths), NO_CUE),
        demo=columns["demo"],
        seed=columns["seed"],
        repetition=columns["repetition"],
    )
    return made, demos


def write_submission(rollouts: Rollouts, species: str, path: str | Path) -> Path:
    """Rollouts from the packaged test starts of ``species`` as a submission."""
    listed = [
        {key: int(getattr(rollouts, key)[i]) for key in OF_EACH[:-1]}
        | {"positions": rollouts.path(i).tolist()}
        for i in range(len(rollouts))
    ]
    fingerprint = load_packaged(species).select(split="test").fingerprint()
    write_json(
        Path(path),
        {
            "format": FORMAT, "version": VERSION, "method": rollouts.method, "species": species,
            "fingerprint": fingerprint, "episodes": len(listed), "rollouts": listed,
        },
    )  # fmt: skip
    return Path(path)


def _content(path: Path) -> Mapping[str, Any]:
    """The table in the file, all keys there and no others."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: name a submission")
    refuse_special(path)
    if path.stat().st_size > LARGEST:
        raise InputError(f"{path}: it is larger than {LARGEST // 2**20} MiB: give fewer rollouts")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: it is no valid JSON ({error}): write it again") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{path}: it is no submission: its format must be {FORMAT!r}")
    if content.get("version") != VERSION:
        raise InputError(
            f"{path}: its version is {_short(content.get('version'))}: write version {VERSION}"
        )
    _same_keys(content, HEAD, str(path))
    if not isinstance(content["method"], str) or not 1 <= len(content["method"]) <= 200:
        raise InputError(f"{path}: method is no name of 1 to 200 characters: give one")
    return content


def _checked(one: Any, place: str, test: Demonstrations) -> NDArray[np.float64]:
    """The positions ``(frames, individuals, 2)`` of a rollout from one of the test starts."""
    if not isinstance(one, dict):
        raise InputError(f"{place}: it is no table: give {', '.join(OF_EACH)}")
    _same_keys(one, OF_EACH, place)
    for key in OF_EACH[:-1]:
        if type(one[key]) is not int or (key != "outcome" and not 0 <= one[key] < 2**31):
            raise InputError(f"{place}: {key} is {_short(one[key])}: give a whole number")
    if one["demo"] >= len(test):
        raise InputError(f"{place}: demo is {one['demo']}: there are 0 to {len(test) - 1}")
    species = get_species(test.species)
    most, number = species.time_limit + 1, len(test.individuals)
    try:
        path = np.array(one["positions"])
    except (ValueError, TypeError, OverflowError):
        path = np.zeros(0)
    if path.dtype.kind not in "if":
        raise InputError(f"{place}: positions are not all numbers: see to them")
    path = path.astype(np.float64)
    if path.ndim != 3 or path.shape[1:] != (number, 2) or not 2 <= len(path) <= most:
        raise InputError(
            f"{place}: positions are not (frames, {number}, 2) with 2 to {most} frames: see to them"
        )
    if not np.isfinite(path).all():
        raise InputError(f"{place}: a position is not a finite number: see to it")
    start = test.positions[test.offsets[one["demo"]]]
    if np.abs(path[0] - start).max() > SLACK * species.contact_radius:
        raise InputError(f"{place}: it does not begin where test episode {one['demo']} began")
    return path


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


def _same_keys(content: Mapping[str, Any], keys: tuple[str, ...], place: str) -> None:
    if missing := [key for key in keys if key not in content]:
        raise InputError(f"{place}: {missing[0]} is missing: give it")
    if more := [key for key in content if key not in keys]:
        raise InputError(f"{place}: key {_short(more[0])} is unknown: leave it out")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
