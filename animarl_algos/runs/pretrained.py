"""Runs and models loaded by folder or name; runs exported to give away.

An exported model is the part of a run's folder that its policy acts by, with weights as safetensors
and everything else as JSON, and a card. Whatever takes a run's folder takes it too; demonstrations
that come with the package are not copied.
"""

import html
import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.evaluation.comparison import Evaluation
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import FINDINGS, UNKNOWN
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.report.inputs import flattened
from animarl_algos.report.verdict_section import verdict_as_table, verdict_sentence
from animarl_algos.report.words import Words
from animarl_algos.runs.evaluating import refuse_run_folder
from animarl_algos.runs.run import DEMONSTRATIONS, Run
from animarl_algos.runs.run_files import GIVEN, write_weights
from animarl_algos.runs.run_settings import CHOSEN
from animarl_algos.runs.stand_in import simulated_recordings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none
from animarl_envs.importing.sets import published_sets
from animarl_envs.scenario import PACKAGED
from animarl_envs.species import species_name

FOLDER = Path(__file__).resolve().parents[1] / "pretrained"
CARD, METRICS = "README.md", "metrics.json"


def pretrained_names() -> tuple[str, ...]:
    """Return the names of the models that come with the package."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob("*/settings.json")))


def model_folder(model: str | Path) -> Path:
    """Return a folder as it is; else that of the packaged model of this name, if there is one."""
    folder = Path(model)
    if folder.exists():
        return folder
    if (name := species_name(str(model))) in pretrained_names():
        return FOLDER / name
    raise InputError(
        f"{model}: there is no such folder and no packaged model of that name: name the folder of "
        f"a run, or one of {', '.join(pretrained_names())}"
    )


def load_run(folder: str | Path) -> Run:
    """Return a run with its trained policy, its world and its demonstrations, and ``simulate``.

    ``folder`` is a run's folder, that of an exported model, or the name of a packaged one
    (``"fly"``).

    Raises
    ------
    InputError
        If there is neither, or no trained policy yet.
    """
    run = Run(model_folder(folder))
    assert run.policy is not None  # read now, so that what is missing is said now
    return run


def load_pretrained(model: str | Path) -> SequenceQLearning:
    """Load a packaged model (``"fly"``), an exported one or a run's, with its world and rule.

    ``predict`` is stable-baselines3's; ``model.get_env()`` is the fitted world with its
    demonstrations, one slot per individual and copy.

    Raises
    ------
    InputError
        If there is none, or a file of it is damaged.
    """
    return Run(model_folder(model)).policy


def export_run(
    run: Run,
    out: Path,
    *,
    with_demonstrations: bool = False,
    simulated: bool = False,
    made_by: str | None = None,
    chosen: Mapping[str, float] | None = None,
) -> Path:
    """Write what a run's policy acts by into a folder of its own, with a model card.

    Raises InputError if the run was not trained or not evaluated, or the folder holds something
    else.

    Parameters
    ----------
    with_demonstrations
        Copy the recordings as well. Without them others need the same file to load the model;
        packaged ones they have.
    simulated
        Put tracks that the policy simulates in the place of the recordings
        (:func:`~animarl_algos.runs.stand_in.simulated_recordings`), so that others can load it.
    made_by
        The command, for the card; by default that of the run.
    chosen
        By candidate, the number on validation episodes that this model was chosen by: the lowest.
    """
    settings, algo = run.settings, run.settings.algo
    network = run.policy.policy.q_net
    if not (run.path / "evaluation" / "verdict.json").exists():
        raise InputError(
            f"{run.path}: a model card needs its evaluation: 'animarl evaluate {run.path}'"
        )
    if not all((out / name).is_file() for name in ("settings.json", METRICS)):
        refuse_run_folder(out)
        if out.is_dir() and any(out.iterdir()):
            raise InputError(f"{out}: it holds something that is no model: name another --out")
    if simulated and with_demonstrations:
        raise InputError("recordings are included, or simulated tracks in their place: not both")
    stand_in = simulated_recordings(run) if simulated else None
    verdict = Evaluation.load(run.path / "evaluation").verdict
    packaged = _is_packaged(run)
    # A path says more of somebody's disk than of the model.
    file = PACKAGED if packaged else Path(settings.file).name
    record = run.record | {
        "settings": run.record["settings"] | {"file": file, "device": "cpu"},
        "command": made_by or run.record["command"],
    }
    metrics = _metrics(verdict) | {"chosen_by_validation": dict(chosen or {})}
    copied = ["locomotion.json", f"policies/{algo}.acting.json"]
    if with_demonstrations and not packaged:
        copied.append(DEMONSTRATIONS)
    with all_files_or_none(out) as part:
        (part / "policies").mkdir()
        write_weights(network.state_dict(), part / "policies" / f"{algo}{GIVEN}")
        for name in copied:
            if (run.path / name).exists():
                shutil.copyfile(run.path / name, part / name)
        if stand_in is not None:
            stand_in.save(part / DEMONSTRATIONS, dtype=np.float32)
        (part / "settings.json").write_text(json.dumps(record, indent=2) + "\n")
        (part / METRICS).write_text(json.dumps(metrics, indent=1) + "\n")
        card = model_card(run, verdict, record, network.num_parameters, chosen or {}, stand_in)
        (part / CARD).write_text(card, encoding="utf-8")
    return out


def _metrics(verdict: Verdict) -> dict[str, Any]:
    """Return the findings of the verdict as plain numbers; None where something is not defined."""
    rows = json.loads(verdict.table.to_json(orient="records", double_precision=6))
    keys = ("measure", "unit", *FINDINGS)
    return {
        "headline": verdict.headline,
        "colour": verdict.colour,
        "counts": verdict.counts,
        "starts": verdict.starts,
        "rollouts": verdict.rollouts,
        "measures": [{key: row[key] for key in keys} for row in rows],
    }


def _is_packaged(run: Run) -> bool:
    """Whether its demonstrations, untouched, come with the package."""
    name = run.settings.species
    return name in packaged_names() and (
        load_packaged(name).fingerprint() == run.record["fingerprint"]
    )


def model_card(
    run: Run,
    verdict: Verdict,
    record: Mapping[str, Any],
    parameters: int,
    chosen: Mapping[str, float],
    stand_in: Demonstrations | None = None,
) -> str:
    """Return data, licence, settings, metrics and limits of a trained model, as Markdown.

    ``stand_in`` are simulated tracks that it has in the place of its recordings.
    """
    settings, demos, species = run.settings, run.demos, run.species
    words, lines, safe = Words.of(demos), "\n".join, escape_markdown
    kind = "synthetic, recorded from no animal" if demos.synthetic else "recorded"
    counts = ", ".join(f"{(demos.split == s).sum()} {s}" for s in ("train", "val", "test"))
    acting = f"`{settings.acting}`"
    if settings.acting == CHOSEN:
        acting = "chosen on training and validation episodes"
    if len(chosen) > 1:
        acting += (
            ".\n- **Chosen** by mismatch of outcomes, durations, path lengths and speeds on "
            "validation episodes (the lower, the more alike): "
            + ", ".join(f"{name} {number:.3f}" for name, number in chosen.items())
        )
    title, source = species.title, demos.provenance.get("source") or demos.name
    if published := published_sets().get(str(demos.provenance.get("set"))):
        title = f"Living animals, {published.name}"
        source = f"{published.title}; {published.citation}; {published.origin}"
    tracks = ""
    if stand_in is not None:
        tracks = (
            f"\n- **Tracks**: no recorded ones. Episodes start where {len(stand_in)} tracks in "
            f"`{DEMONSTRATIONS}` do, which the model simulated: of the rollout from a recorded "
            "start they leave out the first half, or the first second of a chase."
        )
    judged = (
        "Rollouts from the starts of the test split; training and the choice of acting saw none of "
        "it."
    )
    if folds := run.record.get("folds"):
        judged = (
            f"Cross-validated in {folds} folds: rollouts of {folds} simulators, each from the "
            "starts of recordings that neither its training nor its choice of acting saw. The "
            "model here is that of the first fold."
        )
    made_by = " ".join(str(record["command"]).replace("`", "'").split())
    questions = verdict_as_table(verdict, words)
    table = [questions.columns, ["---"] * len(questions.columns)]
    table += [row.cells for row in questions.groups[0].rows]
    return f"""\
# {safe(title)}: {settings.algo}

A policy of {safe(", ".join(species.individuals))} in `{environment_id(settings.species)}`, \
trained with `{settings.algo}` (seed {settings.seed}, {parameters:,} parameters). Weights: \
safetensors; everything else: JSON.

- **Data**: {safe(source)} ({kind}); episodes: {counts}; \
fingerprint `{record["fingerprint"]}`.{tracks}
- **Licence**: of the data {safe(demos.provenance.get("licence") or "not stated")}; of the weights \
that of the data, of the code MIT.
- **Made by** `{made_by}`, commit {safe(record["machine"]["commit"])}.
- **Acts by** the rule in `policies`, {acting}.

## Metrics

{safe(verdict_sentence(verdict, words))}

{judged} docs/faithful.md says how to read the table.

{lines(f"| {' | '.join(safe(cell) for cell in cells)} |" for cells in table)}

## Limits

{lines(f"- {safe(words.adapt(limit))}" for limit in _limits(run, verdict))}

## Settings

{lines(f"- {name}: {safe(value)}" for name, value in flattened(record["learner"]))}
{lines(f"- environment {name}: {safe(value)}" for name, value in flattened(record["environment"]))}
{lines(f"- {name} {safe(version)}" for name, version in record["versions"].items())}
"""


def escape_markdown(text: object) -> str:
    """Return a text of one line in which Markdown sees no tag, link, code, cell or image.

    Names come from files, and a card is shown where other people's pages are.
    """
    plain = html.escape(" ".join(str(text).split()), quote=False)
    return re.sub(r"[`|]|(?<=\])[(\[:]|!(?=\[)", r"\\\g<0>", plain)


def _limits(run: Run, verdict: Verdict) -> list[str]:
    """Return what its metrics do not show, the worst first."""
    limits = []
    counts = verdict.counts
    if verdict.complaints:
        limits.append(f"What differs on the test split: {'; '.join(verdict.complaints)}.")
    if counts[UNKNOWN]:
        limits.append(
            f"Not known on the test split: {counts[UNKNOWN]} of {len(verdict.table)} questions; "
            f"{verdict.recordings} recordings are too few."
        )
    if run.demos.synthetic:
        limits.append("The data are synthetic: it says nothing about living animals.")
    if _is_packaged(run):
        limits.append(
            "The package's default settings were chosen while tables of this test split were "
            "looked at (docs/results/README.md): it is not untouched."
        )
    return [
        *limits,
        "Mild faults pass its verdict at so few starts: docs/statistics.md says how often.",
        f"One training seed ({run.settings.seed}): its intervals speak of test starts, not of "
        "other trainings.",
        "It moves as these recordings do, from starts like theirs, in their arena; nothing was "
        "tested elsewhere.",
        "A counterfactual of it is no measurement: compare it with a truth where there is one.",
    ]
