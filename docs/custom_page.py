"""The page of animals that are none of the four, for :mod:`make_env_pages`."""

from __future__ import annotations

import re
from dataclasses import MISSING, fields
from typing import Any

from option_notes import CHASE_ONLY, NOTES
from page_text import DOCS, NOTICE, markdown

from animarl_envs.drawing import markdown_table
from animarl_envs.species import ChaseSpecies

CUSTOM_NUMBERS = [
    ("names, roles, `dt`, `arena`", "the file"),
    (
        "`locomotion`",
        "the joint fit to the training episodes, made once per content of the file; with "
        "`thrusts=3` that of three magnitudes; with `cells=64` actions are cells of the recorded "
        "velocities instead of pushes",
    ),
    ("`time_limit`", "the longest episode, or what the import kept at most, if that is longer"),
    (
        "`contact_radius`",
        "the distance at which the import ended episodes (or `contact_radius` in the provenance); "
        "or else the 0.9 quantile of the distances at which recorded contacts ended; or else a "
        "thousandth of the arena's size, so that simulated episodes do not end by contact either",
    ),
    (
        "`conditions`",
        "those that occur, with their names (`conditions` in the provenance); they do not change "
        "the reward unless you set `shared_reward=True`",
    ),
    ("`rebound`", "walls, if the arena is a disc or a square"),
    (
        "`turning`, `senses_heading`",
        "recorded headings (`animarl import --heading thorax,head`): fitted for each individual, "
        "unless the direction of travel predicts the next heading better. Headings are perceived "
        "if one individual has such a fit",
    ),
    ("`start_half_side`, `warmup`", "half the arena's size; 0 steps"),
]
CUSTOM = (
    "Any file of demonstrations is an environment: pursuers and a target, one pursuer and its "
    "targets, one searcher, or animals without a target. `animarl import` makes the file from your "
    "tracks. `--target NAME` names the target, `--target auto` takes the individual that the "
    "others approach, `--target none` says that nobody is pursued, and `--pursuer NAME` names one "
    "that pursues all others. `animarl run demos.npz` trains on the file, and "
    "`animarl watch AnimaRL/Custom-v0 --demos demos.npz` shows it."
)


FLOCK = """## One pursuer, several targets

For a dog and its flock, use `animarl import flock.csv --fps 25 --pursuer dog --out flock.npz`, or
rows of `recording, individual, role` in the table of `--metadata`. Without recordings, set
`num_targets=5`. Targets are listed first, the pursuer last.

- The focus of each target is the pursuer. The focus of the pursuer is its nearest target at each
  step.
- The first touch of a target ends the episode for all. `info["outcome"]` is k for target k - 1.
- The pursuer then gets +1. Each target gets dt for every step before. Leaving the boundary costs
  10.
- With their scripts, the pursuer intercepts the nearest target and each target runs from the
  pursuer. Scripted targets do not keep together, as recorded or trained flocks may.
- You control the pursuer, or the individual named by `focal`. Path lengths and distances in reports
  are the pursuer's."""


def custom_page() -> str:
    """How to simulate animals that are none of the four."""
    doc, code = script("custom_species.py")
    parts = [
        "# Your own animals: `AnimaRL/Custom-v0`",
        NOTICE,
        CUSTOM,
        f"```python\n{script('custom_demonstrations.py')[1]}\n```",
        "The numbers of the environment come from the file. If it names a species of the suite "
        "(`animarl import --species fly`), that species supplies what the file lacks. Otherwise:",
        markdown_table(("number", "from"), CUSTOM_NUMBERS),
        "All but names and roles are options too: `contact_radius=0.1` overrides the table. A "
        "searcher gets the silkmoth's senses, plume and conditions. You can also give a file of "
        "flies, newts, silkmoths or agents to their own environment: "
        "`gym.make(\"AnimaRL/Fly-v0\", demos=\"demos.npz\")`. Names, number and time step are "
        "then the file's; everything else is the species'.",
        FLOCK,
        "## A species without demonstrations",
        doc,
        "![Two dogs and a sheep](../images/custom.png)",
        f"```python\n{code}\n```",
        "Fields of a species and their defaults:",
        markdown_table(
            ("field", "meaning", "allowed", "default"),
            [
                (f"`{f.name}`", NOTES.get(f.name, CHASE_ONLY.get(f.name, ("", "")))[1],
                 NOTES.get(f.name, CHASE_ONLY.get(f.name, ("", "")))[0], default_text(f))
                for f in fields(ChaseSpecies)
            ],
        ),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def script(name: str) -> tuple[str, str]:
    """The docstring of a script beside this one as Markdown, and its code."""
    doc, _, code = (DOCS / name).read_text().partition('"""\n\n')
    paragraphs = re.split(r"\n\s*\n", doc.removeprefix('"""'))
    return "\n\n".join(markdown(p) for p in paragraphs), code.strip()


def default_text(field: Any) -> str:
    """The default of a dataclass field, or that it has none."""
    return "required" if field.default is MISSING else f"`{field.default!r}`"
