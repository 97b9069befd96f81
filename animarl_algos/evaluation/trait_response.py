"""How strongly a clone responds to its traits, and the gains that make it respond enough.

A network learns from few animals, shrinks what it learns of their traits
(:mod:`animarl_envs.species.traits`), and so simulates animals that are too much alike. How much is
measured by rollouts: in each an individual gets the traits of some training animal, and what it
then does has traits of its own. The first on the second, by least squares, is the answer.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.acting_choice import ROLLOUTS
from animarl_algos.evaluation.collect import Cue, Policy, WrappedPolicy, collect_rollouts
from animarl_envs.array_types import Floats
from animarl_envs.species.traits import TRAITS, Traits, episode_traits
from animarl_envs.worlds.base import World

LARGEST_GAIN = 2.0  # with more, moths no longer find their source
MIN_RESPONSE = 0.2  # a weaker answer may be none, and nothing makes it one


class TraitRecorder(WrappedPolicy):
    """A policy that keeps the traits it observes in the first steps of episodes."""

    def __init__(self, policy: Policy, components: list[int]) -> None:
        super().__init__(policy)
        self._components = components
        self.given: list[NDArray[Any]] = []

    def predict(self, observation: NDArray[Any], **known: Any) -> tuple[Any, Any]:
        """Return the policy's actions and state."""
        if np.all(known["episode_start"]):
            self.given.append(observation[:, self._components].copy())
        return self.policy.predict(observation, **known)


def trait_components(world: World) -> list[int]:
    """Where in an observation the traits stand; empty if they are not observed."""
    return [i for i, c in enumerate(world.observation_components) if c.name in TRAITS]


def trait_gains(
    policy: Policy,
    make_world: Callable[[int], World],
    traits: Traits,
    *,
    seed: int,
    cue: Cue | None = None,
) -> Floats:
    """Return factors ``(2,)`` on the traits that make simulated animals differ as recorded ones.

    With an answer b and a variance r of what the traits do not explain, animals of n episodes that
    get g times their traits t differ by ``sqrt(b^2 g^2 var(t) + r / n)``, which is to be that of
    training animals. At least 1, at most ``LARGEST_GAIN``; 1 for a trait in which animals do not
    differ, or to which the policy does not answer. ``make_world`` is of the episodes to start from;
    its traits are those of training animals, drawn anew for each rollout.
    """
    probe = make_world(1)
    components, demos = trait_components(probe), probe.demos
    assert demos is not None  # collect_rollouts starts from them
    recorder = TraitRecorder(policy, components)
    made = collect_rollouts(
        make_world,
        recorder,
        method="traits",
        seed=seed,
        cue=cue,
        repetitions=max(1, round(ROLLOUTS / demos.num_episodes)),
    )
    given = np.concatenate(recorder.given).astype(np.float64)
    simulated = (
        episode_traits(made.positions, made.lengths, made.dt) - traits.centre[made.condition]
    )
    simulated = (simulated / traits.scale).reshape(-1, len(TRAITS))
    simulated -= simulated.mean(axis=0)
    given -= given.mean(axis=0)
    answer = np.diag(np.linalg.lstsq(given, simulated, rcond=None)[0])
    given_variance, wanted = given.var(axis=0), traits.table.reshape(-1, len(TRAITS)).var(axis=0)
    unexplained = simulated.var(axis=0) - answer**2 * given_variance
    unexplained *= len(np.unique(demos.recording)) / demos.num_episodes
    gains, answers = np.ones(len(TRAITS)), answer > MIN_RESPONSE
    needed = np.sqrt(np.maximum(wanted - unexplained, 0.0)[answers] / given_variance[answers])
    gains[answers] = np.clip(needed / answer[answers], 1.0, LARGEST_GAIN)
    return gains
