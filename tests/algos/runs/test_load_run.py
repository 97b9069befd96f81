"""A run in Python: what ``load_run`` gives, and the program of docs/what_if.md."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_runs import few, made

from animarl_algos import load_run
from animarl_algos.runs.pretrained import model_folder
from animarl_algos.runs.run import Run
from animarl_envs.errors import InputError

PAGE = Path(__file__).parents[3] / "docs" / "what_if.md"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return made(tmp_path_factory.mktemp("runs"), "soft-bc", demos=few(), rolled_out=False)


def test_a_loaded_run_has_its_policy_world_and_demonstrations(run: Run) -> None:
    loaded = load_run(run.path)
    assert loaded.demos.fingerprint() == run.demos.fingerprint()
    assert loaded.scenario.species.locomotion == run.fit.locomotion
    observation = np.zeros((3, *loaded.policy.observation_space.shape), dtype=np.float32)
    actions, _ = loaded.policy.predict(observation)
    assert actions.shape == (3,)
    with pytest.raises(InputError, match="no such folder and no packaged model"):
        load_run(run.path / "nowhere")
    with pytest.raises(InputError, match="not a run folder"):
        load_run(PAGE.parent)


def test_a_packaged_model_is_loaded_by_its_name() -> None:
    loaded = load_run("fly")
    assert loaded.path == model_folder("fly")
    assert loaded.scenario.species.locomotion == loaded.fit.locomotion


def test_each_file_of_a_run_is_read_once(run: Run) -> None:
    opened: list[str] = []
    watching = True

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if watching and event == "open" and str(arguments[0]).startswith(str(run.path)):
            opened.append(Path(arguments[0]).name)

    sys.addaudithook(note)  # which cannot be taken away again
    loaded = load_run(run.path)
    loaded.simulate(repetitions=1, time_limit=5)
    watching = False
    assert len(loaded.demos) == len(run.demos)
    assert sorted(opened) == [
        "demonstrations.npz", "demonstrations.npz",  # what it announces, then its arrays
        "locomotion.json", "settings.json", "soft-bc.pt",
    ]  # fmt: skip


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
    with pytest.raises(InputError, match="changes what the policy is shown"):
        loaded.simulate(num_pursuers=1)
    with pytest.raises(InputError, match="choose 'habit' or 'knows'"):
        loaded.simulate(reading="mixed")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="time_limitt"):
        loaded.simulate(time_limitt=3)


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
    with pytest.raises(InputError, match=f"^{word} what the policy is shown"):
        load_run(run.path).simulate(**options)


def test_the_page_runs_in_ten_lines(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.M | re.S)
    assert len(program.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "first").symlink_to(run.path)
    exec(compile(program, str(PAGE), "exec"), {})
    said = capsys.readouterr().out
    assert said.count("caught in") == 2 and "prey 20 % stronger" in said
