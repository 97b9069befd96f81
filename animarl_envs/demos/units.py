"""The unit in which lengths are reported: that of the recordings, if it is known."""

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
    """The unit in which lengths are reported, and how many of it make one arena unit."""

    name: str
    per_arena_unit: float


RECORDED_SCALE = Unit("arena units", 1.0)
METRES = Unit("m", 1.0)


def unit_of(demos: Demonstrations) -> Unit:
    """Return the recordings' own unit if the provenance holds it, else the arena unit.

    If recordings have scales of their own, their mean is used. The arena unit of some species is
    the metre.
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
