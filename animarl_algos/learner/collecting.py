"""One step of acting: choose, step the environment, store, and forget where episodes ended."""

from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.vec_env import Feedback, SlotLayout
from animarl_algos.losses.terms import Recipe
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import GruPolicy, State
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError


class Collector:
    """Acts in a VecEnv by a policy and stores each step in the replay memory."""

    def __init__(self, policy: GruPolicy, env: VecEnv, layout: SlotLayout, recipe: Recipe) -> None:
        self._policy, self._env, self._layout, self._recipe = policy, env, layout, recipe
        self._feedback = Feedback(env)

    def step(
        self,
        buffer: SequenceReplayBuffer,
        observation: NDArray[Any],
        memory: State,
        *,
        at_random: bool = False,
    ) -> tuple[Any, Any, Any, Any, list[dict[str, Any]], State]:
        """Make one step of all slots from ``observation`` and store it in ``buffer``.

        Actions are chosen by the policy's acting rule, or uniformly ``at_random``. Returns them,
        observations, rewards and dones, each ``(S, ...)``, infos, and the memory before the next
        step; where an episode ended, observation and memory are of the next one.
        """
        policy, feedback, rule = self._policy, self._feedback, self._policy.acting
        if at_random:
            policy.acting = Acting.epsilon_greedy(1.0)
        try:
            actions, (hidden, _) = policy.predict(observation, memory)
        finally:
            policy.acting = rule
        new, rewards, dones, infos = self._env.step(actions)
        new = np.array(new)  # an environment may overwrite its own
        feedback.update(infos)
        executed = feedback.executed(actions)
        successors = new.copy()  # where a slot is done, ``new`` is the next episode's first
        for s in np.flatnonzero(dones):
            successors[s] = infos[s]["terminal_observation"]
        layout, recipe = self._layout, self._recipe

        def by_copy(values: Any) -> Any:
            """(S, ...) as (copies, K, ...), if there are any."""
            shape = (layout.num_copies, layout.num_individuals, *np.shape(values)[1:])
            return None if values is None else np.reshape(values, shape)

        names = ("task_reward", "dtw_penalty", "aligned_action", "warmup", "condition")
        given = {name: by_copy(feedback.get(name)) for name in names}
        for name, needed in (
            ("dtw_penalty", recipe.needs_distance),
            ("aligned_action", recipe.needs_alignment),
        ):
            if needed and given[name] is None:
                raise InputError(f"the environment declares {name!r} and gave none with a step")
        done = by_copy(dones)[:, 0]
        if not (by_copy(dones) == done[:, None]).all():
            raise InputError(
                "the individuals of a copy ended at different steps: an episode must end for all "
                "of its slots together"
            )
        timed_out = by_copy([info.get("TimeLimit.truncated", False) for info in infos])
        truncated = done & timed_out[:, 0].astype(bool)
        seen = by_copy(observation.reshape(len(dones), -1))
        task, warmup, condition = (given[n] for n in ("task_reward", "warmup", "condition"))
        if condition is None and layout.condition_flag:
            condition = seen[..., -1]
        buffer.add(
            observations=seen,
            actions=by_copy(executed),
            rewards=by_copy(rewards) if task is None else task,
            next_observations=by_copy(successors.reshape(len(dones), -1)),
            terminated=done & ~truncated,
            truncated=truncated,
            penalties=given["dtw_penalty"],
            labels=given["aligned_action"],
            warmup=None if warmup is None else warmup[:, 0],
            hidden=by_copy(memory[0]),
            condition=None if condition is None else condition[:, 0],
        )
        previous = executed.astype(np.int64)
        # episodes that begin have no memory and no previous action
        hidden[dones], previous[dones] = 0.0, policy.num_actions
        return actions, new, rewards, dones, infos, (hidden, previous)


# -- exploration ----------------------------------------------------------------------------------

LOG_TEMPERATURE_SD = 0.5
"""How far the logarithm of a temperature lies from 0 before any action was looked at."""


class Exploration(StrEnum):
    """How online collection acts."""

    EPSILON = "epsilon"  # greedy but for a share of random actions (the paper)
    BOLTZMANN = "boltzmann"  # sampled at temperatures fitted after the offline phase


def boltzmann_nll(
    values: NDArray[np.floating], actions: NDArray[np.integer], temperature: float
) -> float:
    """Return the mean negative log-likelihood [nat] of ``actions`` (N,).

    Under ``softmax(values / temperature)``, ``values`` ``(N, A)`` being action values or logits.
    """
    scaled = values / temperature
    scaled = scaled - scaled.max(axis=1, keepdims=True)
    log_norm = np.log(np.exp(scaled).sum(axis=1))
    return float(np.mean(log_norm - scaled[np.arange(len(actions)), actions]))


def fit_boltzmann_temperature(values: NDArray[np.floating], actions: NDArray[np.integer]) -> float:
    """Return the likeliest temperature, searched over ten decades around the values' own spread.

    A priori its logarithm is normal around 0, the temperature of a clone's logits, with standard
    deviation ``LOG_TEMPERATURE_SD``. Some hundred actions outweigh that; but of a few that are all
    the same, as of animals at rest, the likelihood alone would have them never move again.

    The likelihood is unimodal in the inverse temperature (the log-likelihood of a one-parameter
    exponential family is concave), so a bounded scalar search finds it. Raises InputError if there
    is no demonstrated action to fit to, or the values are all equal.
    """
    if len(actions) == 0:
        raise InputError("no demonstrated action to fit a temperature to: give a larger dataset")
    values = values.astype(np.float64)
    spread = float(np.mean(values.std(axis=1)))
    if not spread > 0:
        raise InputError(
            "the action values are all equal or not finite: train before fitting a temperature"
        )
    result = minimize_scalar(
        lambda log_t: (
            len(actions) * boltzmann_nll(values, actions, spread * np.exp(log_t))
            + ((log_t + np.log(spread)) / LOG_TEMPERATURE_SD) ** 2 / 2
        ),
        bounds=(np.log(1e-5), np.log(1e5)),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return float(spread * np.exp(result.x))
