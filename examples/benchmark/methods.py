"""Methods of other libraries, and one of no library, as rows of the benchmark.

PYTHONPATH=examples/benchmark animarl benchmark --preset short --species agent \\
    --method ppo=methods:make_ppo --method rppo=methods:make_recurrent_ppo \\
    --method glide=methods:make_gliding
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO

from animarl_algos.benchmark.methods import MethodSetting
from animarl_envs.locomotion import next_velocity

STEPS = 100_000  # of slots: one individual of one copy


def make_ppo(setting: MethodSetting) -> PPO:
    """PPO on the task reward alone; one network for all individuals."""
    model = PPO("MlpPolicy", setting.environment(), n_steps=64, seed=setting.seed, device="cpu")
    return model.learn(STEPS)


def make_recurrent_ppo(setting: MethodSetting) -> RecurrentPPO:
    """The same with a memory.

    Its LSTM goes through every minibatch step by step, so that few and large ones save most of the
    time (80 s of a core, with sb3-contrib's defaults some 600) and bear a larger learning rate.
    """
    model = RecurrentPPO(
        "MlpLstmPolicy", setting.environment(), n_steps=64, batch_size=1024, learning_rate=1e-3,
        policy_kwargs={"lstm_hidden_size": 64}, seed=setting.seed, device="cpu",
    )  # fmt: skip
    return model.learn(STEPS)


def make_gliding(
    setting: MethodSetting,
) -> Callable[[NDArray[np.floating]], NDArray[np.int64]]:
    """Constant velocity as a plain callable: the action that changes the own velocity least."""
    species = setting.species
    names = [one.name for one in setting.environment().world.observation_components]
    ends = ("velocity ahead", "velocity left")
    columns = [next(i for i, name in enumerate(names) if name.endswith(end)) for end in ends]

    def act(observation: NDArray[np.floating]) -> NDArray[np.int64]:
        velocity = observation[:, columns].astype(np.float64)
        actions = np.empty(len(velocity), dtype=np.int64)
        for k, own in enumerate(species.locomotion):  # slot = copy * individuals + individual
            mine = velocity[k :: len(species.locomotion), None]
            after = next_velocity(
                mine, own.action_vectors[None], own.damping, own.thrust, species.dt
            )
            actions[k :: len(species.locomotion)] = np.linalg.norm(after - mine, axis=2).argmin(1)
        return actions

    return act
