"""Methods that are no recipe of ours: those of others, and references, which learn nothing.

A method of others is anything with SB3's ``predict``, or a callable, made by ``module:factory``.
The references are:

``recordings``
    Other recordings of the same condition, each given to one test start: how alike recordings are.
``tracking``
    The test recordings themselves as the fitted locomotion follows them in closed loop, knowing
    where to go: what the locomotion model allows.
``experts``
    The artificial agents that made the demonstrations, in their own locomotion, where these are
    known: the most that any method can hope for.
``nearest``
    What was done in the nearest recorded second of training.
``scripted``
    Pursuers intercept the target, which evades; a moth that surges, zigzags and loops.
``constant-velocity``, ``still``, ``random``
    The action that changes the velocity least, that stops soonest, any.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation import collect
from animarl_algos.evaluation.classifier import tracked_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import roll_out_teams, teams_of
from animarl_algos.learner.callbacks import TERMINATED
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_world import training_options
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import track
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.locomotion import next_velocity
from animarl_envs.scenario import Scenario
from animarl_envs.species import SearchSpecies, Species
from animarl_envs.worlds import demonstration_observations, make_world
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodSetting:
    """Input of a method's factory: everything to train on, and no test episode.

    ``demos`` are those of the splits train and val, ``species`` the world's numbers with the fitted
    locomotion, ``seed`` that of the training, ``copies`` and ``options`` of :meth:`environment`.
    """

    demos: Demonstrations
    species: Species
    seed: int
    copies: int
    options: Mapping[str, Any]

    @classmethod
    def of(cls, world: Run, seed: int) -> MethodSetting:
        """Return the setting of a fitted world."""
        demos = world.learnable_demos
        return cls(
            demos=demos,
            species=world.species,
            seed=seed,
            copies=world.settings.copies,
            options=training_options(world.environment_options),
        )

    def environment(self) -> SlotVecEnv:
        """Return a vectorised environment to train in, one slot per copy and individual.

        Its observations are those that the method is asked about afterwards: where recordings of
        both conditions are there, the last component is the condition.
        """
        env = SlotVecEnv(
            self.species, self.copies, demos=self.demos, condition_flag=None, **self.options
        )
        env.seed(self.seed)
        return env


class CheckedPolicy:
    """A method of others, each of whose answers is checked.

    The ``policy`` has ``predict`` as SB3 has it, or is a callable from observations ``(slots, n)``
    to actions ``(slots,)`` below ``num_actions``; slot = copy * individuals + individual.
    """

    def __init__(self, name: str, policy: Any, num_actions: int) -> None:
        if not callable(policy) and not hasattr(policy, "predict"):
            raise InputError(
                f"method {name}: its factory made {type(policy).__name__}, which has no predict "
                "and is no callable: return what acts"
            )
        self._name, self._policy, self._num_actions = name, policy, num_actions

    def predict(self, observation: Any, state: Any = None, **known: Any) -> tuple[Ints, Any]:
        """Return one action per slot; raise InputError where the method does anything else."""
        slots, most = len(observation), self._num_actions - 1
        with errors_as_input_errors(f"method {self._name}: its predict raised"):
            if hasattr(self._policy, "predict"):
                actions, state = self._policy.predict(observation, state=state, **known)
            else:
                actions = self._policy(observation)
            chosen = np.asarray(actions)
        wrong = f"{chosen.dtype} of shape {chosen.shape}"
        if chosen.shape == (slots,) and chosen.dtype.kind in "iuf":
            bad = chosen[~((chosen == np.floor(chosen)) & (chosen >= 0) & (chosen <= most))]
            wrong = f"action {bad[0]:g}" if len(bad) else ""
        if wrong:
            raise InputError(
                f"method {self._name}: its predict gave {wrong}: give {slots} whole numbers from 0 "
                f"to {most}"
            )
        return chosen.astype(np.int64), state


def one_line(text: object) -> str:
    """Return a text of somebody else's code on one line, as tables and lists need it."""
    return " ".join(str(text).split())


@contextmanager
def errors_as_input_errors(what: str, fix: str = "fix it") -> Iterator[None]:
    """Turn whatever somebody else's code raises, ``sys.exit`` included, into an InputError.

    It says ``what`` failed, what was raised, and the ``fix``. Ctrl-C and a signal to end go
    through.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code == TERMINATED:
            raise
        raised = f"{type(error).__name__} ({one_line(error)})"
        raise InputError(f"{what} {raised}: {fix}") from error


def parameters_of(policy: Any) -> int | None:
    """Return the number of parameters of a PyTorch policy or an SB3 model; None for others.

    A target network of the policy counts too.
    """
    network = getattr(policy, "policy", policy)
    if not isinstance(network, torch.nn.Module):
        return None
    return sum(parameter.numel() for parameter in network.parameters())


def parse_method(given: str) -> tuple[str, str]:
    """Split ``NAME=module:factory`` into name and ``module:factory``, and import it."""
    name, equals, place = given.partition("=")
    if not equals or not name.replace("-", "").replace("_", "").isalnum():
        raise InputError(
            f"--method {given}: write NAME=module:factory, the name of letters, digits, - and _"
        )
    load_factory(place)
    return name, place


def load_factory(place: str) -> Callable[[MethodSetting], Any]:
    """Import ``module:factory``; modules in the working directory are found too."""
    module, colon, name = place.partition(":")
    if not (module and colon and name):
        raise InputError(f"method {place!r}: write module:factory")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    with errors_as_input_errors(f"method {place!r}: it cannot be imported:", "check its module"):
        attribute = getattr(importlib.import_module(module), name)
    if not callable(attribute):
        raise InputError(f"method {place!r}: it is no callable: name a factory")
    made: Callable[[MethodSetting], Any] = attribute
    return made


def source_of(place: str) -> str:
    """Return the factory with a hash of its module's file: another source is another method."""
    spec = importlib.util.find_spec(place.partition(":")[0])
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return place
    return f"{place}#{hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()[:16]}"


RECORDINGS = "recordings"
OWN_VELOCITY = (("own velocity ahead", "own velocity left"), ("velocity ahead", "velocity left"))
"""By what names worlds have an individual's velocity, in the frame of its actions."""
SEGMENT = 1.0  # [s] that the nearest recording is followed for
NEIGHBOURS = 5  # one of them is drawn, so that rollouts of a start differ


def reference_rollouts(
    world: Run, *, method: str, seed: int, repetitions: int, fold: bool = False
) -> Rollouts:
    """Return the rollouts of one row, from every test start.

    ``fold``: they are those of a cross-validation. Over all of its folds each recording is taken
    once, as one of the validation split, beside another one.
    """
    demos, species, scenario = world.demos, world.species, world.scenario
    test = demos.select(split="test")
    if method == RECORDINGS:
        beside = demos.select(split="val") if fold else learnable(demos)
        return recordings_of_other_starts(beside, test, seed)
    if method == "tracking":
        tracked = tracked_rollouts(test, track(test, species.locomotion, species.arena))
        return replace(tracked, method=method, seed=np.full(len(tracked), seed))
    if method == "experts":
        return expert_rollouts(demos, species, seed, repetitions)
    policy: collect.Policy
    if method == "nearest":
        policy = NearestSegment(species, learnable(demos), seed)
    elif method == "scripted" and isinstance(species, SearchSpecies):
        policy = ProgrammedPolicy(species, seed)
    elif method in ("scripted", "random"):
        policy = collect.RandomPolicy(seed, species.num_actions)
        if method == "scripted":  # the world's script decides
            scenario = replace(scenario, drivers=("scripted",) * species.num_individuals)
    else:
        policy = Steering(scenario, keep=1.0 if method == "constant-velocity" else 0.0)
    return collect.collect_rollouts(
        partial(make_world, scenario),
        policy,
        method=method,
        seed=seed,
        repetitions=repetitions,
        cue="actual" if method == "nearest" else None,
    )


def expert_rollouts(
    demos: Demonstrations, species: Species, seed: int, repetitions: int
) -> Rollouts:
    """Return rollouts of the teams that made the demonstrations, from starts of their condition."""
    teams = teams_of(demos)
    if teams is None:
        raise InputError(f"{demos.name}: who made it is not known: leave 'experts' out")
    return roll_out_teams(
        teams,
        teams[0].embody(species),
        demos.select(split="test"),
        name="experts",
        seed=seed,
        repetitions=repetitions,
    )


def recordings_of_other_starts(others: Demonstrations, test: Demonstrations, seed: int) -> Rollouts:
    """Return each of the ``others`` as if it were a rollout from a test start of its condition.

    They are dealt evenly and each once, so that no classifier meets one of them twice.
    """
    rng = np.random.default_rng(seed)
    taken, start, repetition = [], [], []
    for condition in np.unique(test.condition).tolist():
        starts = rng.permutation(np.flatnonzero(test.condition == condition))
        there = rng.permutation(np.flatnonzero(others.condition == condition))
        taken += there.tolist()
        start += [starts[i % len(starts)] for i in range(len(there))]
        repetition += [i // len(starts) for i in range(len(there))]
    if not taken:
        raise InputError(f"{test.name}: no other recording has the condition of a test episode")
    made = Rollouts.from_demonstrations(others).select(np.array(taken))
    return replace(
        made,
        method=RECORDINGS,
        demo=np.array(start),
        repetition=np.array(repetition),
        seed=np.full(len(taken), seed),
    )


class Steering(collect.MemorylessPolicy):
    """The action after which the velocity is nearest to ``keep`` times what it is.

    1 holds the velocity, 0 stops. The scenario's observations hold each individual's own velocity.
    """

    def __init__(self, scenario: Scenario, keep: float) -> None:
        self._species, self._keep = scenario.species, keep
        names = [one.name for one in make_world(scenario, 1).observation_components]
        velocities = [pair for pair in OWN_VELOCITY if set(pair) <= set(names)]
        if not velocities:
            raise InputError(
                f"{self._species.name}: what is observed holds no velocity of one's own"
            )
        self._columns = [names.index(name) for name in velocities[0]]

    def act(self, observation: NDArray[np.floating]) -> Ints:
        """Return one action per slot."""
        velocities = observation[:, self._columns].astype(np.float64)
        actions = np.empty(len(velocities), dtype=np.int64)
        number = self._species.num_individuals
        for k, own in enumerate(self._species.locomotion):
            now = velocities[k::number, None]
            pushes = own.action_vectors[None]
            after = next_velocity(now, pushes, own.damping, own.thrust, self._species.dt)
            missed = np.linalg.norm(after - self._keep * now, axis=-1)
            actions[k::number] = missed.argmin(axis=1)
        return actions


class ProgrammedPolicy:
    """The programmed moth, one per slot; new ones wherever no state is handed on."""

    def __init__(self, species: SearchSpecies, seed: int) -> None:
        self._species, self._rng = species, np.random.default_rng(seed)

    def predict(self, observation: Any, state: Any = None, **_: Any) -> tuple[Ints, Any]:
        """Return one action per slot, and the programmed moths as state."""
        if state is None:
            state = ProgrammedMoth(len(observation), self._rng, self._species)
            state.reset()
        return state.act(observation[:, None]).ravel().astype(np.int64), state


class NearestSegment:
    """The nearest recorded segment, replayed: the simulator that learns and forgets nothing.

    Every individual looks up, among the training frames of its own and of the episode's condition,
    one of the ``NEIGHBOURS`` whose observations are nearest to what it sees, and does for
    ``SEGMENT`` seconds what was done from there. Observations end with the condition.

    The species' locomotion tells the recorded actions; episodes of the split train are looked up.
    """

    def __init__(self, species: Species, demos: Demonstrations, seed: int) -> None:
        train = demos.select(split="train")
        seen = demonstration_observations(species, train).astype(np.float64)
        self._actions = demonstrated_actions(train, species.locomotion).astype(np.int64)
        going = self._actions[:, 0] >= 0  # no last frame
        condition = np.repeat(train.condition, train.lengths)
        # By individual and condition: the tree, its frames among all, the scale of each input.
        self._libraries: dict[tuple[int, int], tuple[cKDTree, Ints, Floats]] = {}
        for individual in range(seen.shape[1]):
            spread = seen[going, individual].std(axis=0)
            scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
            for of in np.unique(condition).tolist():
                frames = np.flatnonzero(going & (condition == of))
                self._libraries[individual, of] = (
                    cKDTree(seen[frames, individual] * scale),
                    frames,
                    scale,
                )
        self._name, self._individuals = demos.name, seen.shape[1]
        self._rng = np.random.default_rng(seed)
        self._steps = max(1, round(SEGMENT / species.dt))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, **_: Any
    ) -> tuple[Ints, tuple[Ints, Ints]]:
        """Return one action per slot; the state is the frame of each and the steps left of it."""
        slots = len(observation)
        individual = np.arange(slots) % self._individuals
        frame, left = np.array([[-1], [1]]).repeat(slots, axis=1) if state is None else state
        frame, left = frame + 1, left - 1
        anew = (left == 0) | (self._actions[frame, individual] < 0)
        anew |= np.asarray(episode_start, dtype=bool)
        condition = observation[:, -1].astype(np.int64)
        for own, of in {(int(w), int(c)) for w, c in zip(individual[anew], condition[anew])}:
            asking = np.flatnonzero(anew & (individual == own) & (condition == of))
            if (own, of) not in self._libraries:
                raise InputError(
                    f"{self._name}: no training episode is of condition {of}: deal the splits "
                    "anew, or leave 'nearest' out of the references"
                )
            tree, frames, scale = self._libraries[own, of]
            among, number = min(NEIGHBOURS, len(frames)), len(asking)
            near = tree.query(observation[asking, :-1] * scale, k=among)[1].reshape(number, among)
            drawn = self._rng.integers(among, size=number)
            frame[asking], left[asking] = frames[near[np.arange(number), drawn]], self._steps
        return self._actions[frame, individual], (frame, left)
