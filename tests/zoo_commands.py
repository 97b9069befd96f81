"""``python -m animarl_algos.zoo`` for tests, in this process."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import Done
from small_runs import few

from animarl_algos.zoo.__main__ import main

AGENT = "AnimaRL/Agent-v0"
CARTPOLE = ["--env", "CartPole-v1", "-n", "16", "--eval-episodes", "1"]
TINY = ["--n-timesteps", "200", "--seed", "1", "--eval-freq", "100", "--eval-episodes", "2"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations of a few short episodes of both conditions in each split."""
    return few(train=6, val=3, test=3, skip=5).save(tmp_path_factory.mktemp("demos") / "small.npz")


@pytest.fixture
def zoo(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., Done]:
    """The command with these arguments, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["zoo", *arguments])
        monkeypatch.setattr(sys, "orig_argv", ["zoo", *arguments])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        said = capfd.readouterr()
        return Done(code, said.out, said.err)

    return call
