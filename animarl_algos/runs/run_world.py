"""The world of a run: what its options (``env_kwargs``) say of training, of evaluation and of both.

Whatever changes the world holds wherever the run's policies act: in training, in evaluation, when
watched. What belongs to training alone (how demonstrations are labelled, the distance penalty, from
where and in which condition training episodes start) does not: policies are evaluated from the
start of every test demonstration, in its condition.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from animarl_algos.data.options import OWN_OPTIONS, SCENARIO_OPTIONS, species_options
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.pursuers import COUNTS, first_of_role
from animarl_envs.species import Species

SENSES = ("observation_noise", "observation_delay")


def of_those_who_move(demos: Demonstrations, options: Mapping[str, Any]) -> Demonstrations:
    """The demonstrations, of the first pursuers or targets alone where the world has fewer."""
    for key in COUNTS:
        if options.get(key) is not None:
            demos = first_of_role(demos, key, options[key])
    return demos


def of_the_species(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options that change the species; of a species of :func:`of_those_who_move`."""
    return {key: value for key, value in species_options(options).items() if key not in COUNTS}


def in_the_world(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options that every world of the run has, beside those of its species."""
    return {key: options[key] for key in SENSES if key in options}


def of_the_training(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of the training environment beside its species, which has its own already."""
    return {key: options[key] for key in (*SCENARIO_OPTIONS, *OWN_OPTIONS) if key in options}


def world_in_words(species: Species) -> dict[str, str]:
    """What decides how episodes go in a world, to print: name and value."""
    arena = species.arena
    edge = "walls" if arena.rebound else f"out of bounds beyond {arena.boundary:g}"
    field = arena.shape if arena.shape == "open" else f"{arena.shape}, {arena.size:g}, {edge}"
    described = {
        "individuals": ", ".join(species.individuals),
        "arena": field,
        "contact radius": f"{species.contact_radius:g} {species.length_unit}s",
        "time limit": f"{species.time_limit} steps ({species.time_limit * species.dt:g} s)",
        "time step": f"{species.dt:g} s",
        "warm-up": f"{species.warmup} steps",
    }
    for name, motion in zip(species.individuals, species.locomotion):
        each = ", ".join(f"{m:g}" for m in motion.magnitudes)
        described[f"locomotion of {name}"] = (
            f"d {motion.damping:.4g}, u {motion.thrust:.4g}, thrusts {each}"
        )
    return described
