"""AnimaRL environments: recorded animals as a Gymnasium environment suite.

Importing this package registers the animals' worlds with Gymnasium: ``AnimaRL/Agent-v0``,
``AnimaRL/Fly-v0``, ``AnimaRL/Newt-v0``, ``AnimaRL/Silkmoth-v0``, ``AnimaRL/Solo-v0``,
``AnimaRL/Shoal-v0`` and, for your own demonstrations, ``AnimaRL/Custom-v0``. It also registers the
tasks for reinforcement learning, such as ``AnimaRL/FlyTask-v0`` (:mod:`animarl_envs.tasks`);
``parallel_env("agent")`` is the same world with all individuals acting, as a PettingZoo
environment, which is registered there too: ``pettingzoo.make("parallel", "AnimaRL/Agent-v0")``.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import pettingzoo

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.species import CUSTOM, SPECIES, Species, species_name
from animarl_envs.tasks import TASKS

if TYPE_CHECKING:
    from animarl_envs.views import AnimalParallelEnv

__version__ = "0.1.0"
__all__ = ["SPECIES", "InputError", "MissingExtraError", "environment_id", "parallel_env"]


def environment_id(species: str) -> str:
    """Return the id of a species or a task, such as ``AnimaRL/Agent-v0``, by its name or id."""
    name, tasks = species_name(species), {name.lower(): name for name in TASKS}
    return f"AnimaRL/{tasks.get(name, name.capitalize())}-v0"


def parallel_env(species: Species | str, **options: Any) -> AnimalParallelEnv:
    """Return all individuals of a species or a task, or of ``"custom"`` demonstrations."""
    from animarl_envs.views import AnimalParallelEnv

    return AnimalParallelEnv(species, **options)


def __getattr__(name: str) -> Any:
    """Return ``newt_v0`` and the like, with ``parallel_env`` and ``env`` as PettingZoo has them."""
    species, _, version = name.rpartition("_")
    if version != "v0" or species not in (*SPECIES, CUSTOM):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from pettingzoo.utils import parallel_to_aec

    make = partial(parallel_env, species)
    return SimpleNamespace(
        parallel_env=make, env=lambda **options: parallel_to_aec(make(**options))
    )


def _register() -> None:
    for name in (*SPECIES, CUSTOM, *TASKS):
        env_id, options = environment_id(name), {"species": name}
        gym.register(
            id=env_id,
            entry_point="animarl_envs.views.single:AnimalEnv",
            vector_entry_point="animarl_envs.views.vector:AnimalVectorEnv",
            kwargs=options,
        )
        if hasattr(pettingzoo, "register"):  # from version 1.27 on
            pettingzoo.register(
                "parallel",
                id=env_id,
                entry_point="animarl_envs.views.parallel:AnimalParallelEnv",
                kwargs=options,
            )


_register()
