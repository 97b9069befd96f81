"""``animarl watch``: see an environment move, in a window or as a clip."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from typer import Argument, Option

from animarl_algos.cli.shared import PlainConsole, load, named_split, with_help
from animarl_algos.runs.run_settings import environment_options
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import ending_in_words
from animarl_envs.drawing.render import CLIP_SUFFIXES, Renderer, write_clip
from animarl_envs.drawing.scene import SceneRecorder
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED, Scenario, make_scenario
from animarl_envs.settings import Seed, check_value
from animarl_envs.species import SearchSpecies
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World

CLIP_STEPS = 1_500  # of an episode in a clip, by default
GIF_STEPS = 6_000  # a .gif is held in memory until it is written, some 0.4 MB a picture
HOLD = 1.0  # the last picture of an episode stays for this time [s]
PROGRAMMED = "programmed moth"  # the scripted rule that acts from outside of the world
Rule = Literal["demonstration", "script"]
"""What ``--by`` takes."""
Actor = Callable[[World, bool], NDArray[np.integer]]
"""From a world of one copy, and whether an episode starts now, to its actions ``(1, K)``."""


@with_help(
    env=Argument(help="Environment id, such as AnimaRL/Newt-v0; by default that of --model."),
    model="The trained policy: the folder of a run, or that of rl_zoo3's train (its zip holds "
    "pickles: only your own), or a packaged model by name, such as fly.",
    out="Clip to write, .gif or .mp4; without it, a window opens.",
    seed="Seed of the episodes and the policies.",
    acting="Acting rule of --model: greedy, boltzmann:TEMPERATURE or epsilon:SHARE; by default "
    "the run's.",
    episodes=Option(min=1, help="Number of episodes."),
    steps=Option(min=1, help="Longest episode, in steps; by default to its end."),
    focal="The model drives only this individual; by default all that it learned.",
    beside="Show the recordings on the left and the model from the same starts on the right.",
    by="What moves individuals without a model: their demonstration (default, if there is one) "
    "or their script.",
    condition="0, 1, or that of the demonstration.",
    demos="Demonstrations: packaged, none, or a file.",
    split="Episodes to start from: train, val, test or all; by default test with --model, else "
    "train.",
    fps="Steps shown per second.",
    size="Width of the picture in pixels.",
)
def watch_command(
    env: str | None = None,
    model: str | None = None,
    out: Path | None = None,
    seed: int = 0,
    acting: str | None = None,
    episodes: int = 1,
    steps: int | None = None,
    focal: str | None = None,
    beside: bool = False,
    by: Rule | None = None,
    condition: Literal["0", "1", "demo"] = "demo",
    demos: str = "packaged",
    split: str | None = None,
    fps: float = 10.0,
    size: int = 600,
) -> None:
    """Watch animals move: recorded, scripted or driven by a trained model.

    Without --model all individuals replay a demonstration, or follow the script of the species.

    Examples:

      animarl watch AnimaRL/Silkmoth-v0 --seed 3 --out out/moth.gif

      animarl watch AnimaRL/Agent-v0 --by script --episodes 3

      animarl watch AnimaRL/Agent-v0 --model runs/agents --split test --out clip.mp4

      animarl watch --model fly --beside --split test --out out/flies.gif
    """
    if env is None and model is None:
        raise InputError("there is nothing to watch: name an environment, or give --model")
    if out is not None and out.suffix.lower() not in CLIP_SUFFIXES:
        raise InputError(f"{out}: a clip cannot be written as {out.suffix!r}: use .gif or .mp4")
    if focal is not None and model is None:
        raise InputError("--focal names whom the model drives, but there is no model: give --model")
    if beside and (model is None or out is None):
        raise InputError("--beside shows a model beside its recordings: give --model and --out")
    seed = check_value("seed", seed, Seed)
    endings: dict[str, list[str]] = {"recorded": [], "simulated": []} if beside else {"": []}
    sides = []
    for title in endings:
        world, actor = prepare(
            env,
            model=model,
            focal=focal,
            by=by,
            seed=seed,
            acting=acting,
            replayed=title == "recorded",
            demos=None if demos == "none" else demos,
            split=named_split(split or ("train" if model is None else "test")),
            condition="demo" if condition == "demo" else int(condition),
        )
        renderer = Renderer("human" if out is None else "rgb_array", size=size, fps=fps)
        world.seed([seed])
        sides.append((title, world, actor, renderer))
    if beside and not world.scenario.paired:
        raise InputError("--beside needs recordings to show: give --demos, or leave it out")
    console = PlainConsole()
    longest = world.scenario.species.time_limit
    if out is not None and steps is None and longest > CLIP_STEPS:
        steps = CLIP_STEPS
        console.print(
            f"An episode may take {longest:,} steps: the clip shows its first {steps:,}; give "
            "--steps for another number"
        )
    pictures_kept = episodes * min(steps or longest, longest)
    if out is not None and out.suffix.lower() == ".gif" and pictures_kept > GIF_STEPS:
        raise InputError(
            f"{out}: a .gif of {pictures_kept:,} steps takes too much memory, the most are "
            f"{GIF_STEPS:,}: write an .mp4, or give fewer --steps or --episodes"
        )
    total = episodes * len(sides) * min(steps or world.scenario.species.time_limit, 10**6)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("step", total=total)

        def pictures(episode: int, most: int) -> Iterator[Iterator[NDArray[np.uint8]]]:
            for title, world, actor, renderer in sides:
                world.seed([seed + episode])
                made_up = world.demos is not None and world.demos.synthetic
                yield play(
                    world,
                    actor,
                    renderer,
                    episodes=most,
                    steps=steps,
                    endings=endings[title],
                    on_step=lambda: progress.advance(task),
                    title=f"{title} (synthetic)" if made_up and title == "recorded" else title,
                )

        try:
            if out is None:
                for _ in next(pictures(0, episodes)):
                    pass
            elif beside:
                pairs = (pair for n in range(episodes) for pair in abreast(pictures(n, 1)))
                write_clip(pairs, out, fps)
            else:
                write_clip(next(pictures(0, episodes)), out, fps)
        finally:
            for *_, renderer in sides:
                renderer.close()
    for number in range(max(map(len, endings.values()))):
        for title, sentences in endings.items():
            console.print(f"episode {number}{', ' * bool(title)}{title}: {sentences[number]}")
    if out is not None:
        console.print(f"Wrote {out} ({fps * world.scenario.species.dt:g} x real time)")


def abreast(sides: Iterable[Iterator[NDArray[np.uint8]]]) -> Iterator[NDArray[np.uint8]]:
    """Yield pictures side by side; a side that ends first keeps its last picture."""
    last: list[NDArray[np.uint8] | None] = []
    for current in zip_longest(*sides):
        last = [old if new is None else new for new, old in zip_longest(current, last)]
        yield np.concatenate([picture for picture in last if picture is not None], axis=1)


def prepare(
    env: str | None,
    *,
    model: str | Path | None = None,
    focal: str | None = None,
    by: Rule | None = None,
    seed: int = 0,
    acting: str | None = None,
    replayed: bool = False,
    **options: Any,
) -> tuple[World, Actor]:
    """Return the world of an environment id with one copy, and who acts in it.

    ``env`` is the id of an environment made of a species; None: that of the model. ``replayed``
    says whether all individuals of the model's world follow its recordings. ``options`` are those
    of :func:`animarl_envs.scenario.make_scenario`, which win over those of the id; others as for
    :func:`watch_command`. Raises InputError if the id is unknown or none of this suite, an option
    is not valid, or the model has no trained policy, or one of another species or of other
    individuals.
    """
    run = zoo = None
    if model is not None:  # what learns is imported where it acts
        from animarl_algos.runs.pretrained import model_folder
        from animarl_algos.runs.run import Run
        from animarl_algos.runs.zoo_model import ZooModel

        folder = model_folder(model)
        zoo = ZooModel.of(folder, acting, seed)
        run = Run(folder, acting) if zoo is None else None
    if zoo is not None:
        if env is not None and zoo.env not in (env, environment_id(env)):
            raise InputError(f"{model}: it was trained in {zoo.env}, not in {env}: leave {env} out")
        if options.get("demos") == PACKAGED:
            del options["demos"]  # those that it learned from
        env, focal, options = zoo.env, focal or zoo.focal, zoo.options | options
    if env is None:
        assert run is not None
        env = environment_id(run.settings.species)
    kwargs = environment_options(env)
    if "species" not in kwargs:
        raise InputError(
            f"environment {env!r} has no species, so it cannot be watched: use AnimaRL"
        )
    for key in ("focal", "others", "render_mode"):
        kwargs.pop(key, None)
    species = kwargs.pop("species")
    options = kwargs | options
    demos = options.get("demos", PACKAGED)
    if isinstance(demos, str | Path) and str(demos) != PACKAGED:
        demos = options["demos"] = load(str(demos))
    if run is not None:
        name, settings = species if isinstance(species, str) else species.name, run.settings
        if settings.species != name:
            raise InputError(
                f"{run.path}: it was trained as {settings.species}, not as {name}: watch "
                f"{environment_id(settings.species)}"
            )
        recordings = run.check_demonstrations(demos if isinstance(demos, Demonstrations) else None)
        if run.has_policy(settings.algo):
            run.acting(settings.algo)  # chosen already: watching chooses none
        run.policy.policy.seed(seed)
        species, learned = run.species, settings.focal
        if learned is not None and focal not in (None, learned):
            raise InputError(
                f"focal is {focal!r}, but {learned} alone learned in {model}: leave --focal out"
            )
        focal = focal or learned
        if demos is not None:
            options["demos"] = recordings
        options = run.world_options | options
    plain = make_scenario(species, **options)
    names = plain.names
    if focal is not None and focal not in names:
        raise InputError(f"focal is {focal!r}: choose one of {', '.join(names)}")
    driven = set() if model is None or replayed else {focal} if focal is not None else set(names)
    rule = by or ("demonstration" if plain.paired else "script")
    programmed = rule == "script" and plain.species.script == PROGRAMMED
    other = {"demonstration": "replay", "script": "action" if programmed else "scripted"}[rule]
    drivers = {name: "action" if name in driven else other for name in names}
    world = make_world(make_scenario(species, drivers=drivers, **options), 1)
    if zoo is not None and not replayed:
        return world, trained_actor(zoo.as_joint_policy(names))
    if run is not None and not replayed:
        return world, trained_actor(run.as_joint_policy(run.policy))
    return world, programmed_actor(world.scenario, seed) if programmed else idle_actor


def idle_actor(world: World, start: bool) -> NDArray[np.integer]:
    """Return no decisions: the world replays or follows its script."""
    return np.zeros((1, world.num_individuals), dtype=np.int64)


def programmed_actor(scenario: Scenario, seed: int) -> Actor:
    """Return the programmed moth: surge, zigzag, loop."""
    from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth

    species = scenario.species
    assert isinstance(species, SearchSpecies)
    moth = ProgrammedMoth(1, np.random.default_rng(seed), species)

    def act(world: World, start: bool) -> NDArray[np.integer]:
        if start:
            moth.reset()
        return moth.act(world.observation)

    return act


def trained_actor(policy: Any) -> Actor:
    """Return a policy of ``predict``, with the condition's flag where it was trained with it."""
    from animarl_algos.evaluation.collect import remembered

    state: Any = None

    def act(world: World, start: bool) -> NDArray[np.integer]:
        nonlocal state
        num = world.num_individuals
        observation = world.observation[0]
        if policy.observation_space.shape[-1] == observation.shape[-1] + 1:
            flag = np.full((num, 1), world.condition[0], dtype=observation.dtype)
            observation = np.concatenate([observation, flag], axis=1)
        starts = np.full(num, start)
        actions, state = policy.predict(observation, state=state, episode_start=starts)
        wanted = np.asarray(actions).reshape(1, num)
        state = remembered(policy, state, wanted, world.executed(wanted))
        return wanted

    return act


def play(
    world: World,
    actor: Actor,
    renderer: Renderer,
    *,
    episodes: int = 1,
    steps: int | None = None,
    endings: list[str] | None = None,
    on_step: Callable[[], None] = lambda: None,
    title: str = "",
) -> Iterator[NDArray[np.uint8]]:
    """Run episodes and draw every step; yields the pictures, or nothing for a window.

    A recording that all individuals replay ends the episode at its last frame. ``endings`` collects
    one sentence per episode; ``on_step`` is called after every step; ``title`` stands in the
    pictures in place of the species' title, followed by the name of a recording that is replayed.
    """
    recorder, replays = SceneRecorder(world, title=title), {*world.scenario.drivers} == {"replay"}
    for _ in range(episodes):
        world.reset()
        source, last, end = "", np.inf, ""
        if world.demos is not None and world.demo[0] >= 0:
            demo = world.demos.episode(int(world.demo[0]))
            source = f"{demo.recording}, {demo.split}"
            if replays:
                last = len(demo.positions) - 1
                end = ending_in_words(demo.outcome, world.demos.individuals, world.demos.roles)
                recorder.title = title and f"{title}: {source}"
        recorder.start()
        scene, start = recorder.scene(), True
        while True:
            over = bool(world.terminated[0] or world.truncated[0])
            if not over and scene.step >= last:
                over, scene = True, replace(scene, note=end or "recording ended")
            picture = renderer.draw(scene)
            if renderer.closed:
                return
            if picture is not None:
                yield picture
            if over or (steps is not None and world.step_count[0] >= steps):
                break
            world.step(actor(world, start))
            recorder.follow()
            on_step()
            scene, start = recorder.scene(), False
        if endings is not None:
            time = scene.step * scene.species.dt
            endings.append(
                f"{scene.note or 'stopped'} after {time:.1f} s{source and f' ({source})'}"
            )
        for _ in range(round(HOLD * renderer.fps)):
            picture = renderer.draw(scene)
            if picture is not None:
                yield picture
