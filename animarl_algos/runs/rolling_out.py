"""The policies of a run, rolled out on its test split. Nothing is trained here."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path

from animarl_algos.evaluation.collect import Cue, Policy, RandomPolicy, collect_rollouts
from animarl_algos.evaluation.decisions import decide_along
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.runs.acting import act_as_chosen, for_all
from animarl_algos.runs.run_folder import RunFolder
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import Tracking, track
from animarl_envs.species import Species
from animarl_envs.worlds import make_world

DECISIONS = Path("rollouts", "decisions.npz")
UNTRAINED, RANDOM = "untrained", "random"


def method_name(algo: str) -> str:
    """How a learner is called in tables and figures."""
    return algo.upper()


def adding_command(run: RunFolder) -> str:
    """The command that adds to a run what it lacks: it skips whatever is there."""
    words = shlex.split(run.record["command"])
    if words[:1] == ["animarl"] and words[1:2] in (["run"], ["train"]):
        return shlex.join(["animarl", "run", *words[2:]])
    return f"animarl run with the settings of the run and --out {run.path}"


def lacking(run: RunFolder) -> list[str]:
    """What the run was asked for but does not have, each in a sentence with what adds it."""
    return [
        f"{run.path}: it has no trained {method_name(algo)} to compare with: add it with "
        f"'{adding_command(run)}'"
        for algo in run.settings.compared
        if not run.has_policy(algo)
    ]


def trained_model(run: RunFolder, algo: str) -> SequenceQLearning:
    """A trained learner of a run, acting by its rule.

    Raises
    ------
    InputError
        If it was not trained yet, or its weights are damaged.
    """
    if not run.has_policy(algo):
        raise InputError(
            f"{run.path}: there is no trained policy of {method_name(algo)} yet: train it with "
            f"'{adding_command(run)}'"
        )
    species = run.species(run.demos, run.fit)
    model = run.learner(algo, run.environment(species, run.demos))
    run.load_policy(algo, model)
    return act_as_chosen(run, algo, model, species)


def untrained_model(run: RunFolder) -> SequenceQLearning:
    """The network that the training of the run began with."""
    demos = run.demos
    return run.learner(run.settings.algo, run.environment(run.species(demos, run.fit), demos))


def test_policies(run: RunFolder) -> dict[str, Policy]:
    """The trained learner and what it is compared with, as far as the run has it."""
    settings = run.settings
    policies: dict[str, Policy] = {
        method_name(algo): trained_model(run, algo)
        for algo in (settings.algo, *settings.compared)
        if algo == settings.algo or run.has_policy(algo)
    }
    if settings.baselines:
        policies[UNTRAINED] = untrained_network = untrained_model(run)
        policies[RANDOM] = RandomPolicy(settings.seed, untrained_network.policy.num_actions)
    return policies


def told(
    run: RunFolder,
    policy: Policy,
    name: str,
    cue: Cue | None,
    *,
    repetitions: int | None = None,
    world: int | None = None,
    draws: int = 0,
) -> Rollouts:
    """Rollouts of one policy from every test start, told ``cue``.

    Whatever it is told, a policy gets the same random numbers, and so does the world.

    Parameters
    ----------
    world
        The condition that the world is put in; by default that of each demonstration.
    draws
        Another number gives the policy other random numbers.
    """
    scenario = run.scenario("test", "demo" if world is None else world)  # type: ignore[arg-type]

    def reseed(seed: int) -> None:
        if isinstance(policy, SequenceQLearning):
            policy.policy.seed(seed + draws)

    return collect_rollouts(
        partial(make_world, scenario),
        for_all(policy, scenario.names, run.settings.focal),
        method=name,
        seed=run.settings.seed,
        repetitions=repetitions or run.settings.repetitions,
        cue=cue,
        reseed=reseed,
    )


def roll_out(run: RunFolder) -> dict[str, Rollouts]:
    """Every method from each test demonstration's start, and what the learner values.

    Where the learners see the condition, trained ones are also told the other one, in the same
    world: the counterfactual.
    """
    settings, demos = run.settings, run.demos
    species = run.species(demos, run.fit)
    policies = test_policies(run)
    learner = policies[method_name(settings.algo)]
    assert isinstance(learner, SequenceQLearning)
    flagged = learner.layout.condition_flag
    test = demos.select(split="test")
    along = decide_along(
        learner.policy, species, test, condition_flag=flagged, focal=settings.focal
    )
    along.save(run.path / DECISIONS)
    rollouts = {}
    for name, policy in policies.items():
        cues: tuple[Cue | None, ...] = (None,)
        if flagged and name != RANDOM:
            cues = ("actual",) if name == UNTRAINED else ("actual", "flipped")
        rollouts[name] = Rollouts.concatenate([told(run, policy, name, cue) for cue in cues])
        rollouts[name].save(run.path / "rollouts" / f"{name}.npz")
    return rollouts


def stored_rollouts(run: RunFolder) -> dict[str, Rollouts]:
    """By method, the run's own learner first.

    Raises
    ------
    InputError
        If the run has no rollouts yet, or a file is damaged.
    """
    own = method_name(run.settings.algo)
    files = [f for f in sorted((run.path / "rollouts").glob("*.npz")) if f.name != DECISIONS.name]
    if own not in {file.stem for file in files}:
        raise InputError(
            f"{run.path}: it has no rollouts yet: add them with 'animarl evaluate {run.path}'"
        )
    files.sort(key=lambda file: file.stem != own)
    return {file.stem: Rollouts.load(file) for file in files}


def perturbed(test: Demonstrations, species: Species, seed: int) -> Tracking:
    """Recordings as the fitted locomotion follows them, with one action in ten at random."""
    return track(test, species.locomotion, species.arena, random_share=0.1, seed=seed)
