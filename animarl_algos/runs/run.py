"""A run's folder: everything needed to repeat it, to continue it, and to show it.

settings.json       as resolved, with versions, machine, command and the demonstrations' fingerprint
demonstrations.npz  with their splits and provenance
locomotion.json     the fitted parameters
checkpoints/        the last whole checkpoint of each learner
policies/           final weights of each learner (tensors only), and the rule that it acts by
logs/               learning curves: CSV and TensorBoard
rollouts/           on the test split, by method
folds/              of a cross-validation: a run folder for each other fold
evaluation/         tables, and the verdict
wall_time.json      seconds by stage
report.html
"""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from filelock import FileLock, Timeout

from animarl_algos.data.vec_env import FocalPolicy, SlotVecEnv, focal_drivers
from animarl_algos.evaluation import acting_choice
from animarl_algos.evaluation.collect import Cue, Policy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.trait_response import trait_components, trait_gains
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.checkpoint import latest_checkpoint, serialise_tensors, summarise_error
from animarl_algos.learner.settings import LearnerSettings
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs import run_files, run_world
from animarl_algos.runs.run_settings import BEHAVIOUR_CLONING, CHOSEN, RunSettings, checked_species
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable, run_folds
from animarl_envs.errors import InputError
from animarl_envs.files import read_json, write_then_rename
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.result import LocomotionFit
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import PACKAGED, Condition, Scenario, make_scenario
from animarl_envs.species import Species
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world, with_options
from animarl_envs.species.traits import TRAITS
from animarl_envs.worlds import demonstration_observations, make_world

if TYPE_CHECKING:
    from animarl_algos.whatif.answer import WhatIf

DEMONSTRATIONS = "demonstrations.npz"


class Run:
    """A run, or an exported model: what its folder holds, each file read once.

    Attributes
    ----------
    path
        Its folder.
    acting_rule
        Goes over the rule that trained policies of the run act by.
    """

    def __init__(self, path: Path, acting_rule: str | None = None) -> None:
        self.path, self.acting_rule = path, acting_rule

    # -- what the run is --------------------------------------------------------------------------

    def start(
        self,
        settings: RunSettings,
        demos: Demonstrations,
        command: str,
        reasons: Mapping[str, str] | None = None,
        folds: int = 0,
    ) -> None:
        """Write what the run is, or make sure that what is there is the same run.

        ``reasons`` say why a setting was chosen, by its name; ``demos`` are split as the first of
        so many ``folds``, or as they were given. Raises InputError if the folder holds another run.
        """
        own, other = settings.learner(), settings.learner(BEHAVIOUR_CLONING)
        moving = run_world.select_individuals(demos, own.env_kwargs)
        species = with_options(
            checked_species(settings, moving), **run_world.species_options(own.env_kwargs)
        )
        # Options by which worlds differ are said in full, whatever their defaults become.
        world = {"observation": species.observation, "rebound": species.arena.rebound}
        resolved = _as_json(
            {
                "settings": asdict(settings),
                "learner": asdict(own.settings),
                "baseline": asdict(other.settings),
                "environment": world | own.env_kwargs,
                "fingerprint": demos.fingerprint(),
            }
        )
        if not (self.path / "settings.json").exists():
            demos.save(self.path / DEMONSTRATIONS)
            made = {
                "versions": run_files.versions(),
                "machine": run_files.machine(),
                "command": command,
                "reasons": dict(reasons or {}),
            } | ({"folds": folds} if folds else {})
            self._write_record(resolved | made)
            return
        for key, here in resolved.items():
            there = self.record.get(key)
            if key in ("learner", "baseline") and there is not None:  # maybe without defaults
                there = _as_json(asdict(LearnerSettings.of(there)))
            if there != here:
                if isinstance(there, dict) and isinstance(here, dict):
                    keys = [k for k in here | there if here.get(k) != there.get(k)]
                    key = f"{key}: {', '.join(keys)}"
                raise InputError(
                    f"{self.path}: it holds another run (its {key} differ): "
                    "choose another --out, or remove it"
                )

    def _write_record(self, record: Mapping[str, Any]) -> None:
        self.record = _as_json(record)
        self.__dict__.pop("settings", None)
        run_files.write_json(self.path / "settings.json", self.record)

    @cached_property
    def record(self) -> dict[str, Any]:
        """What settings.json holds of the run.

        ``settings``, ``learner`` and the ``baseline`` it is compared with, ``environment``,
        ``fingerprint``, ``versions``, ``machine``, ``command`` and ``reasons``.
        """
        file = self.path / "settings.json"
        try:
            record: dict[str, Any] = read_json(file)
            if not isinstance(record, dict):
                raise ValueError("it is no table")
            return record
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(
                f"{self.path}: it is not a run folder (settings.json is missing): "
                "make one with 'animarl run' or 'animarl train'"
            ) from None
        except ValueError as error:
            raise InputError(f"{file}: it is damaged ({error}): start the run again") from None

    @cached_property
    def settings(self) -> RunSettings:
        """As the run was asked for."""
        try:
            return RunSettings.of(self.record["settings"])
        except (KeyError, TypeError, InputError) as error:
            raise InputError(
                f"{self.path / 'settings.json'}: it is not of this version of animarl ({error}): "
                "start the run again"
            ) from None

    def extend(self, steps: int | None = None, device: str | None = None) -> None:
        """Raise the number of steps of a run that is to be continued; move it to a device."""
        settings = self.settings
        if steps is not None and steps < settings.steps:
            raise InputError(
                f"{self.path}: the run has {settings.steps} steps already: ask for more with "
                "--steps"
            )
        online = named_recipe(settings.algo).algorithm.recipe.online
        checkpoint = latest_checkpoint(self.path / "checkpoints" / settings.algo)
        further = steps is not None and steps > settings.steps
        if further and online and self.has_policy(settings.algo) and checkpoint is None:
            raise InputError(
                f"{self.path}: its checkpoints are gone, so it cannot go on: start a new run"
            )
        extended = settings.changed(steps=steps or settings.steps, device=device or settings.device)
        self._write_record(self.record | {"settings": asdict(extended)})

    def suggested_command(self) -> str:
        """Return the command that adds to the run what it lacks: it skips whatever is there."""
        words = shlex.split(self.record["command"])
        if words[:1] == ["animarl"] and words[1:2] in (["run"], ["train"]):
            return shlex.join(["animarl", "run", *words[2:]])
        return f"animarl run with the settings of the run and --out {self.path}"

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder, if there is one, or refuse to while another process does.

        A process may hold it again; a dead one holds nothing.
        """
        lock = FileLock(self.path / ".lock", timeout=0, is_singleton=True)
        try:
            with lock if self.path.is_dir() else nullcontext():
                yield
        except Timeout:
            raise InputError(
                f"{self.path}: another process is at work in this run: wait for it, or name "
                "another folder"
            ) from None

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall time of what is done within it to that of its stage, if it succeeds."""
        begun = time.monotonic()
        yield
        self.add_time(stage, time.monotonic() - begun)

    def add_time(self, stage: str, seconds: float) -> None:
        """Add to the wall time of a stage."""
        times = self.wall_times()
        times[stage] = times.get(stage, 0.0) + seconds
        run_files.write_json(self.path / "wall_time.json", times)

    def wall_times(self) -> dict[str, float]:
        """Return seconds by stage; none of a run that never came so far."""
        file = self.path / "wall_time.json"
        return dict(read_json(file)) if file.exists() else {}

    # -- its world --------------------------------------------------------------------------------

    @cached_property
    def demos(self) -> Demonstrations:
        """The demonstrations (packaged ones need no copy), all splits, of those who move."""
        file = self.path / DEMONSTRATIONS
        if file.exists() or self.settings.file != PACKAGED:
            demos = Demonstrations.load(file)
        else:
            demos = self._split_for_run(load_packaged(self.settings.species))
            if demos.fingerprint() != self.record["fingerprint"]:
                raise InputError(
                    f"{self.path}: it was trained on packaged demonstrations of another version: "
                    "train it anew"
                )
        return run_world.select_individuals(demos, self.environment_options)

    def _split_for_run(self, demos: Demonstrations) -> Demonstrations:
        """Return the demonstrations of a file, split as for this run."""
        folds = self.record.get("folds")
        return next(run_folds(demos, folds)) if folds else demos

    def check_demonstrations(self, given: Demonstrations | None) -> Demonstrations:
        """Return the demonstrations that the run is shown with: those ``given``, or else its own.

        Given ones also stand in for those that an exported model came without. Raises InputError if
        it lacks its own and these are others, or they are of other individuals.
        """
        file = self.settings.file
        if file != PACKAGED and not (self.path / DEMONSTRATIONS).exists():
            given = None if given is None else self._split_for_run(given)
            if given is None or given.fingerprint() != self.record["fingerprint"]:
                other = "" if given is None else f", and {given.name} holds others"
                raise InputError(
                    f"{self.path}: the demonstrations that it learned from ({file}) are not in it"
                    f"{other}: give their file by --demos, or export it again --with-demonstrations"
                )
            self.demos = run_world.select_individuals(given, self.environment_options)
        if given is None:
            return self.demos
        given = run_world.select_individuals(given, self.environment_options)
        names, learned = (
            ", ".join(f"{name} ({role})" for name, role in zip(d.individuals, d.roles))
            for d in (given, self.demos)
        )
        if names != learned:
            raise InputError(
                f"{given.name}: it shows {names}, but {self.path} learned from {learned}: give "
                "--demos of the same individuals, in this order"
            )
        return given

    @cached_property
    def learnable_demos(self) -> Demonstrations:
        """Those of the train and val splits: all that fitting, training and choosing are given."""
        return learnable(self.demos)

    @cached_property
    def fit(self) -> LocomotionFit:
        """The fitted locomotion."""
        return LocomotionFit.load(self.path / "locomotion.json")

    @property
    def environment_options(self) -> dict[str, Any]:
        """Options of the training environment."""
        options: dict[str, Any] = self.record["environment"]
        return options

    @property
    def world_options(self) -> dict[str, Any]:
        """Options that every world of the run has, beside those of its species."""
        return run_world.world_options(self.environment_options)

    @cached_property
    def species(self) -> Species:
        """The recordings' animals and arena, the fitted locomotion, and over these its options."""
        fitted = species_of(self.demos, self.fit.locomotion, base=self.settings.species)
        return with_options(fitted, **run_world.species_options(self.environment_options))

    @cached_property
    def scenario(self) -> Scenario:
        """The world of the run, with the fitted locomotion, from the starts of its test split."""
        return self.starting_from("test")

    def starting_from(
        self,
        split: str | None,
        condition: Condition = "demo",
        *,
        demos: Demonstrations | None = None,
        species: Species | None = None,
    ) -> Scenario:
        """Return the world of the run from the starts of ``split``: to evaluate in and to watch.

        Episodes have the condition of their demonstration, or the one given. Those who did not
        learn replay their demonstration.
        """
        species = species or self.species
        return make_scenario(
            species,
            demos=self.demos if demos is None else demos,
            split=split,
            condition=condition,
            drivers=focal_drivers(species.individuals, self.settings.focal),
            **self.world_options,
        )

    def environment(self, demos: Demonstrations | None = None) -> SlotVecEnv:
        """Return the training environment, in which all learn, or the run's focal individual."""
        return SlotVecEnv(
            self.species,
            self.settings.copies,
            demos=self.demos if demos is None else demos,
            focal=self.settings.focal,
            condition_flag=None,
            **run_world.training_options(self.environment_options),
        )

    # -- its policies -----------------------------------------------------------------------------

    def learner(self, algo: str, env: SlotVecEnv) -> SequenceQLearning:
        """Return a new learner with the settings that were recorded when the run began."""
        settings = self.settings
        recorded = self.record["learner" if algo == settings.algo else "baseline"]
        return named_recipe(algo).algorithm(
            env=env,
            seed=settings.seed,
            device=settings.device,
            settings=LearnerSettings.of(recorded, f"{self.path / 'settings.json'}: "),
        )

    @cached_property
    def policy(self) -> SequenceQLearning:
        """The trained learner, with stable-baselines3's ``predict``; it acts as in tests."""
        return self.trained(self.settings.algo)

    def trained(self, algo: str) -> SequenceQLearning:
        """Return a trained learner of the run, acting by its rule.

        Raises InputError if it was not trained yet, or its weights are damaged.
        """
        if not self.has_policy(algo):
            raise InputError(
                f"{self.path}: there is no trained policy of {method_name(algo)} yet: train it "
                f"with '{self.suggested_command()}'"
            )
        model = self.learner(algo, self.environment())
        self.load_policy(algo, model)
        return self.set_acting_rule(algo, model)

    def untrained(self) -> SequenceQLearning:
        """Return the network that the training of the run began with."""
        return self.learner(self.settings.algo, self.environment())

    def has_policy(self, name: str) -> bool:
        """Return whether a learner is trained."""
        return run_files.weights_file(self.path / "policies", name).exists()

    def save_policy(self, name: str, model: SequenceQLearning) -> None:
        """Write the final weights, tensors only."""
        with write_then_rename(self.path / "policies" / f"{name}.pt") as part:
            part.write_bytes(serialise_tensors(model.policy.q_net.state_dict()))

    def load_policy(self, name: str, model: SequenceQLearning) -> None:
        """Load the weights of a trained learner."""
        file = run_files.weights_file(self.path / "policies", name)
        try:
            weights = run_files.read_weights(file)
            model.policy.q_net.load_state_dict(weights)
            model.policy.q_net_target.load_state_dict(weights)
        except (RuntimeError, ValueError, TypeError, LookupError) as error:
            raise InputError(
                f"{file}: it is not a policy of this run ({summarise_error(error)}): "
                "remove it and train again"
            ) from None

    # -- how they act -----------------------------------------------------------------------------

    def acting_file(self, algo: str) -> Path:
        """Return the file of the chosen rule and its candidates."""
        return self.path / "policies" / f"{algo}.acting.json"

    def acting(self, algo: str) -> Acting:
        """Return the rule that the trained ``algo`` acts by.

        Raises InputError if none was chosen yet, or the file is damaged.
        """
        rule, file = self.acting_rule or self.settings.acting, self.acting_file(algo)
        if rule != CHOSEN:
            return Acting.parse(rule)
        try:
            return Acting.from_json(read_json(file)["acting"])
        except FileNotFoundError:
            raise InputError(
                f"{file}: no acting rule was chosen yet: let 'animarl train' finish, or give "
                "--acting"
            ) from None
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(
                f"{file}: it is damaged ({error}): remove it and train again"
            ) from None

    def set_acting_rule(
        self, algo: str, model: SequenceQLearning, processes: int = 1
    ) -> SequenceQLearning:
        """Set the acting rule of a trained ``model``; choose it if there is none yet."""
        rule = self.acting_rule or self.settings.acting
        if rule == CHOSEN and not self.acting_file(algo).exists():
            self._choose_acting(algo, model, processes)
        model.policy.acting = self.acting(algo)
        return model

    def amplify_trait_inputs(self, algo: str, model: SequenceQLearning) -> None:
        """Scale a model's trait inputs so that simulated animals differ as much as recorded ones.

        The factors are recorded under ``reasons``.
        """
        traits, seed = self.species.traits, self.settings.seed
        if traits is None:
            return
        demos = acting_choice.choice_episodes(self.learnable_demos, seed)
        make = partial(make_world, self.starting_from(None, demos=demos))
        components = trait_components(make(1))
        if not components:
            return
        fitted = model.fit_temperature(model.demonstration_data().val)
        policy = self._acting_by(model, Acting.boltzmann(fitted), seed)
        gains = trait_gains(policy, make, traits, seed=seed, cue=_cue(model))
        for network in (model.policy.q_net, model.policy.q_net_target):
            network.amplify_inputs(components, gains)
        factors = ", ".join(f"{name} {gain:.2g}" for name, gain in zip(TRAITS, gains))
        reason = {f"traits of {algo}": f"amplified, or animals were too much alike: {factors}"}
        self._write_record(self.record | {"reasons": self.record.get("reasons", {}) | reason})

    def _choose_acting(self, algo: str, model: SequenceQLearning, processes: int) -> None:
        seed = self.settings.seed
        demos = acting_choice.choice_episodes(self.learnable_demos, seed)
        fitted = model.fit_temperature(model.demonstration_data().val)
        choice = acting_choice.choose_acting(
            partial(self._acting_by, model),
            partial(make_world, self.starting_from(None, demos=demos)),
            demos,
            acting_choice.candidate_rules(fitted),
            acting_choice.further_rules(fitted),
            seed=seed,
            cue=_cue(model),
            processes=processes,
        )
        run_files.write_json(self.acting_file(algo), choice.to_json())

    def _acting_by(self, model: SequenceQLearning, rule: Acting, seed: int) -> Policy:
        """Return the joint policy of a ``model`` with an acting rule and newly seeded draws."""
        model.policy.acting = rule
        model.policy.seed(seed)
        return self.as_joint_policy(model)

    def as_joint_policy(self, policy: Policy) -> Policy:
        """Return a policy that acts for all individuals, even if only one of them learned."""
        focal = self.settings.focal
        if focal is None or not isinstance(policy, SequenceQLearning):
            return policy
        return FocalPolicy(policy, self.species.individuals, focal)

    # -- what they do -----------------------------------------------------------------------------

    def rollouts(self) -> dict[str, Rollouts]:
        """Return those on the test split by method, the run's own learner first.

        Raises InputError if the run has no rollouts yet, or a file is damaged.
        """
        own = method_name(self.settings.algo)
        files = {f.stem: f for f in sorted((self.path / "rollouts").glob("*.npz"))}
        if own not in files:
            raise InputError(
                f"{self.path}: it has no rollouts yet: add them with 'animarl evaluate {self.path}'"
            )
        return {name: Rollouts.load(files[name]) for name in dict.fromkeys([own, *files])}

    def roll_out(
        self,
        policy: Policy,
        name: str,
        cue: Cue | None,
        *,
        scenario: Scenario | None = None,
        repetitions: int | None = None,
        seed: int | None = None,
        wrap: Callable[[Policy], Policy] = lambda policy: policy,
        make: Callable[[int], Any] | None = None,
    ) -> Rollouts:
        """Return rollouts of a policy from every start of a world, with the condition flag ``cue``.

        Whatever the flag is, policy and world get the same random numbers. ``wrap`` wraps the
        policy, ``make`` makes copies of a world. World, ``repetitions`` and ``seed`` are by default
        the run's.
        """

        def reseed(seed: int) -> None:
            if isinstance(policy, SequenceQLearning):
                policy.policy.seed(seed)

        return collect_rollouts(
            make or partial(make_world, scenario or self.scenario),
            wrap(self.as_joint_policy(policy)),
            method=name,
            seed=self.settings.seed if seed is None else seed,
            repetitions=repetitions or self.settings.repetitions,
            cue=cue,
            reseed=reseed,
        )

    def simulate(
        self,
        *,
        split: str | None = "test",
        repetitions: int = 5,
        condition: Condition = "demo",
        flag: Cue = "actual",
        seed: int | None = None,
        reading: Reading = "habit",
        wrap: Callable[[Policy], Policy] = lambda policy: policy,
        **options: Any,
    ) -> Rollouts:
        """Simulate the individuals that learned, in the run's world or in a changed one.

        Rollouts of one seed meet the same random numbers, whatever the options, so that two of them
        differ by what was changed alone.

        Raises InputError if an option is unknown, or changes what the policy is shown.

        Parameters
        ----------
        split
            Episodes start from each demonstration of it; None: of all.
        repetitions
            Rollouts from each start.
        condition
            0, 1, or that of each demonstration.
        flag
            The condition flag that the policy gets, if it learned with one.
        seed
            By default that of the run.
        reading
            What the policy perceives where the options change motion or place: ``"habit"``, the
            same inputs as ever for the same places and velocities; ``"knows"``, its own motion in
            units of its changed body (:data:`animarl_envs.species.base.Reading`).
        wrap
            Wraps the policy, such as by one that counts its inputs.
        options
            Of the species, as :func:`~animarl_envs.species.options.with_options` takes them, such
            as ``locomotion={"prey": 1.2}``, ``contact_radius=0.05`` or ``time_limit=300``.
        """
        if changed := run_world.changed_inputs(self.species, options):
            raise InputError(
                f"{changed} changes the inputs of the policy, which has not learned with it: "
                "train a run with it"
            )
        species = change_world(self.species, reading, **options)
        return self.roll_out(
            self.policy,
            method_name(self.settings.algo),
            flag if self.has_condition_flag else None,
            scenario=self.starting_from(split, condition, species=species),
            repetitions=repetitions,
            seed=seed,
            wrap=wrap,
        )

    @property
    def has_condition_flag(self) -> bool:
        """Whether the policy has a condition flag among its inputs."""
        return self.policy.layout.condition_flag

    @property
    def learned_individuals(self) -> tuple[str, ...]:
        """The individuals that a policy was learned for: all of them, or ``focal`` alone."""
        focal = self.settings.focal
        return self.species.individuals if focal is None else (focal,)

    def action_values(self, episode: int, split: str = "test") -> Floats:
        """Return the policy's Q-values along a recorded episode ``(steps, individuals, actions)``.

        Everybody moves as recorded; the values are those before each step, given the observations
        and actions so far. Individuals are :attr:`learned_individuals`; the last action coasts, the
        others are directions from the focus, the largest thrust first
        (:data:`animarl_envs.locomotion.ACTION_VECTORS`). ``episode`` is its number in ``split``,
        the column ``demo`` of all tables.

        Raises InputError if there is no such episode, or the run is not trained.
        """
        demos = self.demos.select(split=split)
        if not 0 <= episode < len(demos):
            raise InputError(
                f"{self.path}: there is no {split} episode {episode}: choose one of 0 to "
                f"{len(demos) - 1}"
            )
        one, policy = demos.select(episodes=[episode]), self.policy
        columns = [one.individuals.index(name) for name in self.learned_individuals]
        observations = demonstration_observations(self.species, one)[:, columns]
        if self.has_condition_flag:
            flag = np.full((*observations.shape[:2], 1), one.condition[0], dtype=np.float32)
            observations = np.concatenate([observations, flag], axis=2)
        actions = demonstrated_actions(one, self.species.locomotion).astype(np.int64)[:, columns]
        values, state = [], None
        for t in range(len(observations) - 1):
            q_values, memory, _ = policy.policy.advance(
                observations[t], state, np.zeros(len(columns), dtype=bool)
            )
            values.append(q_values)
            state = (memory, np.maximum(actions[t], 0))
        return np.array(values, dtype=np.float64)

    def what_if(
        self, *changes: str, fold: int | None = None, second: bool = False, **options: Any
    ) -> WhatIf:
        """Ask what would happen in a changed world; see :func:`animarl_algos.whatif.answer.ask`.

        Of a run that was cross-validated, the simulators of all folds answer together; ``fold=1``
        asks that of the run alone. ``second=True`` asks a second simulator too, as the command
        does by default: it is trained once, in minutes, and kept. ``changes`` are written as
        ``prey.speed=+20%``; ``options`` are those of ``ask``.
        """
        from animarl_algos.runs.permuted import second_run
        from animarl_algos.runs.run_set import ensemble
        from animarl_algos.whatif.answer import ask

        other = second_run(self, changes, print) if second else None
        return ask(ensemble(self, fold), changes, second=other, **options)


def _cue(model: SequenceQLearning) -> Cue | None:
    """Return the condition flag of rollouts that are compared with recordings."""
    return "actual" if model.layout.condition_flag else None


def method_name(algo: str) -> str:
    """Return the name of a learner in tables and figures."""
    return algo.upper()


def _as_json(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))
