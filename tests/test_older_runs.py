"""Run folders say which world they were trained in; those from before it could vary, too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from animarl_algos.runs.pipeline import load_demonstrations
from animarl_algos.runs.run_folder import RunFolder
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.fitting import fit_locomotion

WORLD = {"observation": "paper", "rebound": False}


def begun(path: Path, **more: Any) -> RunFolder:
    settings = RunSettings(file="packaged", species="fly", algo="bc", steps=1, copies=2, **more)
    demos = load_demonstrations("packaged", species="fly")
    run = RunFolder(path)
    run.start(settings, demos, "made by the test")
    return run


@pytest.mark.parametrize(("preset", "kind"), [("default", "full"), ("paper", "paper")])
def test_a_run_keeps_its_world_whatever_the_defaults_become(
    tmp_path: Path, preset: str, kind: str
) -> None:
    run = begun(tmp_path, preset=preset)
    recorded = json.loads((tmp_path / "settings.json").read_text())["environment"]
    assert recorded["observation"] == kind and recorded["rebound"] == (kind == "full")
    demos = run.demos
    species = run.species(demos, fit_locomotion(demos, "onset"))
    assert species.observation == kind
    assert species.arena.edge == {"full": 1.0, "paper": 1.1}[kind]
    env = run.environment(species, demos)
    assert env.scenario.species == species
    assert (env.observation_space.shape == (19,)) == (kind == "paper")


def test_a_run_from_before_has_the_papers_world(tmp_path: Path) -> None:
    begun(tmp_path)
    file = tmp_path / "settings.json"
    record = json.loads(file.read_text())
    record["environment"] = {}
    file.write_text(json.dumps(record))
    run = RunFolder(tmp_path)
    assert run.environment_options == WORLD
    species = run.species(run.demos, fit_locomotion(run.demos, "onset"))
    assert species.observation == "paper" and not species.arena.rebound
    assert run.environment(species, run.demos).observation_space.shape == (19,)
