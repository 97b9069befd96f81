"""Where the recorded data lies, what is skipped without data or device, and one torch thread."""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # of torch, here and in subprocesses

DATA = Path(os.environ.get("ANIMARL_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
NEEDS: dict[str, tuple[Callable[[], bool], str]] = {
    "realdata": (DATA.is_dir, f"recorded data not found at {DATA}; set ANIMARL_DATA"),
    "cuda": (
        lambda: import_module("torch").cuda.is_available(),
        "no CUDA device (docs/learners.md, Devices)",
    ),
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs data or a device that is not here."""
    for marker, (is_here, reason) in NEEDS.items():
        needing = [item for item in items if item.get_closest_marker(marker)]
        if needing and not is_here():
            for item in needing:
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    return DATA


@pytest.fixture(scope="module")
def _garbage_collected() -> None:
    """What earlier tests left open is no warning in a module that takes warnings as errors.

    The pipes of ffmpeg, for one, which imageio does not close.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture(autouse=True, scope="session")
def _ctrl_c_is_heard() -> None:
    """Also where the tests were started in the background, which has children ignore Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _logs_of_learners(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Stable-baselines3 makes a folder for its logs with every learner: here, not in /tmp."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.mktemp("logs")))
        yield


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser for all pages of a module; its event loop ends with it."""
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    from browser import chromium

    with chromium() as started:
        yield started


@pytest.fixture
def animarl(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Iterator[Callable[..., Any]]:
    """The command line in this process, in a folder of its own: what it printed and its status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: object) -> Any:
        from commands import Done

        from animarl_algos.cli.main import main

        monkeypatch.setattr(sys, "argv", ["animarl", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return Done(int(ended.value.code or 0), said.out, said.err)

    yield call
    if metrics := sys.modules.get("animarl_algos.evaluation.metrics"):
        metrics.METRICS[:] = [metric for metric in metrics.METRICS if metric.own is None]
