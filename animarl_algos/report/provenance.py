"""Where a report comes from: the command, the world, the machine, the licence; words to paste."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from animarl_algos.report.blocks import Block, Command, Heading, Pairs, Text
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.style import method_label
from animarl_envs.demos.demonstrations import Demonstrations

NOT_KNOWN = "not known (the run was made by an older version)"
NOT_SET = "not set"

PAPER = """@article{fujii_simulator,
  title  = {Data-driven simulator of multi-animal behavior with unknown dynamics via offline and
            online reinforcement learning},
  author = {Fujii, Keisuke and Tsutsui, Kazushi and Teshima, Yu and Itoh, Makoto and
            Takeishi, Naoya and Nishiumi, Nozomi and Tanaka, Ryoya and Shigaki, Shunsuke and
            Kawahara, Yoshinobu}
}"""
"""The paper that the method comes from, as in ``CITATION.cff``."""


def provenance(inputs: ReportInputs) -> Iterator[Block]:
    """Everything that is needed to repeat the run, and what to write about it."""
    demos = inputs.demos
    if inputs.command:
        yield Text("To repeat this run:")
        yield Command(inputs.command)
    yield Pairs("World", flattened(inputs.environment) or [("options", NOT_KNOWN)])
    stated, *told = origin(demos)
    entries = [
        stated,
        ("fingerprint of the evaluated set", inputs.evaluation.fingerprint),
        ("evaluated episodes", str(demos.num_episodes)),
        ("individuals", ", ".join(demos.individuals)),
        ("time step", f"{demos.dt:g} s"),
        *((f"{split} episodes", str(count)) for split, count in inputs.episodes.items()),
        *told,
    ]
    yield Pairs("Demonstrations", entries)
    yield Pairs(
        "Statistics",
        [
            ("resamples of means and differences", f"{inputs.evaluation.resamples:,}"),
            ("resamples of distances", f"{inputs.evaluation.distance_resamples:,}"),
            ("seed of the resampling", str(inputs.evaluation.seed)),
            ("training seeds", _seeds(inputs)),
        ],
    )
    yield code_and_machine(inputs.machine, inputs.wall_time)
    if inputs.settings:
        yield Pairs("Settings", flattened(inputs.settings))
    if inputs.versions:
        yield Pairs("Versions", list(inputs.versions.items()))


def code_and_machine(machine: Mapping[str, str], wall_time: Mapping[str, float]) -> Pairs:
    """The commit and the machine that trained, and the seconds each stage took."""
    made = list(machine.items()) or [("commit, hardware", NOT_KNOWN)]
    times = [(f"wall time, {stage}", duration(s)) for stage, s in wall_time.items()]
    return Pairs("Code and machine", [*made, *(times or [("wall time", NOT_KNOWN)])])


def origin(demos: Demonstrations) -> list[tuple[str, str]]:
    """What the demonstrations say of themselves, their licence first."""
    told = [pair for pair in flattened(demos.provenance) if pair[0] != "licence"]
    return [("licence", licence(demos)), *told]


def licence(demos: Demonstrations) -> str:
    """Of the data, where it is stated."""
    return str(demos.provenance.get("licence") or "not stated")


def to_paste(inputs: ReportInputs) -> Iterator[Block]:
    """A paragraph for the methods, and what to cite."""
    yield from words_to_paste(methods_paragraph(inputs), inputs.versions)


def words_to_paste(methods: str, versions: Mapping[str, str]) -> Iterator[Block]:
    """A paragraph for the methods, as text to copy, and what to cite."""
    yield Heading("For the methods section")
    yield Command(methods)
    yield Heading("To cite")
    yield Command("\n\n".join([PAPER, _software(versions)]))


def made_with(
    demos: Demonstrations, versions: Mapping[str, str], machine: Mapping[str, str]
) -> str:
    """How the first sentence of a methods section begins."""
    version = versions.get("animarl")
    return (
        f"Simulations were made with AnimaRL{f' {version}' if version else ''}{_commit(machine)} "
        f"from {'synthetic' if demos.synthetic else 'recorded'} episodes of "
        f"{', '.join(demos.individuals)} ({demos.species}; time step {demos.dt:g} s"
    )


def methods_paragraph(inputs: ReportInputs) -> str:
    """What was done, in the past tense, with the numbers of this run."""
    demos, evaluation, words = inputs.demos, inputs.evaluation, inputs.words
    verdict = evaluation.verdict
    splits = ", ".join(f"{count} {split}" for split, count in inputs.episodes.items())
    sentences = [
        f"{made_with(demos, inputs.versions, inputs.machine)}"
        f"{f'; episodes: {splits}' if splits else ''}; licence of the data: {licence(demos)})."
    ]
    if inputs.fit is not None:
        sentences.append(
            "Each individual moved by a fitted first-order model of locomotion "
            f"(damping and thrust, {inputs.fit.method} fit on {inputs.fit.episodes} episodes)."
        )
    seeds = len(inputs.seeds)
    sentences += [
        f"Its actions were chosen by a policy trained with {method_label(inputs.learner)}"
        + (f" ({seeds} training seed{'s' if seeds != 1 else ''})." if seeds else "."),
        f"From {verdict.starts} test starts, {verdict.rollouts} episodes were simulated and "
        f"compared with the {words.say('recordings')} of the same starts: endings, duration, path "
        "length, speed and turning by their differences (95 % intervals over demonstrations, by "
        f"a studentised bootstrap with {evaluation.resamples:,} resamples, and over training "
        "seeds, by Student's t) and by the Wasserstein "
        f"distance against exchanged {words.say('recordings')}, and windows of motion by a "
        "cross-fitted two-sample classifier (Lopez-Paz and Oquab 2017).",
    ]
    return " ".join(sentences)


def duration(seconds: float) -> str:
    """Wall time in a unit that suits it."""
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def flattened(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as dotted names and printable values."""
    out: list[tuple[str, str]] = []
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            out += flattened(value, f"{prefix}{key}.")
        else:
            out.append((f"{prefix}{key}", printable(value)))
    return out


def printable(value: Any) -> str:
    """A setting as a reader knows it: yes or no, lists without brackets, absence in words."""
    if value is None or (isinstance(value, Mapping | list | tuple | str) and len(value) == 0):
        return NOT_SET
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {printable(one)}" for key, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(printable, value))
    return str(value)


def _seeds(inputs: ReportInputs) -> str:
    return ", ".join(map(str, inputs.seeds)) or "not given"


def _commit(machine: Mapping[str, str]) -> str:
    commit = machine.get("commit", "")
    return f" (commit {commit[:12]})" if commit and " " not in commit.strip() else ""


def _software(versions: Mapping[str, str]) -> str:
    version = versions.get("animarl")
    lines = [
        "@software{animarl,",
        "  title   = {AnimaRL},",
        "  author  = {{The AnimaRL authors}},",
        *([f"  version = {{{version}}},"] if version else []),
        "  license = {MIT}",
        "}",
    ]
    return "\n".join(lines)
