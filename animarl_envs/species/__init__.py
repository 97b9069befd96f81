"""The species, by name."""

import re

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

__all__ = [
    "AGENT",
    "COMPACT",
    "CUSTOM",
    "FLY",
    "NEWT",
    "SHOAL",
    "SILKMOTH",
    "SOLO",
    "SPECIES",
    "ChaseSpecies",
    "Recording",
    "SearchSpecies",
    "Species",
    "get_species",
    "species_name",
]


def species_name(text: str) -> str:
    """Return the name in a name or an id: ``"AnimaRL/Newt-v0"`` and ``"Newt"`` are ``"newt"``."""
    return re.sub(r"^(animarl_envs:)?AnimaRL/|-v\d+$", "", text).lower()


def get_species(name: str) -> Species:
    """Return the species of a name or an id, or raise with a sentence that lists the names."""
    try:
        return SPECIES[species_name(name)]
    except KeyError:
        raise InputError(
            f"species {name!r} is unknown: choose one of {', '.join([*SPECIES, CUSTOM])}"
        ) from None
