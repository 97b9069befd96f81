"""AnimaRL environments: recorded animals as a Gymnasium environment suite.

Importing this package registers ``AnimaRL/Agent-v0``, ``AnimaRL/Fly-v0``, ``AnimaRL/Newt-v0``,
``AnimaRL/Silkmoth-v0``, ``AnimaRL/Solo-v0``, ``AnimaRL/Shoal-v0`` and, for your own demonstrations,
``AnimaRL/Custom-v0`` with Gymnasium, and ``AnimaRL/SilkmothMemory-v0``, whose moth senses nothing
but the odour;
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
from animarl_envs.species import (
    CUSTOM,
    SPECIES,
    VARIANTS,
    Species,
    resolve_variant,
    species_name,
)

if TYPE_CHECKING:
    from animarl_envs.views import AnimalParallelEnv

__version__ = "0.1.0"
__all__ = ["SPECIES", "InputError", "MissingExtraError", "environment_id", "parallel_env"]


def environment_id(species: str) -> str:
    """The id of a species, such as ``AnimaRL/Agent-v0``, by its name or the id itself."""
    name, variants = species_name(species), {name.lower(): name for name in VARIANTS}
    return f"AnimaRL/{variants.get(name, name.capitalize())}-v0"


def parallel_env(species: Species | str, **options: Any) -> AnimalParallelEnv:
    """All individuals of a species, or of ``"custom"`` demonstrations, as a ``ParallelEnv``."""
    from animarl_envs.views import AnimalParallelEnv

    species, options = resolve_variant(species, options)
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
    ids = {environment_id(name): {"species": name} for name in (*SPECIES, CUSTOM)}
    for name, (species, own) in VARIANTS.items():
        ids[environment_id(name)] = {"species": species, **own}
    for name, options in ids.items():
        gym.register(
            id=name,
            entry_point="animarl_envs.views.single:AnimalEnv",
            vector_entry_point="animarl_envs.views.vector:AnimalVectorEnv",
            kwargs=options,
        )
        if hasattr(pettingzoo, "register"):  # from version 1.27 on
            pettingzoo.register(
                "parallel",
                id=name,
                entry_point="animarl_envs.views.parallel:AnimalParallelEnv",
                kwargs=options,
            )


_register()
