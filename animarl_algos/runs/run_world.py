"""The world of a run: what its options (``env_kwargs``) say of training, of evaluation and of both.

Whatever changes the world holds wherever the run's policies act: in training, in evaluation, when
watched. What belongs to training alone (how demonstrations are labelled, the distance penalty, from
where and in which condition training episodes start) does not: policies are evaluated from the
start of every test demonstration, in its condition.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from animarl_algos.data.vec_env import OWN_OPTIONS, SCENARIO_OPTIONS
from animarl_envs.arena import format_obstacle
from animarl_envs.cells import CellLocomotion
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import COUNTS, first_of_role
from animarl_envs.errors import InputError
from animarl_envs.species import Species
from animarl_envs.species.options import with_options
from animarl_envs.worlds import observation_components

CELLS = "cells"
SENSES = ("observation_noise", "observation_delay")
CHANGES_INPUTS = (
    "num_pursuers",
    "num_targets",
    "lone_pursuer",
    "individuals",
    "observation",
    "senses_heading",
    "neighbours",
    "free",
)
"""Options that say who is there and what is shown of them; others may change it, too."""


def select_individuals(demos: Demonstrations, options: Mapping[str, Any]) -> Demonstrations:
    """Return demonstrations of the first pursuers or targets alone where the world has fewer."""
    for key in COUNTS:
        if options.get(key) is not None:
            demos = first_of_role(demos, key, options[key])
    return demos


def species_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that change the species, after :func:`select_individuals`."""
    others = (*SCENARIO_OPTIONS, *OWN_OPTIONS, *COUNTS, CELLS)  # cells are in the fit
    return {key: value for key, value in options.items() if key not in others}


def world_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that every world of the run has, beside those of its species."""
    return {key: options[key] for key in SENSES if key in options}


def training_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of the training environment beside those of its species."""
    return {key: options[key] for key in (*SCENARIO_OPTIONS, *OWN_OPTIONS) if key in options}


def world_in_words(species: Species) -> dict[str, str]:
    """Return what decides how episodes go in a world, to print: name and value."""
    arena = species.arena
    edge = "walls" if arena.rebound else f"out of bounds beyond {arena.boundary:g}"
    field = "open" if arena.shape == "open" else f"{arena.shape}, {arena.size:g}, {edge}"
    for obstacle in arena.obstacles:
        field += f"; obstacle {format_obstacle(obstacle)}"
    return {
        "individuals": ", ".join(species.individuals),
        "arena": field,
        "contact radius": f"{species.contact_radius:g} {species.length_unit}s",
        "time limit": f"{species.time_limit} steps ({species.time_limit * species.dt:g} s)",
        "time step": f"{species.dt:g} s",
        "warm-up": f"{species.warmup} steps",
        "mirror images": "as likely as the recordings"
        if species.mirror_symmetric
        else "not used: left and right are not alike in the recordings",
    } | {
        f"locomotion of {name}": f"{motion.num_actions} cells of recorded velocities"
        if isinstance(motion, CellLocomotion)
        else f"d {motion.damping:.4g}, u {motion.thrust:.4g}, thrusts "
        + ", ".join(f"{m:g}" for m in motion.magnitudes)
        for name, motion in zip(species.individuals, species.locomotion)
    }


def changed_inputs(species: Species, options: Mapping[str, Any]) -> str:
    """Return the option under which a policy of ``species`` is shown something else, if any.

    Of several that do so only together all are named. Raises InputError if an option is unknown.
    """
    for key in CHANGES_INPUTS:
        if key in options:
            return key

    def inputs(given: Mapping[str, Any]) -> list[tuple[str, str, str]]:
        components = observation_components(with_options(species, **given))
        return [(one.name, one.frame, one.unit) for one in components]

    if inputs(options) == inputs({}):
        return ""
    for key, value in options.items():
        with suppress(InputError):  # one that needs another beside it
            if inputs({key: value}) != inputs({}):
                return key
    return " with ".join(options)
