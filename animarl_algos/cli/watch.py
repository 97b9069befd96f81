"""``animarl watch``: see an environment move, in a window or as a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import Progress

from animarl_algos.cli.reading import load, named_split
from animarl_algos.cli.screen import PlainConsole
from animarl_algos.cli.watch_actors import (
    Actor,
    idle_actor,
    load_trained,
    programmed_actor,
    trained_actor,
    trained_environment,
)
from animarl_algos.ranges import SEED
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing.render import CLIP_SUFFIXES, Renderer, write_clip
from animarl_envs.drawing.scene import SceneRecorder
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED, make_scenario
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World

HOLD = 1.0  # the last picture of an episode stays for this time [s]
PROGRAMMED = "programmed moth"  # the scripted rule that acts from outside of the world


Rule = Literal["demonstration", "script"]
"""What ``--by`` takes."""


def watch_command(
    env: Annotated[
        str | None,
        typer.Argument(help="Environment id, such as AnimaRL/Newt-v0; by default that of --model."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            help="Whose trained policy acts: a run's folder, or a packaged model by name, such as "
            "fly."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Clip to write, .gif or .mp4; without it, a window opens.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the episodes and the policies.")] = 0,
    acting: Annotated[
        str | None,
        typer.Option(
            help="How the policies of --model act: greedy, boltzmann:TEMPERATURE or "
            "epsilon:SHARE; by default as the run says."
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 1,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Most steps of an episode; by default to its end.")
    ] = None,
    focal: Annotated[
        str | None,
        typer.Option(help="The model drives this individual only: by default all that it learned."),
    ] = None,
    by: Annotated[
        Rule | None,
        typer.Option(
            help="What moves those without a model: their demonstration (default, where there is "
            "one) or their script."
        ),
    ] = None,
    condition: Annotated[
        Literal["0", "1", "demo"], typer.Option(help="0, 1, or that of the demonstration.")
    ] = "demo",
    demos: Annotated[
        str, typer.Option(help="Demonstrations: packaged, none, or a file.")
    ] = "packaged",
    split: Annotated[
        str, typer.Option(help="Episodes to start from: train, val, test or all.")
    ] = "train",
    fps: Annotated[float, typer.Option(help="Steps shown per second.")] = 10.0,
    size: Annotated[int, typer.Option(help="Width of the picture in pixels.")] = 600,
) -> None:
    """Watch animals move: recorded, scripted or driven by a trained model.

    Without --model everybody follows the paired demonstration, or the script of the species:
    chasers and an evader, a programmed moth.

    Examples:

      animarl watch AnimaRL/Silkmoth-v0 --seed 3 --out out/moth.gif

      animarl watch AnimaRL/Agent-v0 --by script --episodes 3

      animarl watch AnimaRL/Agent-v0 --model runs/agents --split test --out clip.mp4

      animarl watch --model fly --out out/fly.gif
    """
    if env is None and model is None:
        raise InputError("there is nothing to watch: name an environment, or give --model")
    if out is not None and out.suffix.lower() not in CLIP_SUFFIXES:
        raise InputError(f"{out}: a clip cannot be written as {out.suffix!r}: use .gif or .mp4")
    if focal is not None and model is None:
        raise InputError("--focal names whom the model drives, but there is no model: give --model")
    seed = SEED.check("seed", seed)
    options = {
        "demos": None if demos == "none" else demos,
        "split": named_split(split),
        "condition": "demo" if condition == "demo" else int(condition),
    }
    world, actor = prepare(
        env or trained_environment(str(model)),
        model=model,
        focal=focal,
        by=by,
        seed=seed,
        acting=acting,
        **options,
    )
    renderer = Renderer("human" if out is None else "rgb_array", size=size, fps=fps)
    world.seed([seed])
    console = PlainConsole()
    endings: list[str] = []
    with Progress(console=console, transient=True) as progress:
        total = episodes * min(steps or world.scenario.species.time_limit, 10**6)
        task = progress.add_task("step", total=total)
        pictures = play(
            world, actor, renderer, episodes=episodes, steps=steps, endings=endings,
            on_step=lambda: progress.advance(task),
        )  # fmt: skip
        try:
            if out is None:
                for _ in pictures:
                    pass
            else:
                write_clip(pictures, out, fps)
        finally:
            renderer.close()
    pace = fps * world.scenario.species.dt
    for number, ending in enumerate(endings):
        console.print(f"episode {number}: {ending}", highlight=False)
    if out is not None:
        console.print(f"Wrote {out} ({pace:g} x real time)", highlight=False, soft_wrap=True)


def prepare(
    env: str,
    *,
    model: str | Path | None = None,
    focal: str | None = None,
    by: Rule | None = None,
    seed: int = 0,
    acting: str | None = None,
    **options: Any,
) -> tuple[World, Actor]:
    """Return the world of an environment id with one copy, and who acts in it.

    Parameters
    ----------
    env
        Id of an environment made of a species.
    model, focal, by, seed, acting
        As for :func:`watch_command`.
    options
        Of :func:`animarl_envs.scenario.make_scenario`; they win over those of the id.

    Raises
    ------
    InputError
        If the id is unknown or none of this suite, or an option is not valid.
    """
    try:
        kwargs = dict(gym.spec(env).kwargs)
    except gym.error.Error as error:
        known = ", ".join(sorted(i for i in gym.registry if i.startswith("AnimaRL/")))
        raise InputError(f"environment {env!r} is unknown: choose one of {known}") from error
    if "species" not in kwargs:
        raise InputError(
            f"environment {env!r} has no species, so it cannot be watched: use AnimaRL"
        )
    for key in ("focal", "others", "render_mode"):
        kwargs.pop(key, None)
    species = kwargs.pop("species")
    options = kwargs | options
    demos = options.get("demos", PACKAGED)
    if isinstance(demos, str | Path):
        demos = options["demos"] = demos if str(demos) == PACKAGED else load(str(demos))
    policy: Any = None
    if model is not None:
        name = species if isinstance(species, str) else species.name
        given = demos if isinstance(demos, Demonstrations) else None
        run, shown = load_trained(model, name, seed, acting, given)
        species, learned = run.species, run.settings.focal
        policy = run.for_all(run.policy)
        if learned is not None and focal not in (None, learned):
            raise InputError(
                f"focal is {focal!r}, but {learned} alone learned in {model}: leave --focal out"
            )
        focal = focal or learned
        if demos is not None:
            options["demos"] = shown
        options = run.world_options | options
    plain = make_scenario(species, **options)
    names = plain.names
    if focal is not None and focal not in names:
        raise InputError(f"focal is {focal!r}: choose one of {', '.join(names)}")
    driven = set() if policy is None else {focal} if focal is not None else set(names)
    rule = by or ("demonstration" if plain.paired else "script")
    programmed = rule == "script" and plain.species.script == PROGRAMMED
    other = {"demonstration": "replay", "script": "action" if programmed else "scripted"}[rule]
    drivers = {name: "action" if name in driven else other for name in names}
    world = make_world(make_scenario(species, drivers=drivers, **options), 1)
    if policy is not None:
        return world, trained_actor(policy)
    if programmed:
        return world, programmed_actor(world.scenario, seed)
    return world, idle_actor


def play(
    world: World,
    actor: Actor,
    renderer: Renderer,
    *,
    episodes: int = 1,
    steps: int | None = None,
    endings: list[str] | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Iterator[NDArray[np.uint8]]:
    """Run episodes and draw every step; yields the pictures, or nothing for a window.

    ``endings`` collects one sentence per episode; ``on_step`` is called after every step.
    """
    recorder = SceneRecorder(world)
    for _ in range(episodes):
        world.reset()
        recorder.start()
        scene, start = recorder.scene(), True
        while True:
            picture = renderer.draw(scene)
            if renderer.closed:
                return
            if picture is not None:
                yield picture
            over = bool(world.terminated[0] or world.truncated[0])
            if over or (steps is not None and world.step_count[0] >= steps):
                break
            world.step(actor(world, start))
            recorder.follow()
            on_step()
            scene, start = recorder.scene(), False
        if endings is not None:
            endings.append(f"{scene.note or 'stopped'} after {scene.step * scene.species.dt:.1f} s")
        for _ in range(round(HOLD * renderer.fps)):
            picture = renderer.draw(scene)
            if picture is not None:
                yield picture
