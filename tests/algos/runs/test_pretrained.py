"""Models to give away act as the run did; what cannot become a simulator is refused before."""

import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toys
from commands import Done, refused
from pair_learners import demonstrations
from refusals import refuses
from small_runs import made

from animarl_algos import load_pretrained, load_run
from animarl_algos.cli.watch import prepare
from animarl_algos.data.slot_layout import refuse_other_observation
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.recipes.registry import DQDIL, SoftBC
from animarl_algos.runs import pipeline
from animarl_algos.runs.permuted import second_run
from animarl_algos.runs.pretrained import FOLDER, escape_markdown, export_run, pretrained_names
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_algos.runs.stand_in import simulated_recordings
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.summary import stand_in_note, unit_of
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import stated_options

LARGEST = 3_000_000  # [bytes]
LIVING = {"termites", "termites_alone", "locusts"}


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
    for told in ("**Data**", "**Licence**", "MIT", "## Metrics", "Classifier on", "## Limits",
                 "synthetic", "One training seed", "## Settings", "offline_epochs: 1"):  # fmt: skip
        assert told in card, told
    metrics = json.loads((out / "metrics.json").read_text())
    assert {"auc", "duration"} <= {row["measure"] for row in metrics["measures"]}


def test_damaged_weights_are_refused(run: Run, tmp_path: Path) -> None:
    out = export_run(run, tmp_path / "model", with_demonstrations=True)
    file = out / "policies" / "soft-bc.safetensors"
    whole = file.read_bytes()
    for damaged in (whole[:-8], b"", b"\xff" * 200, whole[:8] + b"[" + whole[9:]):
        file.write_bytes(damaged)
        refuses("not a policy of this run", load_pretrained, out)


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes and devices")
@pytest.mark.parametrize(
    "name",
    ["settings.json", "locomotion.json", "demonstrations.npz", "policies/soft-bc.safetensors"],
)
def test_pipes_and_devices_in_a_folder_from_elsewhere_are_refused(
    run: Run, tmp_path: Path, name: str
) -> None:
    out = export_run(run, tmp_path / "model", with_demonstrations=True)
    file = out / name
    file.unlink(missing_ok=True)
    os.mkfifo(file)
    refuses("pipe or a device|not a policy of this run", load_run, out)
    file.unlink()
    file.symlink_to("/dev/zero")
    refuses("pipe or a device|not a policy of this run", load_run, out)


@pytest.mark.parametrize(
    ("part", "key", "value", "said"),
    [
        ("settings", "copies", 10**9, "at most 100000"),
        ("learner", "policy_kwargs", {"hidden": 10**7}, "at most 8192"),
    ],
)
def test_a_folder_from_elsewhere_may_not_take_all_memory(
    run: Run, tmp_path: Path, part: str, key: str, value: Any, said: str
) -> None:
    out = export_run(run, tmp_path / "model", with_demonstrations=True)
    record = json.loads((out / "settings.json").read_text())
    record[part][key] = value
    (out / "settings.json").write_text(json.dumps(record))
    refuses(said, load_run, out)
    (out / "settings.json").write_text("[" * 10**5)
    refuses("nests too deeply", load_run, out)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("<img src=x>", "&lt;img src=x&gt;"),
        ("[a](http://x)", "[a]\\(http://x)"),
        ("a | b `c`", "a \\| b \\`c\\`"),
        ("a\n# b", "a # b"),
        ("![a]", "\\![a]"),
    ],
)
def test_names_on_a_card_are_text(name: str, shown: str) -> None:
    assert escape_markdown(name) == shown


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
    other = tmp_path / "other"  # no run is written over
    shutil.copytree(run.path, other)
    before = (other / "settings.json").read_bytes()
    for exported in (run, Run(other)):
        refuses("it is a run folder", export_run, exported, other)
    assert (other / "settings.json").read_bytes() == before
    model = export_run(run, tmp_path / "model")
    assert export_run(run, model) == model


def test_recordings_are_given_away_only_when_asked_and_watched_with_their_file(
    run: Run, tmp_path: Path
) -> None:
    out = export_run(run, tmp_path / "model")
    assert not (out / "demonstrations.npz").exists()
    refuses(r"demonstrations\.npz", load_pretrained, out)
    for given in ({}, {"demos": "agent"}, {"demos": None}):
        with pytest.raises(InputError, match="by --demos, or export it again --with-demonst"):
            prepare("AnimaRL/Agent-v0", model=out, **given)
    world, _ = prepare("AnimaRL/Agent-v0", model=out, demos=run.path / "demonstrations.npz")
    own, _ = prepare("AnimaRL/Agent-v0", model=run.path)
    assert world.scenario.species == own.scenario.species
    shutil.copyfile(run.path / "demonstrations.npz", out / "demonstrations.npz")
    assert answers(load_pretrained(out)) == answers(run.trained("soft-bc"))


def test_simulated_tracks_stand_for_recordings(run: Run, tmp_path: Path) -> None:
    out = export_run(run, tmp_path / "model", simulated=True)
    model = load_run(out)
    assert answers(model.policy) == answers(run.trained("soft-bc"))
    assert stated_options(model.species) == stated_options(run.species)
    assert model.demos.synthetic and set(model.demos.split) == {"train", "val", "test"}
    recorded = {place.tobytes() for place in run.demos.positions.astype(np.float32)}
    assert not any(
        place.astype(np.float32).tobytes() in recorded for place in model.demos.positions
    )
    assert unit_of(model.demos) == unit_of(run.demos)
    assert "no recorded ones" in (out / "README.md").read_text()
    assert "it simulated itself" in stand_in_note(model.demos) and not stand_in_note(run.demos)
    assert second_run(model, ["arena=x0.8"], print) is None
    refuses("no recordings to compare it with", pipeline.evaluate_run, model)
    refuses("not both", export_run, run, tmp_path / "m", simulated=True, with_demonstrations=True)
    moth = load_run("silkmoth")
    refuses("animals that search a source", simulated_recordings, moth)


@pytest.mark.parametrize("order", [[1, 0, 2], [0, 2]])
def test_recordings_of_other_individuals_are_refused(
    order: list[int], run: Run, tmp_path: Path
) -> None:
    names = [run.demos.individuals[i] for i in order]
    other = replace(
        run.demos, individuals=tuple(names), roles=tuple(run.demos.roles[i] for i in order),
        positions=run.demos.positions[:, order],
        initial_velocity=run.demos.initial_velocity[:, order],
    )  # fmt: skip
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
    assert set(pretrained_names()) == (set(packaged_names()) - {"solo", "shoal"}) | LIVING
    for name in pretrained_names():
        files = [file for file in (FOLDER / name).rglob("*") if file.is_file()]
        size = sum(file.stat().st_size for file in files)
        assert size < (1_000_000 if name in LIVING else LARGEST)
        tracks = {".npz"} if name in LIVING else set()
        assert {file.suffix for file in files} == {".json", ".md", ".safetensors"} | tracks


@pytest.mark.parametrize("name", sorted(LIVING))
def test_living_models_hold_no_recorded_track(name: str) -> None:
    run = load_run(name)
    assert run.demos.provenance["learned_from"] and run.demos.synthetic
    assert all(one.startswith("simulated") for one in run.demos.recording)


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
    assert ("simulated" in card) if name in LIVING else ("no animal" in card)
    assert "**Licence**" in card


def test_a_recipe_that_needs_the_simulator_and_is_given_none(tmp_path: Path) -> None:
    refuses("no environment to learn in: give env=", DQDIL, "MlpPolicy")
    settings: dict[str, Any] = {"demonstrations": demonstrations(), "buffer_size": 500}
    DQDIL("MlpPolicy", toys.Pair(2), offline_epochs=1, **settings).save(tmp_path / "model")
    loaded = DQDIL.load(tmp_path / "model", device="cpu")
    refuses("no environment to learn in: give env=", loaded.learn, 10)
    assert not loaded.offline_progress.epoch


@pytest.mark.parametrize(
    ("rule", "words"),
    [("boltzmann:1,2", "2 numbers for 3 individuals"), ("epsilon:2", "epsilon is 2")],
)
def test_an_acting_rule_for_others(rule: str, words: str, tmp_path: Path) -> None:
    def opened() -> Run:
        asked = {"file": "packaged", "species": "fly", "algo": "soft-bc", "steps": 1, "copies": 1}
        settings = RunSettings(**asked, acting=rule)
        return pipeline.open_run(settings, tmp_path / "run", "test", load_packaged("fly"))

    refuses(words, opened)
    assert not (tmp_path / "run").exists()


def test_a_model_of_another_observation() -> None:
    model = SoftBC(env=SlotVecEnv("fly", 2), device="cpu", seed=0)
    paper, before = SlotVecEnv("fly", 2, observation="paper"), model.env
    refuses("shows 'own position x', which this", model.set_env, paper)
    newt = SlotVecEnv("newt", 2)
    refuses("is of the species newt, this learner of fly", model.set_env, newt)
    assert model.env is before
    model.demonstrations = paper.offline_data()
    refuses("observation components, the environment", model.learn, 1)
    assert not model.offline_progress.epoch


@pytest.mark.parametrize(
    ("here", "word"),
    [
        (("moth", "speed", "place"), "of the species moth, this learner of fly"),
        (("fly", "speed", "wall"), "shows 'wall', which this learner has not"),
        (("fly", "speed"), "does not show 'place', which this learner has"),
        (("fly", "place", "speed"), "in another order"),
    ],
)
def test_observations_are_compared_by_name_where_both_are_known(
    here: tuple[str, ...], word: str
) -> None:
    learned = ("fly", "speed", "place")
    for unknown in ((), learned):  # an environment, or an older file, that does not say
        refuse_other_observation(learned, unknown)
        refuse_other_observation(unknown, learned)
    refuses(word, refuse_other_observation, learned, here)


@pytest.mark.parametrize(
    ("recordings", "fix"),
    [
        (["a", "b"], "it has 2 episodes, so record more or 'animarl import' with --piece"),
        (["a", "a", "b"], "it has 2 recordings, so deal with 'animarl data split --by episode'"),
        (["a", "b", "c"], "deal them again with 'animarl data split'"),
    ],
)
def test_demonstrations_too_few_to_split(
    recordings: list[str], fix: str, tmp_path: Path, animarl: Callable[..., Done]
) -> None:
    demos = load_packaged("fly").select(episodes=range(len(recordings)))
    split = np.array(["train", "val", "train"])[: len(recordings)]
    replace(demos, recording=np.array(recordings), split=split).save(tmp_path / "few.npz")
    refused(animarl("run", "few.npz", "--out", "run"), f"split 'test' holds no episode: {fix}")
    assert not (tmp_path / "run").exists()
