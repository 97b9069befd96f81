"""The worlds of the package are the same to the bit on every processor."""

import os
import platform
from pathlib import Path

import pytest
from pages import python

ROOT = Path(__file__).resolve().parents[3]
HASHES = {
    "agent": "c24127dcec98abec",
    "fly": "279f53844daa49c6",
    "newt": "bfdceaf10dceabfc",
    "silkmoth": "e64a6fbf80e54153",
}
STEPS = """
import hashlib
import sys

import numpy as np

from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

for name in sys.argv[1:]:
    world, found = make_world(make_scenario(name), 40), hashlib.sha256()
    world.seed(np.arange(40))
    world.reset()
    draws = np.random.default_rng(0)
    for _ in range(250):  # 10,000 in all
        world.step(draws.integers(world.num_actions, size=(40, world.num_individuals)))
        for array in (world.observation, world.reward, world.terminated, world.truncated):
            found.update(np.ascontiguousarray(array).tobytes())
        world.reset(world.terminated | world.truncated)
    print(name, found.hexdigest()[:16])
"""


def hashes(**environment: str) -> dict[str, str]:
    done = python(STEPS, *HASHES, env=os.environ | {"PYTHONPATH": str(ROOT)} | environment)
    return dict(line.split() for line in done.stdout.splitlines())


@pytest.mark.slow
def test_ten_thousand_steps_are_those_of_every_processor() -> None:
    assert hashes() == HASHES


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the processors are x86-64")
@pytest.mark.parametrize(
    ("cpu", "features"), [("x86-64-v2", "+sse4.2"), ("x86-64-v3", "+avx2,+fma,+bmi2")]
)
def test_vector_instructions_change_no_step(cpu: str, features: str, tmp_path: Path) -> None:
    names = {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": features}
    assert hashes(NUMBA_CACHE_DIR=str(tmp_path), **names) == HASHES
