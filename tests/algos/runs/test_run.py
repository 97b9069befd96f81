"""A run: what ``load_run`` gives, its world, its lock, its machine, its times and its warnings."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pages import ROOT, blocks, run_programs
from refusals import refuses
from report_inputs import rendered, report_inputs
from small_runs import few, made

from animarl_algos import load_run
from animarl_algos.cli.watch import prepare
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report.inputs import duration, flattened
from animarl_algos.runs import pipeline, run_set
from animarl_algos.runs.evaluating import (
    INFORMATION,
    far_acting_rules,
    roll_out,
    uninformative_clones,
)
from animarl_algos.runs.pipeline import load_demonstrations
from animarl_algos.runs.pretrained import model_folder
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_files import commit, machine
from animarl_algos.runs.run_set import RunSet
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs import wall
from animarl_envs.demos.joining import first_of_role
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.transitions import demonstrated_actions

PAGE = "docs/what_if.md"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return made(tmp_path_factory.mktemp("runs"), "soft-bc", demos=few(), rolled_out=False)


def test_rollouts_that_are_no_longer_made_do_not_stay(tmp_path: Path) -> None:
    own = made(tmp_path, "soft-bc", demos=few())
    np.savez(own.path / "rollouts" / "decisions.npz", q=np.zeros(3))  # of an older version
    refuses(r"decisions\.npz", own.rollouts)
    roll_out(own)
    assert list(own.rollouts()) == ["SOFT-BC"]


def test_two_runs_of_animals_that_differ_are_compared(tmp_path: Path) -> None:
    """Their traits are fitted twice, to equal numbers."""
    demos = load_packaged("solo").select(np.arange(0, 160, 8))
    factors = np.random.default_rng(0).uniform(0.4, 1.0, len(demos))  # who was slow stays so
    walks = demos.positions * np.repeat(factors, demos.lengths)[:, None, None]
    still = np.zeros_like(demos.initial_velocity)
    origin = {**demos.provenance, "synthetic": False}  # synthetic animals have no traits
    slower = replace(
        demos, species="custom", positions=walks, initial_velocity=still, provenance=origin
    )
    for seed in (0, 1):
        asked = RunSettings(
            file="x.npz", species="custom", algo="soft-bc", steps=1, seed=seed, thrusts="1"
        )
        pipeline.fit(pipeline.open_run(asked, tmp_path / str(seed), "animarl run x.npz", slower))
    compared = RunSet.open([tmp_path / "0", tmp_path / "1"])
    assert compared.species.traits is not None
    assert [run.settings.seed for run in compared.runs] == [0, 1]


def test_a_loaded_run_has_its_policy_world_and_demonstrations(run: Run) -> None:
    loaded = load_run(run.path)
    assert loaded.demos.fingerprint() == run.demos.fingerprint()
    assert loaded.scenario.species.locomotion == run.fit.locomotion
    observation = np.zeros((3, *loaded.policy.observation_space.shape), dtype=np.float32)
    actions, _ = loaded.policy.predict(observation)
    assert actions.shape == (3,)
    refuses("no such folder and no packaged model", load_run, run.path / "nowhere")
    refuses("not a run folder", load_run, ROOT)
    packaged = load_run("fly")
    assert packaged.path == model_folder("fly")
    assert packaged.scenario.species.locomotion == packaged.fit.locomotion


def test_each_file_of_a_run_is_read_once(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    call = wall.call

    def read(function: Any, path: Any, **options: Any) -> Any:
        opened.append(Path(path).name)
        return call(function, path, **options)

    monkeypatch.setattr(wall, "call", read)  # in another process
    watching = True

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if watching and event == "open" and str(arguments[0]).startswith(str(run.path)):
            opened.append(Path(arguments[0]).name)

    sys.addaudithook(note)  # which cannot be taken away again
    loaded = load_run(run.path)
    loaded.simulate(repetitions=1, time_limit=5)
    watching = False
    assert len(loaded.demos) == len(run.demos)
    once = ["demonstrations.npz", "locomotion.json", "settings.json", "soft-bc.pt"]
    assert sorted(opened) == once


class StepCounter:
    """Values that show the memory (steps counted) and the flag; 1 more for action 2."""

    def __init__(self) -> None:
        self.previous_actions: list[Any] = []

    def advance(self, observation: Any, state: Any, episode_start: Any) -> tuple[Any, Any, bool]:
        count = np.zeros(len(observation)) if state is None else state[0]
        self.previous_actions.append(None if state is None else state[1])
        q_values = np.zeros((len(observation), 13)) + (10.0 * count + observation[:, -1])[:, None]
        q_values[:, 2] += 1.0
        return q_values, count + 1, False


@pytest.mark.parametrize("focal", [None, "prey"])
def test_action_values_follow_the_recorded_path(focal: str | None, run: Run) -> None:
    """The policy's memory goes on, its own last actions are the recorded ones, it sees the flag."""
    counter, layout = StepCounter(), SimpleNamespace(condition_flag=True)
    loaded = load_run(run.path)
    vars(loaded)["settings"] = replace(loaded.settings, focal=focal)
    vars(loaded)["policy"] = SimpleNamespace(policy=counter, layout=layout)
    one = loaded.demos.select(split="test").select(episodes=[1])
    columns = [2] if focal else [0, 1, 2]
    values = loaded.action_values(1)
    assert values.shape == (one.lengths[0] - 1, len(columns), 13)
    counted = 10.0 * np.arange(len(values))[:, None, None] + float(one.condition[0])
    np.testing.assert_allclose(values - counted, np.eye(13)[2] * np.ones_like(values))
    actions = demonstrated_actions(one, loaded.species.locomotion)[:, columns]
    told = np.array(counter.previous_actions[1:])
    np.testing.assert_array_equal(told, np.maximum(actions, 0)[: len(told)])
    refuses("there is no test episode 99: choose one of 0 to", loaded.action_values, 99)


def test_action_values_are_what_the_policy_ranks_demonstrations_by(run: Run) -> None:
    loaded = load_run(run.path)
    model = loaded.learner(loaded.settings.algo, loaded.environment(loaded.learnable_demos))
    loaded.load_policy(loaded.settings.algo, model)
    shown = model.demonstrated_values(model.demonstration_data().val)
    count = len(loaded.demos.select(split="val"))
    values = np.concatenate([loaded.action_values(i, split="val") for i in range(count)])
    for own, expected in zip(values.swapaxes(0, 1), shown.values, strict=True):
        order = (np.lexsort(np.round(each.T, 3)) for each in (own, np.asarray(expected)))
        first, second = order
        np.testing.assert_allclose(own[first], np.asarray(expected)[second], atol=2e-3)


def test_a_change_is_all_that_differs(run: Run) -> None:
    loaded = load_run(run.path)
    first, again = loaded.simulate(repetitions=2), loaded.simulate(repetitions=2)
    np.testing.assert_array_equal(first.positions, again.positions)
    short = loaded.simulate(repetitions=2, time_limit=5)
    assert short.lengths.max() == 6
    for i in range(len(first)):
        same = min(len(first.path(i)), len(short.path(i)))
        np.testing.assert_array_equal(first.path(i)[:same], short.path(i)[:same])
    still = loaded.simulate(locomotion={"prey": {"thrust": 1e-9}})
    moved = [np.abs(np.diff(still.path(i)[:, -1], axis=0)).sum() for i in range(len(still))]
    assert max(moved) < 1e-3
    refuses("choose 'habit' or 'knows'", loaded.simulate, reading="mixed")
    refuses("time_limitt", loaded.simulate, time_limitt=3)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"rebound": True}, "rebound changes"),
        ({"contact_radius": 0.05, "senses_course": True}, "senses_course changes"),
        ({"senses_past": True}, "senses_past changes"),
        ({"arena": "open", "time_limit": 9}, "arena changes"),
        ({"num_pursuers": 1}, "num_pursuers changes"),
    ],
)
def test_what_would_show_the_policy_something_else_is_refused_by_name(
    options: dict[str, Any], word: str, run: Run
) -> None:
    refuses(f"^{word} the inputs of the policy", load_run(run.path).simulate, **options)


def test_the_page_runs_in_ten_lines(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (program,) = blocks(PAGE)
    assert len(program.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "first").symlink_to(run.path)
    run_programs(PAGE)
    said = capsys.readouterr().out
    assert said.count("caught in") == 2 and "prey 20 % stronger" in said


LIMIT = 20


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run whose episodes end after 20 steps; some of its recordings are longer."""
    longest = few().select(split="test").lengths.max() - 1
    assert longest > LIMIT
    options = {"time_limit": LIMIT, "contact_radius": 0.02, "arena": 1.5,
               "locomotion": {"prey": 0.5}, "observation_delay": 2}  # fmt: skip
    return made(tmp_path_factory.mktemp("limited"), env_kwargs=options)


def test_the_world_of_training_is_that_of_rollouts_watching_and_the_page(limited: Run) -> None:
    rollouts = limited.rollouts()["DQCIL-PT"]
    assert rollouts.lengths.max() - 1 <= LIMIT
    scenario = limited.scenario
    assert scenario.species.time_limit == LIMIT and scenario.species.contact_radius == 0.02
    assert scenario.species.arena.size == 1.5 and scenario.observation_delay == 2
    # Training, evaluation and watching share it: a factor on the thrust is not applied again.
    species = limited.species
    fitted = limited.fit.locomotion[2]
    assert species.locomotion[2].thrust == pytest.approx(0.5 * fitted.thrust)
    env = limited.environment()
    world, _ = prepare("AnimaRL/Agent-v0", model=limited.path, acting="greedy")
    assert env.scenario.species == species == limited.scenario.species
    assert world.scenario.species == species
    assert env.scenario.observation_delay == world.scenario.observation_delay == 2
    pipeline.evaluate_run(limited)
    page = pipeline.report(limited).read_text()
    for words in (f"{LIMIT} steps (2 s)", "0.02 arena units", "environment.time_limit",
                  "world.contact radius", "locomotion of prey"):  # fmt: skip
        assert words in page, words


def test_fewer_pursuers_hold_everywhere(tmp_path: Path) -> None:
    run = made(tmp_path, env_kwargs={"num_pursuers": 1})
    rollouts: Rollouts = run.rollouts()["DQCIL-PT"]
    assert rollouts.individuals == ("predator_0", "prey")
    test = first_of_role(few(), "num_pursuers", 1).select(split="test")
    starts = rollouts.positions[rollouts.offsets[:-1]]
    recorded = test.positions[test.offsets[:-1]][rollouts.demo]
    assert np.abs(starts - recorded).max() < 1e-6
    world, actor = prepare("AnimaRL/Agent-v0", model=run.path, acting="greedy")
    world.reset()
    assert actor(world, True).shape == (1, 2)


@pytest.mark.parametrize(("preset", "kind"), [("default", "full"), ("paper", "paper")])
def test_a_run_keeps_its_world_whatever_the_defaults_become(
    tmp_path: Path, preset: str, kind: str
) -> None:
    settings = RunSettings(
        file="packaged", species="fly", algo="bc", steps=1, copies=2, preset=preset
    )
    run = Run(tmp_path)
    run.start(settings, load_demonstrations("packaged", species="fly"), "made by the test")
    recorded = json.loads((tmp_path / "settings.json").read_text())["environment"]
    assert recorded["observation"] == kind and recorded["rebound"] == (kind == "full")
    fit_locomotion(run.demos, "onset").save(tmp_path / "locomotion.json")
    assert run.species.observation == kind
    assert run.species.arena.edge == {"full": 1.0, "paper": 1.1}[kind]
    env = run.environment()
    assert env.scenario.species == run.species
    assert (env.observation_space.shape == (19,)) == (kind == "paper")


HOLD = """
import sys, time
from pathlib import Path
from animarl_algos.runs.run import Run
with Run(Path(sys.argv[1])).lock():
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_second_process_is_told_and_a_killed_one_lets_go(tmp_path: Path) -> None:
    run = Run(tmp_path)
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout is not None and first.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="another process is at work"), run.lock():
            pass
        first.kill()
    for folder in (tmp_path, tmp_path / "nowhere"):  # stages of one process may call each other
        with Run(folder).lock(), Run(folder).lock():
            pass
    assert not (tmp_path / "nowhere").exists()


def git(folder: Path, *arguments: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", "-C", str(folder), *who, *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_the_commit_is_that_of_the_code_and_changes_are_told(tmp_path: Path) -> None:
    assert "no checkout" in commit(tmp_path)
    git(tmp_path, "init", "-q")
    assert "git did not tell" in commit(tmp_path)  # nothing was ever committed
    (tmp_path / "code.py").write_text("1\n")
    git(tmp_path, "add", "code.py")
    git(tmp_path, "commit", "-q", "-m", "Begin")
    head = git(tmp_path, "rev-parse", "HEAD")
    assert commit(tmp_path) == head
    (tmp_path / "code.py").write_text("2\n")
    assert commit(tmp_path) == f"{head} with changes"


def test_times_of_a_stage_add_up_and_what_fails_is_not_timed(tmp_path: Path) -> None:
    run = Run(tmp_path)
    with pytest.raises(ZeroDivisionError), run.timed("training"):
        _ = 1 / 0
    assert run.wall_times() == {}
    with run.timed("training"):
        pass
    once = run.wall_times()["training"]
    with run.timed("training"):
        pass
    assert run.wall_times()["training"] >= once >= 0.0


def test_machine_times_and_settings_are_told_in_words() -> None:
    told = machine()
    assert set(told) == {"commit", "system", "processor", "accelerator"}
    assert all(text and "None" not in text for text in told.values())
    assert "logical cores" in told["processor"]
    assert [duration(s) for s in (3.21, 90.0, 600.0, 9000.0)] == [
        "3.2 s", "90.0 s", "10.0 min", "2.5 h",
    ]  # fmt: skip
    settings = {"a": None, "b": {"c": True, "d": []}, "e": [1, None], "f": {}, "g": ""}
    assert flattened(settings) == [
        ("a", "not set"), ("b.c", "yes"), ("b.d", "not set"), ("e", "1, not set"),
        ("f", "not set"), ("g", "not set"),
    ]  # fmt: skip


def run_of(folder: Path, algo: str, curves: dict[str, list[float]]) -> SimpleNamespace:
    log = folder / "logs" / algo / "000"
    log.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame({INFORMATION + name: values for name, values in curves.items()})
    table.to_csv(log / "progress.csv", index=False)
    return SimpleNamespace(
        path=folder, settings=SimpleNamespace(algo=algo), record={"learner": {}},
        acting_file=lambda name: folder / "policies" / f"{name}.acting.json",
    )  # fmt: skip


def test_a_clone_that_learned_nothing_is_named(tmp_path: Path) -> None:
    curves = {"": [0.2, 0.0], "/male": [0.1, 0.05], "/female": [0.3, -0.05]}
    (sentence,) = uninformative_clones(run_of(tmp_path, "soft-bc", curves))
    assert "clone of male is no better than predicting action frequencies" in sentence
    assert uninformative_clones(run_of(tmp_path, "bc", {"": [0.3, -0.1]})) == []
    assert uninformative_clones(run_of(tmp_path, "dqdil-pt", curves)) == []  # values, no logits


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"short": 1.9, "repeats": True}, []),
        ({"short": 2.1, "repeats": True}, ["No candidate"]),
        ({"short": 2.1, "repeats": False}, ["No candidate", "The choice"]),
        ({}, []),
    ],
    ids=["near", "far", "far and not repeated", "of an older model"],
)
def test_acting_rules_that_are_all_far_are_said(
    tmp_path: Path, choice: dict[str, Any], said: list[str]
) -> None:
    run = run_of(tmp_path, "soft-bc", {})
    assert far_acting_rules(run) == []  # --acting was given
    file = tmp_path / "policies" / "soft-bc.acting.json"
    file.parent.mkdir()
    file.write_text(json.dumps(choice))
    found = far_acting_rules(run)
    assert len(found) == len(said) and all(map(str.startswith, found, said))


@pytest.mark.slow
def test_warnings_stand_on_the_page_once() -> None:
    warned = replace(report_inputs(), warnings=("It jumps & jumps.", "It jumps & jumps."))
    page = rendered(warned)
    assert page.count('<p class="caution">It jumps &amp; jumps.</p>') == 1


@pytest.mark.slow
def test_folds_are_the_same_whatever_the_number_of_processes(tmp_path: Path) -> None:
    files = []
    for processes in (1, 2):
        run = made(tmp_path / str(processes), "soft-bc", demos=few(train=4), rolled_out=False)
        pipeline.cross_validate(run, 3, processes=processes, progress_bar=False)
        assert {"fold 2 of 3", "fold 3 of 3"} <= set(run.wall_times())
        policies = sorted((run.path / run_set.FOLDER).rglob("policies/*.pt"))
        files.append([file.read_bytes() for file in policies])
    assert len(files[0]) == 2 and files[0] == files[1]
