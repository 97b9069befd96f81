"""Where a page comes from: the command, the world, the machine, the licence; words to paste."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from animarl_algos.report.inputs import PageInputs
from animarl_algos.report.page import Block, Pairs, Text
from animarl_envs.demos.demonstrations import Demonstrations

Entries = Sequence[tuple[str, str]]

NOT_SET = "not set"

PAPER = """@article{fujii_simulator,
  title  = {Data-driven simulator of multi-animal behavior with unknown dynamics via offline and
            online reinforcement learning},
  author = {Fujii, Keisuke and Tsutsui, Kazushi and Teshima, Yu and Itoh, Makoto and
            Takeishi, Naoya and Nishiumi, Nozomi and Tanaka, Ryoya and Shigaki, Shunsuke and
            Kawahara, Yoshinobu}
}"""
"""The paper that the method comes from, as in ``CITATION.cff``."""


def provenance(
    inputs: PageInputs, page: str, episodes: Entries = (), statistics: Entries = ()
) -> Iterator[Block]:
    """Yield everything that is needed to repeat a ``page``; more is known of some pages."""
    demos = inputs.demos
    if inputs.command:
        yield Text(f"To repeat this {page}:")
        yield Text.command(inputs.command)
    stated, *told = origin(demos)
    times = [(f"wall time, {stage}", duration(s)) for stage, s in inputs.wall_time.items()]
    for title, entries in {
        "World": [*inputs.world.items(), *flattened(inputs.environment)],
        "Demonstrations": [
            stated,
            ("fingerprint of the evaluated set", demos.fingerprint()),
            ("evaluated episodes", str(demos.num_episodes)),
            ("individuals", ", ".join(demos.individuals)),
            ("time step", f"{demos.dt:g} s"),
            *episodes,
            *told,
        ],
        "Statistics": statistics,
        "Code and machine": [*inputs.machine.items(), *times],
        "Settings": flattened(inputs.settings),
        "Versions": list(inputs.versions.items()),
    }.items():
        if entries:
            yield Pairs(title, entries)


def to_paste(inputs: PageInputs, data: str, methods: Sequence[str]) -> Iterator[Block]:
    """Yield a paragraph for the methods section, as text to copy, and what to cite.

    ``data`` says more of the demonstrations, ``methods`` are the sentences after it.
    """
    demos, version = inputs.demos, inputs.versions.get("animarl")
    commit = inputs.machine.get("commit", "")
    made_by = f" (commit {commit[:12]})" if commit and " " not in commit.strip() else ""
    begin = (
        f"Simulations were made with AnimaRL{f' {version}' if version else ''}{made_by} "
        f"from {'synthetic' if demos.synthetic else 'recorded'} episodes of "
        f"{', '.join(demos.individuals)} ({demos.species}; time step {demos.dt:g} s{data}; licence "
        f"of the data: {licence(demos)})."
    )
    software = [
        "@software{animarl,",
        "  title   = {AnimaRL},",
        "  author  = {{The AnimaRL authors}},",
        *([f"  version = {{{version}}},"] if version else []),
        "  license = {MIT}",
        "}",
    ]
    yield Text.heading("For the methods section")
    yield Text.command(" ".join([begin, *methods]))
    yield Text.heading("To cite")
    yield Text.command("\n".join([PAPER, "", *software]))


def origin(demos: Demonstrations) -> list[tuple[str, str]]:
    """Return what the demonstrations say of themselves, their licence first."""
    told = [pair for pair in flattened(demos.provenance) if pair[0] != "licence"]
    return [("licence", licence(demos)), *told]


def licence(demos: Demonstrations) -> str:
    """Return the licence of the data, where it is stated."""
    return str(demos.provenance.get("licence") or "not stated")


def duration(seconds: float) -> str:
    """Return wall time in a unit that suits it."""
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def flattened(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested settings as dotted names and printable values."""
    out: list[tuple[str, str]] = []
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            out += flattened(value, f"{prefix}{key}.")
        else:
            out.append((f"{prefix}{key}", printable(value)))
    return out


def printable(value: Any) -> str:
    """Return a setting in words: yes or no, lists without brackets, what absence means."""
    if value is None or (isinstance(value, Mapping | list | tuple | str) and len(value) == 0):
        return NOT_SET
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {printable(one)}" for key, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(printable, value))
    return str(value)
