"""Write ``docs/environments/*.md`` and their pictures from the species specs and docstrings.

    python docs/make_env_pages.py              # pages and pictures
    python docs/make_env_pages.py --text-only  # pages; pictures as they are

``tests/project/test_docs_pages.py`` compares the pages with the specs.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import inspect
import math
import re
from collections.abc import Sequence
from dataclasses import fields
from itertools import groupby

from custom_page import custom_page
from option_notes import CHASE_ONLY, FREE_ONLY, NOTES, SEARCH_ONLY
from page_text import DOCS, NOTICE, markdown, number, paragraphs

import animarl_envs
from animarl_envs.arena import Arena
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.drawing import markdown_table
from animarl_envs.files import write_then_rename
from animarl_envs.locomotion import ACTION_ANGLES, NUM_DIRECTIONS
from animarl_envs.scenario import make_scenario
from animarl_envs.species import COMPACT, SPECIES, ChaseSpecies, Species
from animarl_envs.tasks import TASKS
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import ObservationComponent, World

TURNS = {0: "straight at the focus", 3: "to the right", 6: "straight away", 9: "to the left"}


def page(species: Species) -> str:
    """The whole page of a species."""
    full = make_world(make_scenario(species, demos=None), 1)
    world = make_world(make_scenario(species, demos=None, observation=COMPACT), 1)
    env_id = animarl_envs.environment_id(species.name)
    module = importlib.import_module(f"animarl_envs.species.{species.name}")
    title, _, more = inspect.cleandoc(module.__doc__ or "").partition("\n")
    parts = [
        f"# {species.title}: `{env_id}`",
        NOTICE,
        *paragraphs(title, more),
        *tasks(species),
        f"![{species.title}](../images/{species.name}.png)",
        *caption(species.name),
        "## Usage",
        usage(species),
        "## Rewards",
        rewards(world, species),
        "## Actions",
        ACTIONS.format(count=species.num_actions, focus=FOCUS[kind(species)]),
        actions(species),
        "## Observation",
        OBSERVED.format(
            full=len(full.observation_components), compact=len(world.observation_components)
        )
        + ORDER.get(kind(species), ""),
        observations(world.observation_components, together=True),
        *PAPER.get(kind(species), ()),
        f"<details><summary>All {len(full.observation_components)} components of "
        "<code>full</code></summary>",
        observations(full.observation_components),
        "</details>",
        "## Ends of an episode",
        ends(species),
        "## Facts",
        facts(species),
        "## Options",
        "Options are keyword arguments of `gym.make`, `gym.make_vec` and "
        "`animarl_envs.parallel_env` (there without `focal` and `others`). "
        '`info["scenario"]` at reset and the attribute `scenario_data` hold the values in use. '
        '`reset(options={"demo": 3})` starts from demonstration 3.',
        options(species),
        "## Wrappers",
        WRAPPERS,
        "## Version history",
        "\n".join(f"- {line}" for line in species.version_history),
        f"Source: {species.source}.",
    ]
    return "\n\n".join(parts) + "\n"


def tasks(species: Species) -> list[str]:
    """What the tasks of these animals change, and who earns what in them."""
    own = {name: task for name, task in TASKS.items() if task.base.name == species.name}
    if not own:
        return []
    ids = [f"`{animarl_envs.environment_id(name)}`" for name in own]
    rows = [
        [
            f"`{name}`",
            *(f"`{task.changes[name]!r}`" if name in task.changes else "" for task in own.values()),
        ]
        for name in dict.fromkeys(name for task in own.values() for name in task.changes)
    ]
    if species.num_individuals > 1:
        rows.insert(0, ["`others`", *["`'scripted'`"] * len(own)])
    return [
        f"Tasks for reinforcement learning have ids of their own. {' and '.join(ids)} "
        f"{'are' if len(own) > 1 else 'is'} this world with these changes, and nothing else "
        "([`animarl_envs/tasks.py`](../../animarl_envs/tasks.py); a factor in `locomotion` is on "
        "the thrust). Your options come on top of them.",
        markdown_table(("option", *ids), rows),
        *scores(species.name.capitalize()),
    ]


def scores(task: str) -> list[str]:
    """Who earns what in the task, and in its variants, where that was measured."""
    found = []
    for name, note in (("table", SCORES), ("teams", TEAMS)):
        path = DOCS / "results" / "tasks" / f"{name}.csv"
        rows = list(csv.reader(path.read_text().splitlines())) if path.exists() else [[]]
        own = [[environment(of), *row] for of, *row in rows[1:] if of.startswith(task)]
        if own:
            found += [markdown_table(("environment", *rows[0][1:]), own), note]
            found += bars(own) if name == "table" else []
    return found


def environment(task: str) -> str:
    """The id of a task, and behind a colon who acts in it."""
    name, colon, focal = task.partition(":")
    return f"`{animarl_envs.environment_id(name)}`" + (f": {focal}" if colon else "")


def bars(rows: list[list[str]]) -> list[str]:
    """Whether learning is worth it in each environment of a table: aims, and what was found."""
    lines = []
    for env, of_env in groupby(rows, key=lambda row: row[0]):
        own = list(of_env)
        top = {row[1]: max(float(of[5]) for of in own if of[1] == row[1]) for row in own}
        earned = {row[1].partition(" ")[0]: row[3] for row in own}
        best = next(row for row in own if row[5] == "1.00" and row[6])
        constant = next(score for policy, score in top.items() if policy.startswith("constant"))
        returns = f"returns {earned['constant']} of {best[3]}, random {earned['random']}"
        aims = [("score of the best constant action at most 0.35", f"{constant:.2f} ({returns})",
                 constant <= 0.35)]  # fmt: skip
        if script := earned.get("scripted"):
            low = best[4].partition(" to ")[0] or best[3]
            aims += [("best learner's worst seed above the script", f"{low} and {script}",
                      float(low) > float(script))]  # fmt: skip
        if env.endswith("Memory-v0`") and {"PPO", "RecurrentPPO"} <= top.keys():
            share = top["PPO"] / top["RecurrentPPO"]
            aims += [("PPO at most 0.7 of RecurrentPPO", f"{share:.2f}", share <= 0.7)]
        said = (f"{aim}: {was}, {'met' if met else 'missed'}" for aim, was, met in aims)
        lines.append(f"- {env}: {'; '.join(said)}.")
    return ["Aims of a task, and whether they are met:\n\n" + "\n".join(lines)]


SCORES = (
    "By `python benchmarks/tasks.py`; it says what each row is. A return is the mean over seeds, "
    "the spread goes from the lowest to the highest seed, and a score is 0 for random actions and "
    "1 for the best learner. RecurrentPPO's rows of moths with all senses were made on another "
    "machine (Python 3.12.3, PyTorch 2.11.0, commit 9561591), whose rows without learning are "
    "equal to those here, digit for digit. Behind a colon stands the individual that acts, else "
    "the first pursuer does. Rows of chases are of two seeds and few steps: a learner with more "
    "may earn more. Targets have 1.3 times their thrust. Leaving the flies' dish ends the episode "
    "and costs 2, so that no female gets away by always turning to one side along a wall. The "
    "tasks and the "
    "numbers of steps were chosen on pilots of PPO with seed 10, which is in no row. The packaged "
    "demonstrations are synthetic; their animals started elsewhere and met no opponents but each "
    "other. The packaged clone of flies saw walls, so it has no row."
)
TEAMS = (
    "The same task for a team: every pursuer acts, the target follows its script. By `python "
    "benchmarks/baselines.py`, which says how, at commit f84ff07: the female fly had 1.15 times "
    "her thrust and walls then, the female newt her own thrust. A return is the mean over "
    "pursuers, and a score is 0 for random actions and 1 for the packaged demonstrations, which "
    "are synthetic."
)


def kind(species: Species) -> str:
    """Return its world, or ``"free"`` where nobody is pursued."""
    return "free" if isinstance(species, ChaseSpecies) and species.free else species.world


FOCUS = {
    "free": "The focus of an animal is the direction in which it moves: its velocity, averaged "
    "over the last second.",
    "chase": "The focus of a pursuer is the nearest target. The focus of a target is the nearest "
    "pursuer.",
    "search": "The focus is upwind (-x), because the moth does not know where the source is.",
}
ORDER = {
    "free": " Other animals, if there are any, are listed by distance, the nearest first.",
    "chase": " The first of the others is the target (or the single pursuer of several targets). "
    "All others are listed by distance, the nearest first.",
}
OBSERVED = (
    '`Box({full},)`, float32, one vector per individual: `observation="full"`. Some of its numbers '
    "are on scales that show how slow animals move, which clones of animals need. "
    '`observation="compact"`, that of the tasks, has the {compact} numbers below. A model acts '
    "only on the observation that it was trained on."
)
PAPER = {
    "chase": (
        '`observation="paper"` has the components of the paper. Three of them are '
        "constant or copies, because the frame points at the focus.",
    )
}
ACTIONS = (
    "`Discrete({count})`: an acceleration a of length 1, at an angle from the focus, or none. "
    "{focus} The next velocity is v' = (1 - d) v + u a dt and the next position p' = p + v' dt."
)


OUTCOMES = {
    "free": (
        '`info["outcome"]` is 0 at the time limit (and before the end), -2 if an animal left, and '
        "-3 for recordings that were cut."
    ),
    "chase": (
        '`info["outcome"]` is k > 0 for contact by pursuer k - 1 (or, with several targets, of '
        "target k - 1), 0 at the time limit (and before the end), -1 if the target left, -2 if a "
        "pursuer left, and -3 for recordings that were cut for another reason."
    ),
    "search": (
        '`info["outcome"]` is 1 at the source, 0 at the time limit (and before the end), and -3 '
        "for recordings that were cut for another reason."
    ),
}
REWARDS_FREE = (
    "There is no reward by default, because nobody is pursued. With `shoaling_reward=True` every "
    "step within the contact radius of another animal pays its duration [s]. Without walls, "
    "leaving the arena costs `boundary_penalty`. The wrapper `DTWReward` rewards staying near the "
    "demonstration."
)
WRAPPERS = (
    "`animarl_envs.wrappers` has every wrapper for the single, the vector (`...Vector`) and the "
    "parallel view (`...Parallel`). `DTWReward` rewards staying near the demonstration. "
    "`ConditionFlag` adds the experimental condition, or the other one, to the observation."
)


def facts(species: Species) -> str:
    arena = species.arena
    field = {"square": "square, half side", "disc": "disc, radius", "open": "open field, drawn to"}
    rows = [
        ("individuals", ", ".join(f"`{name}`" for name in species.individuals)),
        ("arena", f"{field[arena.shape]} {arena.size:g}{', with walls' if arena.rebound else ''}"),
        *(
            []
            if kind(species) == "free" and species.num_individuals == 1
            else [("contact", f"closer than {species.contact_radius:g}")]
        ),
        ("decision step", f"{species.dt:g} s"),
        ("time limit", f"{species.time_limit} steps, {species.time_limit * species.dt:g} s"),
        ("warm-up", f"{species.warmup} steps replayed from the demonstration, if there is one"),
    ]
    rows += [
        (f"condition {k}", name) for k, name in enumerate(species.conditions)
    ] or [("conditions", "none")]  # fmt: skip
    alike = kind(species) == "free" and species.num_individuals > 1
    for name, motion in zip(species.individuals[: 1 if alike else None], species.locomotion):
        top = motion.terminal_speed(species.dt)
        text = f"d = {motion.damping:g}, u = {motion.thrust:g}, terminal speed {top:.3g} / s"
        rows.append(("locomotion of all" if alike else f"locomotion of `{name}`", text))
    if species.name in packaged_names():
        rows.append(("packaged demonstrations", packaged(species.name)))
    unit = f"{species.length_unit}s"
    return markdown_table(("", f"lengths in {unit}"), rows)


def caption(name: str) -> list[str]:
    """What the picture shows, where it shows a demonstration."""
    if name not in packaged_names():
        return []
    kind = "synthetic" if load_packaged(name).synthetic else "recorded"
    return [f"*An episode of the packaged demonstrations, which are {kind}.*"]


def packaged(name: str) -> str:
    """How many episodes come with the package, how long, and how they are split."""
    demos = load_packaged(name)
    kind = "synthetic" if demos.synthetic else "recorded"
    seconds = (demos.lengths - 1).sum() * demos.dt
    split = ", ".join(f"{part} {(demos.split == part).sum()}" for part in SPLITS)
    return f"{len(demos)} {kind} episodes, {seconds:.1f} s: {split}"


def observations(components: Sequence[ObservationComponent], together: bool = False) -> str:
    """One row for each component, or for those ``together`` that differ in the last word only."""

    def shared(c: ObservationComponent) -> tuple[str, ...]:
        span = f"{number(c.low)} to {number(c.high)}"
        return (c.name.rpartition(" ")[0] if together else c.name), c.frame, c.unit, span

    rows, k = [], 0
    for (stem, *about), grouped in groupby(components, shared):
        names = [c.name for c in grouped]
        last = ", ".join(name.removeprefix(stem).strip() for name in names)
        label = f"{stem}: {last}" if len(names) > 1 else names[0]
        rows.append((f"{k} to {k + len(names) - 1}" if len(names) > 1 else str(k), label, *about))
        k += len(names)
    return markdown_table(("", "component", "frame", "unit", "range"), rows)


def actions(species: Species) -> str:
    """All actions; with several thrust magnitudes, those of the first individual beside them."""
    magnitudes = species.locomotion[0].magnitudes
    rows = []
    for m, magnitude in enumerate(magnitudes):
        thrust = "" if len(magnitudes) == 1 else f"{magnitude:.3g} u"
        rows += [
            (str(NUM_DIRECTIONS * m + k), f"{round(math.degrees(angle))}°",
             ", ".join(text for text in (TURNS.get(k, ""), thrust) if text))
            for k, angle in enumerate(ACTION_ANGLES)
        ]  # fmt: skip
    rows.append((str(species.num_actions - 1), "", "no acceleration: coasting"))
    return markdown_table(("action", "angle from the focus, counter-clockwise", ""), rows)


def rewards(world: World, species: Species) -> str:
    """The paragraph of the world's docstring: a line for each component, and what is left."""
    if kind(species) == "free":
        return REWARDS_FREE
    doc = inspect.getdoc(type(world)) or ""
    text = next(p for p in re.split(r"\n\s*\n", doc) if p.startswith("Reward"))
    said = markdown(text).partition(": ")[2]
    if not species.conditions:
        said = re.sub(r" \(with shared reward[^)]*\)", "", said)
    each, _, more = said.partition(". ")
    items = "\n".join(f"- {one.replace('` ', '`: ', 1)}" for one in re.split(r"[;,] (?=`)", each))
    return f"The reward is the sum of these, and `info` has each by name:\n\n{items}\n\n{more}"


def ends(species: Species) -> str:
    if kind(species) == "free":
        rows = []
    elif species.world == "search":
        rows = [(f"the moth is closer than {species.contact_radius:g} to the source", "terminated")]
    else:
        rows = [
            (f"a pursuer is closer than {species.contact_radius:g} to the target", "terminated")
        ]
    edge = species.arena.boundary
    beyond = {
        "square": f"an individual is beyond +-{edge:g} in x or y",
        "disc": f"an individual is farther than {edge:g} from the centre",
    }
    if species.arena.shape in beyond:
        when = "only with `rebound=False`" if species.arena.rebound else "not with `rebound=True`"
        rows.append((f"{beyond[species.arena.shape]} ({when})", "terminated"))
    rows.append((f"step {species.time_limit} has been taken", "truncated"))
    return "\n\n".join([markdown_table(("when", "then"), rows), OUTCOMES[kind(species)]])


def option_defaults(species: Species) -> dict[str, str]:
    """Every option of the species with its default, as shown."""
    from animarl_envs.views import AnimalEnv

    shown: dict[str, str] = {}
    for function in (AnimalEnv.__init__, make_scenario):
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY and name != "drivers":
                shown[name] = repr(parameter.default)
    if kind(species) == "free":
        shown["num_pursuers"] = str(species.num_individuals)
    elif isinstance(species, ChaseSpecies):
        shown["num_pursuers"] = str(species.num_pursuers)
        shown["num_targets"] = str(species.roles.count("target"))
    if isinstance(species, ChaseSpecies):
        shown |= {"landmarks": "{}", "obstacles": "()"}
    shown |= {"arena": arena_text(species.arena), "boundary": number(species.arena.boundary)}
    shown |= {"rebound": repr(species.arena.rebound), "locomotion": "see Facts"}
    shown |= {"thrusts": repr(species.thrusts)}
    hidden = {"name", "individuals", "recording", "locomotion", "arena", "source", "title"}
    for field in fields(species):
        if field.name not in hidden | {"version_history"}:
            shown[field.name] = repr(getattr(species, field.name))
    return shown


def arena_text(arena: Arena) -> str:
    return f"Arena({arena.shape!r}, {arena.size:g})"


def options(species: Species) -> str:
    notes = NOTES | (CHASE_ONLY if isinstance(species, ChaseSpecies) else SEARCH_ONLY)
    notes |= FREE_ONLY if kind(species) == "free" else {}
    rows = []
    for name, default in option_defaults(species).items():
        allowed, meaning = notes[name]
        rows.append((f"`{name}`", meaning, allowed, f"`{default}`" if default else ""))
    return markdown_table(("option", "meaning", "allowed", "default"), rows)


def usage(species: Species) -> str:
    env_id = animarl_envs.environment_id(species.name)
    last, coast = species.individuals[-1], species.num_actions - 1
    condition = ", condition=1" if species.conditions else ""
    return f"""You control one individual; others replay recordings or follow a script or policy:

```python
import gymnasium as gym
import animarl_envs

env = gym.make("{env_id}", focal="{last}"{condition})
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
```

Many copies at once:

```python
envs = gym.make_vec("{env_id}", num_envs=512)
observations, infos = envs.reset(seed=0)
observations, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
```

All individuals act, with PettingZoo:

```python
everyone = animarl_envs.parallel_env("{species.name}")
observations, infos = everyone.reset(seed=0)
actions = {{name: everyone.action_space(name).sample() for name in everyone.agents}}
observations, rewards, terminated, truncated, infos = everyone.step(actions)
```

PettingZoo knows the environment too: `pettingzoo.make("parallel", "{env_id}")`.

To watch it, run `animarl watch {env_id} --out clip.gif`. To play it, call
`gymnasium.utils.play.play(gym.make("{env_id}", render_mode="rgb_array"), noop={coast})`.
The key w goes towards the focus, a to its left, s away and d to its right; q, e, z, c and pairs of
keys go in between."""


def pages() -> dict[str, str]:
    """File name and text of every page."""
    found = {f"{name}.md": page(species) for name, species in SPECIES.items()}
    return found | {"custom.md": custom_page()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--text-only", action="store_true", help="leave the pictures as they are")
    if not parser.parse_args().text_only:
        from env_pictures import write_pictures

        write_pictures()
    for name, text in pages().items():
        with write_then_rename(DOCS / "environments" / name) as part:
            part.write_text(text)
    print(f"Wrote {len(pages())} pages in docs/environments")


if __name__ == "__main__":
    main()
