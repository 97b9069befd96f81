"""Trained models to give away: what is exported acts as the run did; those of the package load."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Done, refused
from refusals import refuses
from small_runs import made

from animarl_algos import load_pretrained
from animarl_algos.cli.watch import prepare
from animarl_algos.runs import pipeline
from animarl_algos.runs.pretrained import FOLDER, export_run, pretrained_names
from animarl_algos.runs.run import Run
from animarl_envs.demos.packaged import packaged_names
from animarl_envs.errors import InputError

LARGEST = 3_000_000  # [bytes]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A small run of clones, evaluated."""
    trained = made(tmp_path_factory.mktemp("runs"), "soft-bc")
    pipeline.evaluate_run(trained)
    return trained


def answers(model: Any) -> Any:
    """Actions in the model's own world from a seed of its own."""
    model.policy.seed(5)
    seen = np.random.default_rng(0).normal(size=(6, model.observation_space.shape[0]))
    return model.predict(seen.astype(np.float32))[0].tolist()


def test_an_exported_model_acts_as_the_run(run: Run, tmp_path: Path) -> None:
    out = export_run(run, tmp_path / "model", with_demonstrations=True)
    assert answers(load_pretrained(out)) == answers(run.trained("soft-bc"))
    assert (out / "policies" / "soft-bc.safetensors").is_file()
    assert not list(out.rglob("*.pt"))
    world, actor = prepare("AnimaRL/Agent-v0", model=out)
    world.reset()
    assert actor(world, True).shape == (1, 3)
    card = (out / "README.md").read_text()
    for told in ("**Data**", "**Licence**", "MIT", "## Metrics", "Distinguished by", "## Limits",
                 "synthetic", "One training seed", "## Settings", "offline_epochs: 1"):  # fmt: skip
        assert told in card, told
    metrics = json.loads((out / "metrics.json").read_text())
    assert {"auc", "duration"} <= {row["measure"] for row in metrics["measures"]}


def test_recordings_are_given_away_only_when_asked(run: Run, tmp_path: Path) -> None:
    out = export_run(run, tmp_path / "model")
    assert not (out / "demonstrations.npz").exists()
    refuses(r"demonstrations\.npz", load_pretrained, out)
    shutil.copyfile(run.path / "demonstrations.npz", out / "demonstrations.npz")
    assert answers(load_pretrained(out)) == answers(run.trained("soft-bc"))


def test_damaged_weights_are_refused(run: Run, tmp_path: Path) -> None:
    out = export_run(run, tmp_path / "model", with_demonstrations=True)
    file = out / "policies" / "soft-bc.safetensors"
    whole = file.read_bytes()
    for damaged in (whole[:-8], b"", b"\xff" * 200, whole[:8] + b"[" + whole[9:]):
        file.write_bytes(damaged)
        refuses("not a policy of this run", load_pretrained, out)


def test_what_cannot_be_exported_says_why(run: Run, tmp_path: Path) -> None:
    lacking = tmp_path / "run"
    shutil.copytree(run.path, lacking)
    shutil.rmtree(lacking / "evaluation")
    refuses("needs its evaluation", export_run, Run(lacking), tmp_path / "model")
    shutil.rmtree(lacking / "policies")
    refuses("no trained policy", export_run, Run(lacking), tmp_path / "model")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("1")
    refuses("no model", export_run, run, tmp_path / "thesis")
    refuses("no packaged model of that name", load_pretrained, "cat")


def test_no_run_is_written_over(run: Run, tmp_path: Path) -> None:
    other = tmp_path / "run"
    shutil.copytree(run.path, other)
    before = (other / "settings.json").read_bytes()
    for exported in (run, Run(other)):
        refuses("it is a run folder", export_run, exported, other)
    assert (other / "settings.json").read_bytes() == before
    model = export_run(run, tmp_path / "model")
    assert export_run(run, model) == model


def test_a_model_without_its_recordings_is_watched_with_their_file(
    run: Run, tmp_path: Path
) -> None:
    out = export_run(run, tmp_path / "model")
    for given in ({}, {"demos": "agent"}, {"demos": None}):
        with pytest.raises(InputError, match="by --demos, or export it again --with-demonst"):
            prepare("AnimaRL/Agent-v0", model=out, **given)
    world, _ = prepare("AnimaRL/Agent-v0", model=out, demos=run.path / "demonstrations.npz")
    own, _ = prepare("AnimaRL/Agent-v0", model=run.path)
    assert world.scenario.species == own.scenario.species


@pytest.mark.parametrize("order", [[1, 0, 2], [0, 2]])
def test_recordings_of_other_individuals_are_refused(
    order: list[int], run: Run, tmp_path: Path
) -> None:
    names = [run.demos.individuals[i] for i in order]
    other = replace(
        run.demos,
        individuals=tuple(names),
        roles=tuple(run.demos.roles[i] for i in order),
        positions=run.demos.positions[:, order],
        initial_velocity=run.demos.initial_velocity[:, order],
    )
    file = other.save(tmp_path / "other.npz")
    words = f"other.npz: it shows {names[0]} .pursuer., .* learned from predator_0 .pursuer., pred"
    refuses(words, prepare, "AnimaRL/Agent-v0", model=run.path, demos=file)


def test_the_command_exports_and_refuses(
    run: Run, tmp_path: Path, animarl: Callable[..., Done]
) -> None:
    done = animarl("export", run.path, "--out", "model")
    assert "README.md" in done.stdout and (tmp_path / "model" / "README.md").is_file()
    for words, said in (([], "nothing to watch"), (["--model", "cat"], "no packaged")):
        refused(animarl("watch", *words), said)


def test_packaged_models_are_small_and_hold_no_code() -> None:
    assert set(pretrained_names()) == set(packaged_names()) - {"solo", "shoal"}
    for name in pretrained_names():
        files = [file for file in (FOLDER / name).rglob("*") if file.is_file()]
        assert sum(file.stat().st_size for file in files) < LARGEST
        assert {file.suffix for file in files} == {".json", ".md", ".safetensors"}


@pytest.mark.parametrize("name", pretrained_names())
def test_packaged_models_act_in_their_world(name: str) -> None:
    model = load_pretrained(name)
    env = model.get_env()
    assert env is not None
    seen, state = env.reset(), None
    start = np.ones(env.num_envs, dtype=bool)
    taken = []
    for _ in range(20):
        actions, state = model.predict(seen, state=state, episode_start=start)
        seen, _, start, _ = env.step(actions)
        taken.append(actions)
    assert len(np.unique(taken)) > 1 and np.isfinite(seen).all()
    card = (FOLDER / name / "README.md").read_text()
    assert "synthetic" in card and "no animal" in card and "**Licence**" in card
