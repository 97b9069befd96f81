"""The species, by name."""

import re
from typing import Any

from animarl_envs.errors import InputError
from animarl_envs.species.agent import AGENT
from animarl_envs.species.base import COMPACT, Recording, Species
from animarl_envs.species.chase import ChaseSpecies
from animarl_envs.species.fly import FLY
from animarl_envs.species.newt import NEWT
from animarl_envs.species.search import SearchSpecies
from animarl_envs.species.shoal import SHOAL
from animarl_envs.species.silkmoth import SILKMOTH
from animarl_envs.species.solo import SOLO

SPECIES: dict[str, Species] = {s.name: s for s in (AGENT, FLY, NEWT, SILKMOTH, SOLO, SHOAL)}

CUSTOM = "custom"
"""Name of a species made from demonstrations, by :mod:`animarl_envs.fitting.custom_species`."""

TASKS: dict[str, dict[str, Any]] = {
    "agent": {"rebound": True, "locomotion": {"prey": 1.3}},  # as much faster as in simple_tag
    "fly": {"contact_radius": 0.1, "locomotion": {"female": 1.15}},
    "silkmoth": {"start": "uniform", "start_region": (-0.1, 0.4, 0.25)},
}
"""What the views change of a species by default, so that one constant action does not solve its
task; :func:`animarl_envs.views.common.task_options` has what they change of all."""

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "SilkmothMemory": ("silkmoth", {"observation": "odour"}),
}
"""Ids ``AnimaRL/SilkmothMemory-v0`` and the like: the species, and the options that make them."""

__all__ = [
    "AGENT", "COMPACT", "CUSTOM", "FLY", "NEWT", "SHOAL", "SILKMOTH", "SOLO", "SPECIES", "TASKS",
    "VARIANTS", "ChaseSpecies", "Recording", "SearchSpecies", "Species", "get_species",
    "resolve_variant", "species_name",
]  # fmt: skip


def species_name(text: str) -> str:
    """Return the name in a name or an id: ``"AnimaRL/Newt-v0"`` and ``"Newt"`` are ``"newt"``."""
    return re.sub(r"^(animarl_envs:)?AnimaRL/|-v\d+$", "", text).lower()


def resolve_variant(
    species: Species | str, options: dict[str, Any]
) -> tuple[Species | str, dict[str, Any]]:
    """Return the species and all options of an environment that may be one of ``VARIANTS``."""
    name = species_name(species) if isinstance(species, str) else ""
    known = {variant.lower(): what for variant, what in VARIANTS.items()}
    base, own = known.get(name, (species, {}))
    return base, own | options


def get_species(name: str) -> Species:
    """Return the species of a name or an id, or raise with a sentence that lists the names."""
    try:
        return SPECIES[species_name(name)]
    except KeyError:
        raise InputError(
            f"species {name!r} is unknown: choose one of {', '.join([*SPECIES, CUSTOM])}"
        ) from None
