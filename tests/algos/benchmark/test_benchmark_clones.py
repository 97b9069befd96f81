"""Cells that begin with the same offline phase share it, and come to the same bytes as alone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from test_benchmark import bytes_of, run, tiny

from animarl_algos.benchmark.matrix import Matrix, claim_folder, plan, read_matrix
from animarl_algos.benchmark.pieces import Cell
from animarl_algos.learner.pretraining import Pretraining

EPOCHS = 2
PHASE = {"offline_epochs": EPOCHS, "offline_kwargs": {"updates_per_epoch": 2, "warm_up": 1}}
FEW = {"n_envs": 8, "train_freq": [25, "step"], "gradient_steps": 2, "batch_size": 8}
SHARING = ("soft-bc", "iq-learn", "dqaas", "dqdil-pt")


def alike(recipes: Sequence[str] = SHARING, **settings: dict[str, Any]) -> Matrix:
    """Recipes with the same tiny offline phase, but for ``settings``."""
    own = {"iq_learn": FEW} | settings
    each = {name: PHASE | own.get(name.replace("-", "_"), {}) for name in recipes}
    return tiny(
        species=["fly"], recipes=list(recipes), seeds=[0], references=[], steps=400, settings=each
    )


def shared(matrix: Matrix, *only: str) -> list[list[str]]:
    """Whose cells share a clone."""
    return [[cell.method for cell in one.cells] for one in plan(matrix).only(only).clones]


def results(cell: Cell, out: Path) -> dict[str, bytes]:
    """Its rollouts, weights, and last checkpoint: optimiser, replay, random states, curves."""
    folder = cell.folder(out)
    checkpoint = folder / "run" / "checkpoints" / cell.method / "checkpoint.npz"
    weights = folder / "run" / "policies" / f"{cell.method}.pt"
    files = [folder / "rollouts.npz", weights, checkpoint]
    return {file.name: file.read_bytes() for file in files}


@pytest.fixture
def epochs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The offline epochs that are trained from now on."""
    trained: list[int] = []
    original = Pretraining.train_epoch

    def counted(phase: Pretraining, dataset: Any) -> Any:
        trained.append(phase.progress.epoch)
        return original(phase, dataset)

    monkeypatch.setattr(Pretraining, "train_epoch", counted)
    return trained


def test_a_cell_begun_as_a_clone_is_the_cell_that_trained_alone(
    tmp_path: Path, epochs: list[int]
) -> None:
    matrix, together, alone = alike(), tmp_path / "together", tmp_path / "alone"
    told = run(matrix, together)
    assert not told.errors and epochs == list(range(EPOCHS))  # once, for four cells
    assert [name.split("/")[1] for name in told.begun if "/score" not in name] == [
        "world", "clone", *SHARING,
    ]  # fmt: skip
    epochs.clear()
    for method in SHARING:
        assert not run(matrix, alone, only=[f"*/{method}"]).errors
    assert epochs == [*range(EPOCHS)] * 4 and not (alone / "clones").exists()
    for cell in plan(matrix).cells:
        here, there = results(cell, together), results(cell, alone)
        assert len(here) == 3 and here == there, cell.name
    assert run(matrix, alone).begun == []  # nobody is left who would need the clone
    assert bytes_of(together) == bytes_of(alone)


PAIR = alike(("soft-bc", "dqaas"))


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recipes that begin as one clone, finished."""
    out = tmp_path_factory.mktemp("pair")
    assert not run(PAIR, out).errors
    return out


def test_a_clone_goes_on_after_an_interruption(
    pair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epochs: list[int]
) -> None:
    matrix, out = PAIR, tmp_path / "out"
    counted = Pretraining.train_epoch

    def interrupted(phase: Pretraining, dataset: Any) -> Any:
        if phase.progress.epoch == 1:
            raise KeyboardInterrupt
        return counted(phase, dataset)

    with monkeypatch.context() as patched:
        patched.setattr(Pretraining, "train_epoch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(matrix, out)
    assert not run(matrix, out).errors
    assert epochs == list(range(EPOCHS))
    assert bytes_of(out) == bytes_of(pair)


@pytest.mark.slow
def test_clones_by_two_processes_are_the_same(tmp_path: Path) -> None:
    matrix = PAIR.changed(seeds=(0, 1))
    for number in (1, 2):
        assert not run(matrix, tmp_path / str(number), processes=number).errors
    assert all(one.cost(tmp_path / "2") for one in plan(matrix).clones)
    assert bytes_of(tmp_path / "1") == bytes_of(tmp_path / "2")


def test_the_clone_stands_once_among_the_costs_and_curves_of_all(pair: Path) -> None:
    text = (pair / "costs.md").read_text()
    assert text.count("| fly/clone | 1 |") == 1 and "| fly/dqaas beside its clone | 1 |" in text
    asked = plan(PAIR)
    (clone,) = asked.clones
    assert [cell.cost(pair)["clone"] for cell in asked.cells] == [clone.name] * 2
    logs = [cell.folder(pair) / "run" / "logs" / cell.method for cell in asked.cells]
    assert all("offline/val" in (log / "000" / "progress.csv").read_text() for log in logs)


def test_a_clone_that_fails_leaves_its_cells_to_themselves(tmp_path: Path) -> None:
    (clone,) = plan(PAIR).clones
    claim_folder(tmp_path)
    clone.folder(tmp_path).mkdir(parents=True)
    (clone.folder(tmp_path) / "run").write_text("no folder")
    told = run(PAIR, tmp_path)
    assert list(told.errors) == [clone.name]
    assert "## Not there" not in (tmp_path / "leaderboard.md").read_text()


def test_only_the_same_phase_is_shared() -> None:
    assert shared(alike()) == [list(SHARING)]
    assert shared(alike(), "*/dqaas") == []
    assert shared(alike(), "*/dqaas", "*/iq-learn") == [["iq-learn", "dqaas"]]
    for changed in (
        {"offline_epochs": 3}, {"offline_learning_rate": 1e-3}, {"env_kwargs": {"labels": "hard"}},
        {"offline_kwargs": {"updates_per_epoch": 3, "warm_up": 1}}, {"offline_loss": "recipe"},
        {"policy_kwargs": {"hidden": 32}}, {"env_kwargs": {"observation": "paper"}},
    ):  # fmt: skip
        assert shared(alike(dqaas=changed)) == [["soft-bc", "iq-learn", "dqdil-pt"]], changed
    for online in (
        {"learning_rate": 1e-3}, {"n_envs": 3}, {"env_kwargs": {"dtw": "increment"}},
        {"offline_lambda3": 1.0},
    ):  # fmt: skip
        assert shared(alike(dqaas=online)) == [list(SHARING)], online
    quantiles = ("soft-bc", "dqaas", "qr-soft-bc", "qr-dqaas")
    assert shared(alike(quantiles)) == [["soft-bc", "dqaas"], ["qr-soft-bc", "qr-dqaas"]]


def test_presets_share_where_recipes_begin_as_clones() -> None:
    each = {name: {"offline_loss": "cloning"} for name in ("dqaas", "dqdil-pt")}
    paper = tiny(preset="paper", recipes=list(each), settings=each)
    assert plan(paper).clones == ()  # of the paper's observation and labels, which soft-bc is not
    few = {"species": ("agent", "silkmoth"), "seeds": (0, 1)}
    assert plan(read_matrix("paper").changed(**few)).clones == ()
    short = plan(read_matrix("short").changed(**few)).clones
    assert [(one.data, one.seed) for one in short] == [
        ("agent", 0), ("agent", 1), ("silkmoth", 0), ("silkmoth", 1),
    ]  # fmt: skip
    assert {tuple(c.method for c in one.cells) for one in short} == {SHARING}
