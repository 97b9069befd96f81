"""The packaged chases of the agents: that they were learnt, that they repeat, what they hold."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses
from typer.testing import CliRunner

from animarl_algos.evaluation.teams import load_weights, make_policy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import FOLDER, load_packaged
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.importing.readers import read_tracks
from animarl_envs.species import AGENT
from tools.packaged_data.trained_chase.__main__ import app, main
from tools.packaged_data.trained_chase.chases import EPSILON, Chases, chase, generate
from tools.packaged_data.trained_chase.comparison import (
    difference_interval,
    encirclement,
    measure,
    statistics_table,
)
from tools.packaged_data.trained_chase.training import (
    PACKAGED_WEIGHTS,
    ChaseTraining,
    mixed_weights,
    train,
    weights_file,
)

PACKAGED = load_packaged("agent")

TINY = ChaseTraining(steps=1500, copies=16, buffer_size=10_000, checkpoint_every=500)


def captures(chases: Chases) -> float:
    return float((chases.outcome > 0).mean())


def durations(chases: Chases) -> NDArray[np.float64]:
    return np.array([(len(path) - 1) * AGENT.dt for path in chases.paths])


def test_seconds_of_training_make_hunters(tmp_path: Path) -> None:
    settings = replace(TINY, steps=4000, exploration_steps=2000)
    trained, meta = load_weights(train(0, 0, settings, tmp_path, progress_bar=False))
    before = chase(make_policy(None, epsilon=EPSILON, seed=0), 0, 100, seed=0)
    after = chase(make_policy(trained, epsilon=EPSILON, seed=0), 0, 100, seed=0)
    assert meta["seed"] == 0
    assert captures(before) < 0.2
    assert captures(after) > 0.5


def test_weights_of_other_settings_are_not_taken_for_these(tmp_path: Path) -> None:
    few = replace(TINY, steps=32)
    train(0, 0, few, tmp_path, progress_bar=False)
    assert train(0, 0, few, tmp_path, progress_bar=False) == weights_file(tmp_path, 0)
    for seed, asked in ((0, replace(few, gamma=0.5)), (1, few)):
        words = r"individual\.npz.*other settings or another seed"
        refuses(words, train, 0, seed, asked, tmp_path, progress_bar=False)


def test_one_command_trains_rolls_out_and_repeats(tmp_path: Path) -> None:
    def run(*arguments: str) -> str:
        done = CliRunner().invoke(app, [*arguments], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.output

    folder = str(tmp_path / "runs")
    made, again = tmp_path / "made.npz", tmp_path / "again.npz"
    common = ["--seed", "1", "--episodes", "10"]
    said = run("make", "--steps", "320", "--folder", folder, "--out", str(made), *common)
    assert "individual reward: 10 synthetic episodes" in said
    assert "shared reward: 10 synthetic episodes" in said
    assert f"fingerprint {Demonstrations.load(made).fingerprint()})" in said
    run("roll-out", "--weights", folder, "--out", str(again), *common)
    assert made.read_bytes() == again.read_bytes()
    tables = run("compare", str(made), "--weights", folder, "--episodes", "5")
    assert tables.count("\n\n") == 2
    assert "| untrained | untrained |" in tables


def test_other_numbers_of_predators_are_a_strangers_table(tmp_path: Path) -> None:
    table, folder = tmp_path / "three.csv", tmp_path / "runs"
    asked = ["table", "--pursuers", "3", "--steps", "320", "--episodes", "12"]
    done = CliRunner().invoke(app, [*asked, "--out", str(table), "--folder", str(folder)])
    assert "12 synthetic chases" in done.output
    names = ("predator_0", "predator_1", "predator_2", "prey")
    (tracks,) = {t.individuals for t in read_tracks(table, fps=10.0)}
    assert sorted(tracks) == sorted(names)
    fewer = replace(ChaseTraining(), steps=320)
    refuses(r"individual\.npz.*other settings", train, 0, 0, fewer, folder, pursuers=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["make", "--steps", "0"], "steps is 0"),
        (["roll-out", "--weights", "nowhere"], "individual.npz"),
        (["roll-out", "--episodes", "0"], "episodes is 0"),
        (["compare", "no.npz"], "no.npz"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["trained_chase", *arguments])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_file_that_holds_no_weights_is_refused(tmp_path: Path) -> None:
    np.savez(weights_file(tmp_path, 0), something=np.zeros(3))
    refuses(r"individual\.npz: it holds no weights", generate, tmp_path, 0, 2)
    refuses("do not fit", make_policy, {"something": np.zeros(3, np.float32)}, epsilon=0.0, seed=0)


def test_packaged_chases_are_many_small_split_and_called_synthetic() -> None:
    assert (FOLDER / "agent.npz").stat().st_size < 2_000_000
    assert PACKAGED.synthetic
    assert "trained artificial agents" in PACKAGED.provenance["source"]
    for condition in (0, 1):
        splits = PACKAGED.split[PACKAGED.condition == condition]
        found = [int((splits == name).sum()) for name in ("train", "val", "test")]
        assert found == [200, 25, 25]


def test_packaged_chases_come_from_the_packaged_weights() -> None:
    """Another processor may round a tie of two actions otherwise, so a few may differ."""
    repeated = generate(PACKAGED_WEIGHTS, 0, 250)
    alike = sum(
        a.positions.shape == b.positions.shape
        and np.allclose(a.positions, b.positions, atol=1e-5)
        and a.outcome == b.outcome
        for a, b in zip(PACKAGED, repeated, strict=True)
    )
    assert alike >= 0.95 * len(PACKAGED)


def test_packaged_chases_obey_the_dynamics() -> None:
    fit = fit_locomotion(PACKAGED, "joint", seed=0, bootstrap=0)
    for locomotion in fit.locomotion:
        assert locomotion.damping == pytest.approx(0.25, abs=1e-3)
        assert locomotion.thrust == pytest.approx(3.0, abs=1e-3)
    inferred = demonstrated_actions(PACKAGED, AGENT.locomotion)
    recorded = PACKAGED.signals["actions"]
    acting = recorded >= 0
    assert (inferred[acting] == recorded[acting]).mean() > 0.999


def test_everybody_has_learned() -> None:
    """Untrained prey is caught sooner; untrained predators catch nobody; few leave the arena."""
    untrained: dict[str, Any] = {
        key: value.detach().numpy()
        for key, value in make_policy(None, epsilon=0.0, seed=0).q_net.named_parameters()
    }
    rng = np.random.default_rng(0)
    for condition in (0, 1):
        weights, _ = load_weights(weights_file(PACKAGED_WEIGHTS, condition))
        who = dict.fromkeys(AGENT.individuals, weights)
        cases = {
            "trained": who,
            "prey": who | {"prey": untrained},
            "predators": who | {"predator_0": untrained, "predator_1": untrained},
        }
        found = {
            name: chase(make_policy(mixed_weights(sources), epsilon=EPSILON, seed=0), 0, 300, 5)
            for name, sources in cases.items()
        }
        longer = difference_interval(durations(found["trained"]), durations(found["prey"]), rng)
        assert longer.low > 0
        assert captures(found["trained"]) > 0.3
        assert captures(found["predators"]) < 0.1
        assert (found["trained"].outcome < 0).mean() < 0.2


def test_shared_reward_makes_other_hunters() -> None:
    individual, shared = (measure(PACKAGED.select(condition=c)) for c in (0, 1))
    rng = np.random.default_rng(0)
    for name in (
        "distance between the predators [arena unit]",
        "angle between the predators, seen from the prey [deg]",
    ):
        assert difference_interval(shared[name], individual[name], rng).excludes_zero, name


@pytest.mark.parametrize(
    ("second", "angle"), [((2.0, 0.0), 0.0), ((0.0, -3.0), 90.0), ((-1.0, 0.0), 180.0)]
)
def test_encirclement_is_the_angle_at_the_prey(second: tuple[float, float], angle: float) -> None:
    path = np.array([[[1.0, 0.0], second, [0.0, 0.0]]]) + 0.3
    assert encirclement(path) == pytest.approx([angle])


@pytest.mark.realdata
def test_table_beside_the_local_recordings(data_dir: Path) -> None:
    rows = statistics_table(PACKAGED, data_dir / "agents_collab_hunting")
    found = {cells[1].strip(): cells for cells in (row.split("|") for row in rows)}
    assert found["captured"][2].strip() == "0.672 / 0.814"
    assert found["captured"][3].strip() == "0.180 / 0.396"
    assert found["episodes"][4].strip() == "250 / 250"
