"""The pictures of ``docs/environments/*.md``: the last scene of an episode of every species."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from custom_species import HERDING

import animarl_envs
from animarl_algos.cli.watch import idle_actor, prepare
from animarl_envs.drawing.render import Renderer
from animarl_envs.drawing.scene import SceneRecorder
from animarl_envs.files import write_then_rename
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES, Species
from animarl_envs.worlds import make_world

IMAGES = Path(__file__).parent / "images"
SEEDS = {"agent": 5, "fly": 0, "newt": 0, "silkmoth": 3}


def picture(species: Species, seed: int) -> np.ndarray:
    """The last scene of an episode of recorded, scripted or programmed animals."""
    if species.name in SPECIES:
        world, actor = prepare(animarl_envs.environment_id(species.name), seed=seed)
    else:
        drivers = dict.fromkeys(species.individuals, "scripted")
        world, actor = make_world(make_scenario(species, demos=None, drivers=drivers)), idle_actor
    world.seed([seed])
    world.reset()
    recorder, start = SceneRecorder(world), True
    recorder.start()
    while not (world.terminated[0] or world.truncated[0]):
        world.step(actor(world, start))
        recorder.follow()
        start = False
    drawn = Renderer("rgb_array").draw(recorder.scene())
    assert drawn is not None
    return drawn


def write_pictures() -> None:
    IMAGES.mkdir(exist_ok=True)
    for name, species in (SPECIES | {"custom": HERDING}).items():
        with write_then_rename(IMAGES / f"{name}.png") as part:
            imageio.imwrite(part, picture(species, SEEDS.get(name, 0)), optimize=True)
