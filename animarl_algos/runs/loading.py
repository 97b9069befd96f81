"""A finished run in Python: its policy, its world, its demonstrations, and what-if questions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.collect import Cue, Policy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.runs.acting import for_all
from animarl_algos.runs.pretrained import model_folder
from animarl_algos.runs.rolling_out import method_name, trained_model
from animarl_algos.runs.run_folder import RunFolder
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import Condition, Scenario, make_scenario
from animarl_envs.species import Species
from animarl_envs.species.options import change_world, with_options
from animarl_envs.species.scales import Reading
from animarl_envs.worlds import make_world, observation_components
from animarl_envs.worlds.base import ObservationComponent

if TYPE_CHECKING:
    from animarl_algos.whatif.answer import WhatIf

SEEN_OTHERWISE = (
    "num_pursuers", "num_targets", "lone_pursuer", "individuals", "observation", "senses_heading",
)  # fmt: skip
"""Options that say who is there and what is shown of them; others may change it, too."""


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """What :func:`load_run` gives.

    Parameters
    ----------
    folder
        The run.
    policy
        The trained learner, with stable-baselines3's ``predict``; it acts as it does in tests.
    scenario
        The world of the run, with the fitted locomotion, from the starts of its test split.
    demos
        The demonstrations of all splits.
    """

    folder: RunFolder
    policy: SequenceQLearning
    scenario: Scenario
    demos: Demonstrations

    @property
    def told_condition(self) -> bool:
        """Whether the policy was told the condition in training, and so can be told another."""
        return self.policy.layout.condition_flag

    def simulate(
        self,
        *,
        split: str = "test",
        repetitions: int = 5,
        condition: Condition = "demo",
        told: Cue = "actual",
        seed: int | None = None,
        reading: Reading = "habit",
        wrap: Callable[[Policy], Policy] | None = None,
        **options: Any,
    ) -> Rollouts:
        """Let the policy drive everybody who learned, in the run's world or in another one.

        Rollouts of one seed meet the same random numbers, whatever the options, so that two of them
        differ by what was changed alone.

        Parameters
        ----------
        split
            Episodes start from each demonstration of it.
        repetitions
            Rollouts from each start.
        condition
            0, 1, or that of each demonstration.
        told
            Which condition the policy is told, where it learned with a flag.
        seed
            By default that of the run.
        reading
            What the policy perceives where the options change motion or place: ``"habit"``, the
            same inputs as ever for the same places and velocities; ``"knows"``, its own motion in
            units of its changed body (:data:`animarl_envs.species.scales.Reading`).
        wrap
            Returns what acts in the policy's place, such as a policy that counts what it sees.
        options
            Of the species, as :func:`~animarl_envs.species.options.with_options` takes them, such
            as ``locomotion={"prey": 1.2}``, ``contact_radius=0.05`` or ``time_limit=300``.

        Raises
        ------
        InputError
            If an option is unknown, or changes what the policy is shown.
        """
        if otherwise := seen_otherwise(self.scenario.species, options):
            raise InputError(
                f"{otherwise} changes what the policy is shown, who has not learned from that: "
                "train a run with it"
            )
        seed = self.folder.settings.seed if seed is None else seed
        before = self.scenario
        names = before.names
        scenario = make_scenario(
            change_world(before.species, reading, **options),
            demos=self.demos,
            split=split,
            condition=condition,
            drivers=dict(zip(names, before.drivers, strict=True)),
            observation_noise=before.observation_noise,
            observation_delay=before.observation_delay,
        )
        acting = for_all(self.policy, names, self.folder.settings.focal)
        return collect_rollouts(
            partial(make_world, scenario),
            acting if wrap is None else wrap(acting),
            method=method_name(self.folder.settings.algo),
            seed=seed,
            repetitions=repetitions,
            cue=told if self.policy.layout.condition_flag else None,
            reseed=self.policy.policy.seed,
        )

    def what_if(self, *changes: str, **options: Any) -> WhatIf:
        """Ask what would happen in a changed world; see :func:`animarl_algos.whatif.answer.ask`.

        ``changes`` are written as ``prey.speed=+20%``; ``options`` are those of ``ask``.
        """
        from animarl_algos.whatif.answer import ask

        return ask([self], changes, **options)


def seen_otherwise(species: Species, options: Mapping[str, Any]) -> str:
    """The option under which a policy of ``species`` would be shown something else, if any.

    Of several that do so only together all are named.

    Raises
    ------
    InputError
        If an option is unknown.
    """
    found = [key for key in SEEN_OTHERWISE if key in options]
    if found:
        return found[0]
    shown = observation_components(species)
    if _named(observation_components(with_options(species, **options))) == _named(shown):
        return ""
    for key, value in options.items():
        with suppress(InputError):  # one that needs another beside it
            alone = with_options(species, **{key: value})
            if _named(observation_components(alone)) != _named(shown):
                return key
    return " with ".join(options)


def _named(components: Iterable[ObservationComponent]) -> list[tuple[str, str, str]]:
    return [(one.name, one.frame, one.unit) for one in components]


def load_run(folder: str | Path) -> LoadedRun:
    """Return the trained policy of a run, its world and its demonstrations.

    ``folder`` is a run's folder, that of an exported model, or the name of a packaged one
    (``"fly"``).

    Raises
    ------
    InputError
        If there is neither, or no trained policy yet.
    """
    run = RunFolder(model_folder(folder))
    policy = trained_model(run, run.settings.algo)
    return LoadedRun(run, policy, run.scenario("test"), run.demos)
