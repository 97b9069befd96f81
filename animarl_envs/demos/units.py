"""The unit that lengths are told in: that of the recordings, where somebody knows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.species import SPECIES

PHYSICAL_UNITS = ("um", "mm", "cm", "m", "inch")


@dataclass(frozen=True)
class Unit:
    """The unit that lengths are told in, and how many of it make one arena unit."""

    name: str
    per_arena_unit: float


RECORDED_SCALE = Unit("arena units", 1.0)
METRES = Unit("m", 1.0)


def unit_of(demos: Demonstrations) -> Unit:
    """The recordings' own unit where their provenance knows it, else the arena unit.

    Recordings with scales of their own are told in their mean scale. Of some species the arena
    unit is the metre.
    """
    species = SPECIES.get(demos.species)
    unscaled = METRES if species and species.length_unit == "metre" else RECORDED_SCALE
    name, scales = demos.provenance.get("unit"), demos.provenance.get("scales")
    if name not in PHYSICAL_UNITS or not isinstance(scales, Mapping) or not scales:
        return unscaled
    used = [_scale(scales[r]) for r in np.unique(demos.recording).tolist() if r in scales]
    return Unit(str(name), float(np.mean(used))) if used else unscaled


def _scale(record: Any) -> float:
    return float(record["unit"])
