"""Everything that a page shows: what all pages know of their runs, and where a page comes from."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from animarl_algos.evaluation.comparison import Evaluation
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report.figures import Stage, contact_drawn
from animarl_algos.report.page import Block, Pairs, Text
from animarl_algos.report.words import Words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.species import CUSTOM, Species

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


@dataclass(frozen=True, eq=False, kw_only=True)
class PageInputs:
    """What every page knows of the runs that it shows.

    ``demos`` are the evaluated demonstrations, ``species`` whose contact radius, goal and
    conditions these are (None where only the recordings are known). ``command`` repeats the page;
    ``world`` are the species' numbers in words, ``environment`` the options of the world that was
    trained in, ``settings`` as resolved, ``machine`` what the trainings were made with and on, and
    ``wall_time`` seconds by stage.
    """

    demos: Demonstrations
    species: Species | None = None
    command: str = ""
    world: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    machine: Mapping[str, str] = field(default_factory=dict)
    wall_time: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def words(self) -> Words:
        """What the demonstrations and the unit of lengths are called."""
        return Words.of(self.demos)

    @property
    def animals(self) -> str:
        """Return the species, or of a set of one's own the names of the animals."""
        names = ", ".join(self.demos.kinds)
        return names if self.demos.species == CUSTOM else self.demos.species

    @property
    def recorded(self) -> str:
        """What the demonstrations are called: recorded only if they were."""
        return self.words.adapt("recorded")

    @cached_property
    def stage(self) -> Stage:
        """Where they move: the recorded field, with walls if the world had them."""
        demos, known = self.demos, self.species
        return Stage(
            demos.arena if known is None else replace(demos.arena, rebound=known.arena.rebound),
            demos.roles,
            demos.individuals,
            self.words,
            None if known is None else contact_drawn(known),
        )

    def condition(self, number: int) -> str:
        """Return the name of a condition."""
        names = () if self.species is None else self.species.conditions
        return names[number] if len(names) > number else f"condition {number}"


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportInputs(PageInputs):
    """Everything that the report of a run, or of several runs, shows.

    Raises InputError if the evaluation is of other demonstrations, or the learner has no rollouts.

    Parameters
    ----------
    learner
        The method that the summary, the trajectories and the speeds are about.
    rollouts, evaluation
        By method name, all seeds and cues joined; their evaluation against these demonstrations.
    episodes
        Number of demonstrations per split, where the run knows them.
    folds
        Of a cross-validation, in which all recordings were tested; 0 for none.
    warnings
        What was doubtful while the run was made; said beside the verdict.
    """

    title: str
    learner: str
    rollouts: Mapping[str, Rollouts]
    evaluation: Evaluation
    seeds: tuple[int, ...] = ()
    created: str = ""
    episodes: Mapping[str, int] = field(default_factory=dict)
    folds: int = 0
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.evaluation.fingerprint != self.demos.fingerprint():
            raise InputError(
                f"the evaluation is of other demonstrations than {self.demos.name}: "
                "evaluate the run again"
            )
        if self.learner not in self.rollouts:
            raise InputError(
                f"there are no rollouts of {self.learner!r}: choose one of "
                f"{', '.join(self.rollouts)}"
            )


def provenance(
    inputs: PageInputs, page: str, episodes: Entries = (), statistics: Entries = ()
) -> Iterator[Block]:
    """Yield everything that is needed to repeat a ``page``; more is known of some pages."""
    demos = inputs.demos
    if inputs.command:
        yield Text(f"To repeat this {page}:")
        yield Text(inputs.command, "command")
    stated, *more = origin(demos)
    recordings = inputs.words.adapt("Recordings")
    times = [(f"wall time, {stage}", duration(s)) for stage, s in inputs.wall_time.items()]
    for title, entries in {
        "World": [*inputs.world.items(), *flattened(inputs.environment)],
        recordings: [
            stated,
            ("fingerprint of the evaluated set", demos.fingerprint()),
            ("evaluated episodes", str(demos.num_episodes)),
            ("individuals", ", ".join(demos.individuals)),
            ("time step", f"{demos.dt:g} s"),
            *episodes,
            *more,
        ],
        "Statistics": statistics,
        "Code and machine": [*inputs.machine.items(), *times],
        "Settings": flattened(inputs.settings),
        "Versions": list(inputs.versions.items()),
    }.items():
        if entries:
            yield Pairs(title, entries)


def to_paste(inputs: PageInputs, methods: Sequence[str]) -> Iterator[Block]:
    """Yield a paragraph for the methods section, as text to copy, and what to cite.

    ``methods`` are the sentences after that of the demonstrations.
    """
    demos, version = inputs.demos, inputs.versions.get("animarl")
    commit = inputs.machine.get("commit", "")
    made_by = f" (commit {commit[:12]})" if commit and " " not in commit.strip() else ""
    named = "" if demos.species == CUSTOM else f"{demos.species}; "
    begin = (
        f"Simulations were made with AnimaRL{f' {version}' if version else ''}{made_by} "
        f"from {'synthetic' if demos.synthetic else 'recorded'} episodes of "
        f"{', '.join(demos.individuals)} ({named}time step {demos.dt:g} s; licence "
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
    yield Text("For the methods section", "heading")
    yield Text(" ".join([begin, *methods]), "command")
    yield Text("To cite", "heading")
    yield Text("\n".join([PAPER, "", *software]), "command")


def origin(demos: Demonstrations) -> list[tuple[str, str]]:
    """Return what the demonstrations say of themselves, their licence first."""
    entries = [pair for pair in flattened(demos.provenance) if pair[0] != "licence"]
    return [("licence", licence(demos)), *entries]


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
