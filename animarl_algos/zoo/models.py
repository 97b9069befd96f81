"""Trained models in zip files of stable-baselines3: read, and compared with an environment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gymnasium.spaces import Discrete
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import SlotLayout, refuse_other_actions, refuse_other_slots
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import named_recipe
from animarl_envs.errors import InputError


def load_model(algo: str, path: Path) -> SequenceQLearning:
    """A model of ``algo`` from a zip file, which holds pickles.

    Raises
    ------
    InputError
        If the file is damaged or of another algorithm.
    """
    with reading_model(algo, path):
        return named_recipe(algo).algorithm.load(path, device="cpu")


@contextmanager
def reading_model(algo: str, path: Path) -> Iterator[None]:
    """Whatever goes wrong within, said in one sentence.

    Raises
    ------
    InputError
        If anything does.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # reading damaged pickles can raise any
        first_line = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: it is no model of {algo} ({first_line}): name one that 'train' saved with "
            "this --algo and --env"
        ) from error


def check_fit(model: SequenceQLearning, env: VecEnv, path: Path) -> None:
    """Compare what a model was trained with to an environment.

    Raises
    ------
    InputError
        If the individuals, what they observe or their actions differ.
    """
    mine, here = model.observation_space.shape, env.observation_space.shape
    learned, layout = model.layout, SlotLayout.of(env)
    if mine != here or learned.num_individuals != layout.num_individuals:
        raise InputError(
            f"{path}: it was trained with {learned.num_individuals} individuals that observe "
            f"{mine}, this environment has {layout.num_individuals} that observe {here}: give the "
            "--env and --algo it was trained with"
        )
    try:
        refuse_other_slots(layout, learned)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if isinstance(env.action_space, Discrete):
        refuse_other_actions(model.policy.num_actions, int(env.action_space.n))
