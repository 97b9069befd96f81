"""Worlds at the edge of what options allow: they start, they stay finite, or they are refused."""

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from animarl_envs.errors import InputError
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world


def test_so_many_pursuers_that_hardly_ever_all_are_apart_start_without_contact() -> None:
    scenario = make_scenario("agent", num_pursuers=1000, start="uniform")
    world = make_world(scenario, 2, observers=[])
    world.reset()
    apart = np.linalg.norm(world.position[:, :-1] - world.position[:, -1:], axis=-1)
    assert apart.min() >= scenario.species.contact_radius
    assert np.abs(world.position).max() <= scenario.species.start_half_side
    assert world.position[:, :-1].std() > 0.5 * scenario.species.start_half_side / np.sqrt(3.0)


@pytest.mark.parametrize(
    "options",
    [
        {"locomotion": {"prey": {"thrust": 1e-320}}},
        {"locomotion": {"prey": {"thrust": 1e308}}},
        {"locomotion": {"prey": {"magnitudes": (1e300,)}}},
        {"arena": 1e200},
        {"dt": 1e300},
        {"observation_noise": 1e300},
    ],
)
def test_options_that_make_observations_infinite_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="which float32 cannot hold: choose"):
        make_world(make_scenario("agent", demos=None, **options))


@pytest.mark.parametrize(
    "options", [{"locomotion": {"prey": {"thrust": 1e-30}}}, {"arena": 1e20}, {"dt": 1e-9}]
)
def test_odd_options_keep_observations_finite(options: dict[str, Any]) -> None:
    world = make_world(make_scenario("agent", demos=None, **options))
    world.reset()
    for action in range(13):
        world.step(np.full((1, 3), action))
        assert np.isfinite(world.observation).all()


PROGRAM = """
import numpy as np
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
options = {"agent": {}, "newt": {"senses_heading": True}, "silkmoth": {"plume": "off"}}
for name in options:
    world = make_world(make_scenario(name, **options[name]), 2)
    world.reset()
    for action in range(13):
        world.step(np.full((2, world.num_individuals), action))
        print(*np.float64(world.observation).ravel())
"""


def test_kernels_run_as_they_are_written_where_numba_is_off() -> None:
    """So that ``make mutants`` sees them."""
    printed = []
    for off in ("1", "0"):
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", PROGRAM],
            env=os.environ | {"NUMBA_DISABLE_JIT": off}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        printed.append(np.array(done.stdout.split(), dtype=float))
    assert len(printed[0]) > 1000
    np.testing.assert_allclose(printed[0], printed[1], atol=1e-5)
