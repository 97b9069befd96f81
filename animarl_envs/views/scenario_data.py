"""A scenario as plain data, for ``info["scenario"]`` at reset."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from animarl_envs.scenario import Scenario
from animarl_envs.species import SearchSpecies


def scenario_as_data(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain data, for ``info["scenario"]`` at reset.

    All numbers of the species under their names (``species`` is its name), and the options of
    :class:`Scenario`; what is infinite or cannot be written as plain data is a text.
    """
    spec, demos = scenario.species, scenario.demos
    numbers = {
        field.name: plain(getattr(spec, field.name))
        for field in fields(spec)
        if field.name not in ("name", "version_history")
    }
    if isinstance(spec, SearchSpecies) and not isinstance(spec.plume, str):
        numbers["plume"] = {"kind": type(spec.plume).__name__} | numbers["plume"]
    return numbers | {
        "species": spec.name,
        "drivers": list(scenario.drivers),
        "condition": scenario.condition,
        "start": plain(scenario.start),
        "demonstrations": None if demos is None else demos.name,
        "episodes": 0 if demos is None else len(demos),
        "split": scenario.split,
        "observation_noise": scenario.observation_noise,
        "observation_delay": scenario.observation_delay,
    }


def plain(value: Any) -> Any:
    """Numbers, texts, lists and dictionaries that say the same; an array of frames by its shape."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist()) if value.ndim <= 2 else f"array of shape {value.shape}"
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | None) else str(value)
