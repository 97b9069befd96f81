"""Exact resume: a run that was killed ends with the same weights as one that never was (CPU)."""

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import killed_runs
import numpy as np
import pytest
import torch
import toys
from pages import python
from pair_learners import SETTINGS, Interrupt, make_pair_learner, weights
from refusals import refuses

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import (
    latest_checkpoint,
    load_checkpoint,
    save_checkpoint,
    serialise_tensors,
    steps_done,
    summarise_error,
)
from animarl_algos.recipes.registry import DQDIL, DQN, QRDQN
from animarl_algos.runs.run import Run

STEPS = 400


def make(recipe: type[SequenceQLearning] = DQDIL, **more: Any) -> SequenceQLearning:
    return recipe("GruPolicy", toys.Pair(2), **SETTINGS | more)


def go_on(model: SequenceQLearning, folder: Path, steps: int = STEPS) -> SequenceQLearning:
    load_checkpoint(model, folder)
    return model.learn(steps - model.num_timesteps, reset_num_timesteps=False)


class Stop(CheckpointCallback):
    """Interrupts the online phase."""

    def at_boundary(self) -> None:
        super().at_boundary()
        if self.model.num_timesteps >= 200:
            raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("name", "more"),
    [
        *((name, {}) for name in ("dqdil", "dqaas", "qr-dqdil")),
        ("dqdil-pt", {"exploration": "boltzmann"}),  # at temperatures that were fitted
    ],
)
def test_a_resumed_run_equals_an_uninterrupted_one(
    name: str, more: dict[str, Any], tmp_path: Path
) -> None:
    """The checkpoint is taken in mid-episode, with another seed and other weights to overwrite."""
    straight = make_pair_learner(name, **more).learn(STEPS)
    with pytest.raises(KeyboardInterrupt):
        make_pair_learner(name, **more).learn(STEPS, callback=Stop(tmp_path, every=150))
    resumed = go_on(make_pair_learner(name, **more, seed=99), tmp_path)
    assert torch.equal(weights(straight), weights(resumed))
    assert straight.num_timesteps == resumed.num_timesteps
    assert straight.policy.acting == resumed.policy.acting
    assert straight._n_updates == resumed._n_updates > 0


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_a_run_that_is_told_to_stop_writes_a_checkpoint_first(
    number: int,
    raised: type[BaseException],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    before = signal.getsignal(number)
    with pytest.raises(raised):
        make().learn(STEPS, callback=Interrupt(tmp_path, 120, number), progress_bar=True)
    assert signal.getsignal(number) is before
    assert capsys.readouterr().err.endswith("\n")  # what is said next has a line of its own
    resumed = go_on(make(), tmp_path)
    assert torch.equal(weights(make().learn(STEPS)), weights(resumed))


def test_an_unfinished_checkpoint_is_passed_over_and_goes_with_the_next(tmp_path: Path) -> None:
    model = make().learn(100)
    whole, orphan = save_checkpoint(model, tmp_path), tmp_path / ".checkpoint.12345678.part.npz"
    orphan.touch()
    os.utime(orphan, (0, 0))
    assert latest_checkpoint(tmp_path) == whole == save_checkpoint(model, tmp_path)
    assert [*tmp_path.iterdir()] == [whole]


FOLDERS = (str(Path(__file__).parent), str(Path(__file__).parents[2]))
FULL = """
import resource, signal, sys
sys.path[:0] = sys.argv[2:]
from pathlib import Path
from animarl_algos.runs.run import Run
from animarl_envs.errors import InputError
from test_resume import make, load_checkpoint, save_checkpoint, weights
folder = Path(sys.argv[1]) / "checkpoints"
run = Run(folder.parent)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
model = make().learn(100)
whole = save_checkpoint(model, folder).stat().st_size
for limit in (0, 100, 5000, whole // 2, whole - 1):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    for save in (lambda: save_checkpoint(model, folder), lambda: run.save_policy("dqdil", model)):
        try:
            save()
        except InputError as error:
            print(error)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    assert [path.name for path in folder.iterdir()] == ["checkpoint.npz"], limit
    assert not [path for path in run.path.glob("policies/*") if ".part" in path.name], limit
    restored = make(seed=9)
    load_checkpoint(restored, folder)
    assert (weights(restored) == weights(model)).all()
"""


@pytest.mark.slow
def test_a_full_disk_leaves_the_last_one(tmp_path: Path) -> None:
    """Files that may not grow, up to one byte less than a whole file of the checkpoint."""
    said = python(FULL, tmp_path, *FOLDERS).stdout.splitlines()
    assert sum("checkpoint" in line for line in said) == 5
    assert sum("dqdil.pt" in line for line in said) >= 2
    assert all("cannot be written (File too large)" in line for line in said), said


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (lambda: make(DQN), "algorithm is 'DQDIL' there, 'DQN' here"),
        (lambda: make(QRDQN), "algorithm is 'DQDIL' there, 'QRDQN' here"),
        (lambda: make(policy_kwargs={"hidden": 16}), "parameters is"),
        (lambda: DQDIL("GruPolicy", toys.Pair(4), **SETTINGS), "num_copies is 2 there, 4 here"),
        (lambda: DQDIL("MlpPolicy", toys.Pair(2), **SETTINGS), "policy is 'GruPolicy' there"),
    ],
)
def test_a_foreign_checkpoint_is_refused(
    other: Callable[[], SequenceQLearning], words: str, tmp_path: Path
) -> None:
    save_checkpoint(make().learn(20), tmp_path)
    refuses(words, load_checkpoint, other(), tmp_path)


def test_a_damaged_checkpoint_or_one_with_a_spoilt_part_is_refused(tmp_path: Path) -> None:
    file = save_checkpoint(make().learn(100), tmp_path)
    whole = file.read_bytes()
    for damage in (b"", b"text", b"PK\x03\x04", b"[1, 2]", whole[:9_000]):
        file.write_bytes(damage)
        refuses("damaged", load_checkpoint, make(), tmp_path)
    for part in ("state", "model", "replay"):
        with np.load(io.BytesIO(whole)) as archive:
            kept = {name: archive[name] for name in archive if name.partition("/")[0] != part}
        for spoilt in ({}, {part: np.array("text")}, {part: np.array("[1, 2]")}):
            np.savez(file, **kept, **spoilt)
            refuses("damaged|lacks", load_checkpoint, make(), tmp_path)


def flip_a_bit(file: Path, model: SequenceQLearning) -> None:
    """In the middle of the model's largest weights, as they stand in ``file``."""
    largest = max(model.policy.q_net.state_dict().values(), key=torch.numel)
    stored = largest.numpy().tobytes()
    content = bytearray(file.read_bytes())
    content[content.index(stored) + len(stored) // 2] ^= 0x40
    file.write_bytes(content)


def test_one_flipped_bit_of_the_weights_is_seen(tmp_path: Path) -> None:
    """PyTorch would load them: it does not look at the checksums of its archives."""
    model, other, run = make().learn(20), make(seed=9), Run(tmp_path)
    before = weights(other)
    checkpoint = save_checkpoint(model, tmp_path)
    flip_a_bit(checkpoint, model)
    refuses(
        r"damaged \(BadZipFile: Bad CRC-32 for file 'model.npy'", load_checkpoint, other, tmp_path
    )
    run.save_policy("dqdil", model)
    flip_a_bit(tmp_path / "policies" / "dqdil.pt", model)
    refuses(r"dqdil.pt has changed .* remove it and train again", run.load_policy, "dqdil", other)
    assert torch.equal(weights(other), before)


def test_what_is_wrong_is_said_in_whole_words(tmp_path: Path) -> None:
    """Not in those of PyTorch, which explains at length how to open a pickle all the same."""
    checkpoint = save_checkpoint(make().learn(20), tmp_path)
    with np.load(checkpoint) as archive:
        arrays = dict(archive)
    hostile = serialise_tensors({"torch_random_state": make})
    np.savez(checkpoint, **arrays | {"model": np.frombuffer(hostile, np.uint8)})
    said = refuses("", load_checkpoint, make(), tmp_path)
    assert said == (
        f"{checkpoint}: the checkpoint is damaged (model is no whole archive of tensors): "
        "put a copy of this file in its place, or remove it and start the run anew"
    )
    assert summarise_error(OSError("word " * 40)) == "OSError: " + "word " * 21 + "..."
    assert summarise_error(KeyError("format")) == "KeyError: 'format'"


def test_a_checkpoint_may_be_named_itself_and_is_no_damaged_one_where_it_may_not_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(file: Path, *_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied", str(file))

    refuses(r"there is no checkpoint", load_checkpoint, make(), tmp_path)
    model, resumed = make().learn(20), make(seed=9)
    file = save_checkpoint(model, tmp_path).rename(tmp_path / "mine.npz")
    load_checkpoint(resumed, file)
    assert torch.equal(weights(resumed), weights(model))
    monkeypatch.setattr(Path, "open", forbidden)
    refuses(r"mine.npz: it cannot be read: check its", load_checkpoint, model, file)


def kill(run: str, folder: Path, boundaries: int, delay: float) -> None:
    """Start ``run`` and kill it ``delay`` seconds after so many boundaries between updates."""
    command = [sys.executable, str(Path(killed_runs.__file__)), run, str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout:
        for _ in range(boundaries):
            assert process.stdout.readline() == "boundary\n", "it ended before it was to be killed"
        time.sleep(delay)
        process.kill()
        process.wait()


def kills_leave_no_trace(run: str, folder: Path, moments: list[tuple[int, float]]) -> None:
    """The first of the ``moments`` must lie in the offline phase, the others after it."""
    straight = killed_runs.RUNS[run](folder / "straight")
    killed, reached = folder / "killed", []
    for boundaries, delay in moments:
        kill(run, killed, boundaries, delay)
        reached.append(steps_done(next(killed.rglob("checkpoint.npz"))))
    assert reached[0] == 0 < reached[-1] < straight.num_timesteps
    resumed = killed_runs.RUNS[run](killed)
    assert torch.equal(weights(straight), weights(resumed))
    assert straight._n_updates == resumed._n_updates > 0


@pytest.mark.slow
def test_a_short_run_killed_offline_and_online(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    offline = (int(rng.integers(3, killed_runs.EPOCHS + 1)), rng.uniform(0.0, 0.05))
    online = (int(rng.integers(15, 25)), rng.uniform(0.0, 0.01))
    kills_leave_no_trace("toy", tmp_path, [offline, online])


@pytest.mark.slow
def test_a_run_of_the_agents_killed_again_and_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    offline = [(int(rng.integers(3, killed_runs.EPOCHS + 1)), rng.uniform(0.0, 1.0))]
    online = [(int(rng.integers(8, 16)), rng.uniform(0.0, 0.1)) for _ in range(4)]
    kills_leave_no_trace("agent", tmp_path, offline + online)
