"""Chases in which bodies do not point where they walk, their headings made by known rules."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from recordings import dogs

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.turning import along_travel
from animarl_envs.species import ChaseSpecies
from animarl_envs.species.options import with_options
from animarl_envs.species.turning import Turning

SIDEWAYS = Turning(persistence=0.4, gain=0.6, slip=-0.5, speed=0.8)
SLOW = Turning(persistence=0.2, gain=0.3, slip=0.3, speed=0.5)


def turned(demos: Demonstrations, *rules: Turning | None, noise: float = 0.0) -> Demonstrations:
    """The same recordings with headings by these rules and noise; along the travel for none."""
    rng, velocity = np.random.default_rng(0), demos.velocities()
    heading = np.zeros(demos.positions.shape[:2])
    for i, rule in enumerate(rules):
        if rule is None:
            lone = replace(demos, signals={"heading": heading})
            heading[:, i] = along_travel(lone, i)
            continue
        for start, stop in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
            angle, turn = rng.uniform(-math.pi, math.pi), 0.0
            for t in range(start, stop):
                if t > start:
                    turn = float(rule.next_turn(np.array(turn), np.array(angle), velocity[t, i]))
                    turn += noise * rng.standard_normal()
                    angle += turn
                heading[t, i] = angle
    return replace(demos, signals={"heading": heading % (2 * np.pi)})


@cache
def wanderers() -> Demonstrations:
    """Two animals that wander for twelve episodes, at the median speeds of the two rules."""
    rng = np.random.default_rng(0)
    velocity = np.zeros((12, 150, 2, 2))
    for t in range(1, 150):
        velocity[:, t] = 0.85 * velocity[:, t - 1] + rng.normal(size=(12, 2, 2))
    speeds = np.linalg.norm(velocity, axis=-1)
    for i, rule in enumerate((SIDEWAYS, SLOW)):
        velocity[:, :, i] *= rule.speed / np.median(speeds[:, :, i][speeds[:, :, i] > 0])
    positions = np.cumsum(0.1 * velocity, axis=1)
    return replace(
        dogs(1), positions=positions.reshape(-1, 2, 2), lengths=np.full(12, 150),
        initial_velocity=velocity[:, 0], arena=Arena("open", float(np.abs(positions).max())),
        condition=np.zeros(12), outcome=np.zeros(12), signals={},
        split=np.resize(["train", "train", "val"], 12), recording=np.arange(12).astype(str),
    )  # fmt: skip


@cache
def recorded() -> Demonstrations:
    """Chases in which one dog and the sheep go sideways and the other dog straight ahead."""
    return turned(dogs(2), SIDEWAYS, None, SLOW, noise=0.05)


def species() -> ChaseSpecies:
    """That of the chases, with the rules that made them."""
    options: dict[str, Any] = {"turning": (SIDEWAYS, None, SLOW), "senses_heading": True}
    spec = with_options(species_of(dogs(2)), **options)
    assert isinstance(spec, ChaseSpecies)
    return spec
