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
        "`thrusts=3` that of three magnitudes",
    ),
    ("`time_limit`", "the longest episode, or what the import kept at most, if that is longer"),
    (
        "`contact_radius`",
        "the distance at which the import ended episodes (or `contact_radius` in the provenance); "
        "else that at which recorded contacts ended (their 0.9 quantile); else a thousandth of the "
        "arena's size: where no recorded episode ended by contact, none should that is simulated",
    ),
    (
        "`conditions`",
        "those that occur, as names (`conditions` in the provenance): they change no reward unless "
        "you say `shared_reward=True`",
    ),
    ("`rebound`", "walls, if the arena is a disc or a square"),
    (
        "`turning`, `senses_heading`",
        "where headings are recorded (`animarl import --heading thorax,head`): a fit to those of "
        "each individual, unless the direction of travel predicts the next heading better; they "
        "are perceived if one individual has such a fit",
    ),
    ("`start_half_side`, `warmup`", "half the arena's size; 0 steps"),
]
CUSTOM = (
    "Any file of demonstrations is an environment at once: one or more pursuers and a target, one "
    "pursuer and its targets, or one searcher. `animarl import` makes the file from a tracker's "
    "(`--target NAME` names the target, `--target auto` finds the individual that is approached, "
    "`--pursuer NAME` names one that pursues all others). `animarl run demos.npz` learns from it, "
    "`animarl watch AnimaRL/Custom-v0 --demos demos.npz` shows it."
)


FLOCK = """## One pursuer, several targets

A dog and its flock: `animarl import flock.csv --fps 25 --pursuer dog --out flock.npz`, or rows of
`recording, individual, role` in the table of `--metadata`; without recordings `num_targets=5`. The
targets come first, the pursuer last.

- The focus of each target is the pursuer; that of the pursuer is its nearest target, chosen anew at
  each step.
- The first touch of any target ends the episode, for all; `info["outcome"]` is k for target k - 1.
- The pursuer gets +1 for it; each target dt for every step in which it is not touched. Who leaves
  the boundary gets -10.
- By their scripts the pursuer goes straight at the nearest target and each target runs from the
  pursuer; they do not keep together, as recorded or trained flocks may.
- Who is named `focal` acts; by default the pursuer. Path lengths and distances of reports are the
  pursuer's."""


def custom_page() -> str:
    """How to simulate animals that are none of the four."""
    doc, code = script("custom_species.py")
    parts = [
        "# Your own animals: `AnimaRL/Custom-v0`",
        NOTICE,
        CUSTOM,
        f"```python\n{script('custom_demonstrations.py')[1]}\n```",
        "Where its numbers come from: if the file names a species of the suite (`animarl import "
        "--species fly`), its numbers hold where the file is silent; otherwise:",
        markdown_table(("number", "from"), CUSTOM_NUMBERS),
        "All but names and roles are options as well: `contact_radius=0.1` overrides the rules. A "
        "searcher gets the silkmoth's senses, plume and conditions. Files of flies, newts, "
        "silkmoths or agents can be given to those environments too, `gym.make(\"AnimaRL/Fly-v0\", "
        "demos=\"demos.npz\")`: names, number and time step are then the file's, all else is "
        "the species'.",
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
