"""``animarl watch --beside``: the recording left, the simulation from the same start right."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.cli.watch_actors import Actor, idle_actor
from animarl_envs.drawing.render import Renderer
from animarl_envs.drawing.scene import Scene, SceneRecorder
from animarl_envs.errors import InputError
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World

HOLD = 1.0  # the last picture of an episode stays for this time [s]


def recorded_world(world: World) -> World:
    """A world of one copy in which everybody replays what was recorded.

    Raises
    ------
    InputError
        If episodes do not start from demonstrations.
    """
    scenario = world.scenario
    if not scenario.paired:
        raise InputError("nothing was recorded to show beside: give demonstrations by --demos")
    replaying = replace(scenario, drivers=("replay",) * len(scenario.names))
    return make_world(replaying, 1)


def play_beside(
    world: World,
    actor: Actor,
    renderer: Renderer,
    *,
    episodes: int = 1,
    steps: int | None = None,
    endings: list[str] | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Iterator[NDArray[np.uint8]]:
    """Pictures ``(height, 2 width, 3)`` of episodes; who has ended waits for the other.

    Parameters as of :func:`animarl_algos.cli.watch.play`; the renderer makes arrays.
    """
    recorded = recorded_world(world)
    assert world.demos is not None
    for _ in range(episodes):
        world.reset()
        recorded.reset(demo=world.demo.copy())
        sides = (_Side(recorded, idle_actor, "recorded"), _Side(world, actor, "simulated"))
        last = int(world.demos.lengths[int(world.demo[0])]) - 1
        limits = (last if steps is None else min(last, steps), steps)
        while True:
            picture = np.concatenate([side.picture(renderer) for side in sides], axis=1)
            yield picture
            moved = [side.step(limit) for side, limit in zip(sides, limits, strict=True)]
            if not any(moved):
                break
            on_step()
        if endings is not None:
            scenes = [side.recorder.scene() for side in sides]
            endings.append("; ".join(_ending(s, c) for s, c in zip(sides, scenes, strict=True)))
        for _ in range(round(HOLD * renderer.fps)):
            yield picture


class _Side:
    """One of the two worlds, with whoever acts in it."""

    def __init__(self, world: World, actor: Actor, name: str) -> None:
        self.world, self.actor, self.name = world, actor, name
        self.recorder, self.begins = SceneRecorder(world), True
        self.recorder.start()

    def picture(self, renderer: Renderer) -> NDArray[np.uint8]:
        scene = self.recorder.scene()
        drawn = renderer.draw(replace(scene, title=f"{scene.title}, {self.name}"))
        assert drawn is not None
        return drawn

    def step(self, limit: int | None) -> bool:
        """Go on, unless the episode has ended or has had so many steps; whether it did."""
        world = self.world
        over = bool(world.terminated[0] or world.truncated[0])
        if over or (limit is not None and world.step_count[0] >= limit):
            return False
        world.step(self.actor(world, self.begins))
        self.recorder.follow()
        self.begins = False
        return True


def _ending(side: _Side, scene: Scene) -> str:
    return f"{side.name} {scene.note or 'stopped'} after {scene.time:.1f} s"
