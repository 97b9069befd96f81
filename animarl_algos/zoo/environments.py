"""Environments for rl_zoo3: all individuals learn; scores come from the validation split."""

from __future__ import annotations

import warnings
from typing import Any

from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from animarl_algos.data.slots import MixedMeansWarning
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.runs.run_settings import environment_options

NOT_SLOTS = ("others", "render_mode")
"""Options of a single environment that the slot VecEnv has not."""


def species_of_id(env_id: str) -> str | None:
    """Return the species of an AnimaRL id, None for any other environment that is registered."""
    species = environment_options(env_id).get("species")
    return species if isinstance(species, str) else None


def slot_environment(
    env_id: str, copies: int, *, split: str = "train", **options: Any
) -> SlotVecEnv:
    """Return the slot VecEnv of an AnimaRL id; ``options`` win over its registered ones.

    The condition is the last observation component if the species has conditions and the
    demonstrations hold both.
    """
    registered = {k: v for k, v in environment_options(env_id).items() if k not in NOT_SLOTS}
    options = {"condition_flag": None} | registered | options
    return SlotVecEnv(options.pop("species"), copies, split=split, **options)


def validation_environment(env_id: str, copies: int, **options: Any) -> VecEnv:
    """Return what policies are scored in: episodes of the validation split, :class:`Scored`."""
    options["dtw"] = "closeness"  # whatever the learner is paid for, scores are comparable
    slots = Scored(slot_environment(env_id, copies, split="val", **options))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixedMeansWarning)  # the score is a mean over all
        return VecMonitor(slots)


class Scored(VecEnvWrapper):
    """Pays the task reward and up to 1 a step for closeness to the recorded path.

    An episode's return is what it achieved, and how much of its recording it followed
    (:mod:`animarl_envs.dtw`), per individual: the score by which rl_zoo3 picks the best model and
    optuna the best settings. (A score by the distance alone is best for whoever ends at once.)
    Without demonstrations it is the task return.
    """

    venv: SlotVecEnv

    def reset(self) -> VecEnvObs:
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = self.venv.step_wait()
        if "dtw_penalty" in self.venv.extras:
            rewards = rewards - self.venv.extras["dtw_penalty"]
        return observations, rewards, dones, infos
