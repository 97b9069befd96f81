"""Methods of other libraries as rows of the benchmark.

PYTHONPATH=examples/benchmark animarl benchmark --preset short --species agent \\
    --method ppo=methods:make_ppo --method rppo=methods:make_recurrent_ppo
"""

from __future__ import annotations

from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO

from animarl_algos.benchmark.methods import MethodSetting

STEPS = 100_000  # of slots: one individual of one copy


def make_ppo(setting: MethodSetting) -> PPO:
    """PPO on the task reward alone; one network for all individuals."""
    model = PPO("MlpPolicy", setting.environment(), n_steps=64, seed=setting.seed, device="cpu")
    return model.learn(STEPS)


def make_recurrent_ppo(setting: MethodSetting) -> RecurrentPPO:
    """The same with a memory."""
    model = RecurrentPPO(
        "MlpLstmPolicy", setting.environment(), n_steps=64, seed=setting.seed, device="cpu"
    )
    return model.learn(STEPS)
