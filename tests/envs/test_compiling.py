"""Compiled code follows its sources, and there is always a place to keep it."""

import json
import os
import platform
import re
import shutil
from pathlib import Path

import llvmlite.binding as llvm
import pytest
from numba import typeof
from pages import python

import animarl_algos
from animarl_envs.compiling import SHIPPED, TARGET, Target, _kernel_sources, source_key
from animarl_envs.focus import averaged
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES
from animarl_envs.worlds import make_world

ROOT = Path(__file__).resolve().parents[2]
KERNEL = """
from animarl_envs.compiling import jit
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.kinematics import next_velocity

@jit
def after(velocity):
    return next_velocity(velocity, 0.0, 0.5, 1.0, 1.0) + NUM_ACTIONS
"""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A folder with a copy of the environments' sources and one small kernel of their own."""
    ignored = shutil.ignore_patterns("*.npz", "__pycache__")
    shutil.copytree(ROOT / "animarl_envs", tmp_path / "animarl_envs", ignore=ignored)
    (tmp_path / "animarl_envs" / "probe.py").write_text(KERNEL)
    return tmp_path


def run_kernel(copied: Path, **environment: str) -> tuple[float, int, str]:
    """What the kernel gives for 1.0, how often it was loaded from disk, and what was warned of."""
    program = (
        "from animarl_envs.probe import after; "
        "print(after(1.0), sum(after.stats.cache_hits.values()))"
    )
    kept = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    done = python(program, cwd=copied, env=kept | {"PYTHONPATH": str(copied)} | environment)
    value, hits = done.stdout.split()
    return float(value), int(hits), done.stderr


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    later = path.stat().st_mtime + 2.0  # Python's cache goes by size and whole seconds
    os.utime(path, (later, later))


def test_a_kernel_is_kept_wherever_the_package_lies_until_what_it_holds_is_edited(
    copied: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    assert run_kernel(copied)[:2] == (13.5, 0)
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "other"
    shutil.copytree(copied, elsewhere, copy_function=shutil.copyfile)  # dates are new
    shutil.rmtree(copied)
    assert run_kernel(elsewhere)[:2] == (13.5, 1)  # kept on disk
    envs = elsewhere / "animarl_envs"
    edit(envs / "locomotion.py", "(1.0 - damping) * vel", "(2.0 - damping) * vel")
    assert run_kernel(elsewhere)[:2] == (14.5, 0)
    constant = re.search(r"^NUM_ACTIONS.*$", (envs / "locomotion.py").read_text(), re.MULTILINE)
    assert constant is not None
    edit(envs / "locomotion.py", constant[0], "NUM_ACTIONS = 20")
    assert run_kernel(elsewhere)[:2] == (21.5, 0)


def test_what_kernels_take_from_modules_without_kernels_is_in_the_key() -> None:
    root = ROOT / "animarl_envs"
    found = {str(path.relative_to(root)) for path in _kernel_sources({"animarl_envs": root})}
    # the transition, columns of an observation (both imported whole), codes of outcomes
    assert {"locomotion.py", "worlds/chase/layout.py", "demos/episode.py"} <= found
    assert "drawing/render.py" not in found


def test_the_users_own_folder_is_kept_to(copied: Path, tmp_path: Path) -> None:
    own = tmp_path / "own"
    assert run_kernel(copied, NUMBA_CACHE_DIR=str(own))[:2] == (13.5, 0)
    assert run_kernel(copied, NUMBA_CACHE_DIR=str(own))[:2] == (13.5, 1)
    assert list(own.glob("kernels-*/*/probe.after-*.nbc"))
    assert not list((copied / "animarl_envs").glob("__pycache__/kernels-*"))


def test_another_folder_takes_what_the_installation_compiled_until_a_source_is_edited(
    copied: Path, tmp_path: Path
) -> None:
    assert run_kernel(copied)[:2] == (13.5, 0)  # as `make .venv/.installed` does
    empty = {"NUMBA_CACHE_DIR": str(tmp_path / "empty")}
    assert run_kernel(copied, **empty)[:2] == (13.5, 1)
    assert not list((tmp_path / "empty").rglob("*.nbc"))
    other = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    assert run_kernel(copied, **empty, **other)[:2] == (13.5, 0)  # code of another processor
    edit(copied / "animarl_envs" / "locomotion.py", "(1.0 - damping) * v", "(2.0 - damping) * v")
    assert run_kernel(copied, **empty)[:2] == (14.5, 0)


def test_a_read_only_install_uses_a_temporary_folder_and_says_so_once(
    copied: Path, tmp_path: Path
) -> None:
    # Files where folders should be are refused to everybody, root included.
    (copied / "animarl_envs" / "__pycache__").write_text("")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    home = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "TMPDIR": str(temporary)}
    for environment in (home, {"NUMBA_CACHE_DIR": "/dev/null/x", "TMPDIR": str(temporary)}):
        value, hits, said = run_kernel(copied, **environment)
        assert (value, hits) == (13.5, 0)
        assert said.count("set NUMBA_CACHE_DIR to a folder that can be written") == 1
        assert list(temporary.iterdir()) == []  # tidied up


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the target is one of x86-64")
@pytest.mark.parametrize(("needs", "hits"), [("+sse4.2", 1), ("+sse4.2,+no-such-thing", 0)])
def test_machine_code_of_a_wheel_is_used_where_it_runs(
    copied: Path, tmp_path: Path, needs: str, hits: int
) -> None:
    shipped = copied / "animarl_envs" / SHIPPED.name
    target = Target(llvm.get_process_triple(), "x86-64-v2", "+sse4.2")
    names = {"NUMBA_CPU_NAME": target.cpu, "NUMBA_CPU_FEATURES": target.features}
    assert run_kernel(copied, NUMBA_CACHE_DIR=str(shipped), **names)[:2] == (13.5, 0)
    (shipped / TARGET).write_text(json.dumps(target._replace(features=needs)._asdict()))
    empty = {"NUMBA_CACHE_DIR": str(tmp_path / "empty")}
    assert run_kernel(copied, **empty)[:2] == (13.5, hits)
    edit(copied / "animarl_envs" / "locomotion.py", "(1.0 - damping) * v", "(2.0 - damping) * v")
    assert run_kernel(copied, **empty)[:2] == (14.5, 0)  # code of other sources


def test_the_key_is_of_the_kernels_of_the_package_and_of_the_environments() -> None:
    assert source_key("animarl_envs") == source_key("animarl_envs")
    assert animarl_algos.__path__
    assert source_key("animarl_algos") != source_key("animarl_envs")
    assert source_key("no_package_at_all") == source_key("animarl_envs")


def test_no_kernel_is_kept_elsewhere() -> None:
    for package in ("animarl_envs", "animarl_algos", "tools"):
        for path in (ROOT / package).rglob("*.py"):
            if path.name != "compiling.py":
                assert "cache=True" not in path.read_text(), path


@pytest.mark.parametrize("name", SPECIES)
def test_worlds_with_and_without_recordings_have_the_same_kernels(name: str) -> None:
    worlds = [make_world(make_scenario(name, **more)) for more in ({}, {"demos": None})]
    recorded, free = ((typeof(one._reference), typeof(one._demos)) for one in worlds)
    assert recorded == free


FIRST_STEP = """
import gymnasium, animarl_envs
from animarl_envs.compiling import KernelCache
from numba.core import event

KernelCache.takes_installed = False
with event.install_recorder("numba:compile") as compiled:
    env = gymnasium.make("AnimaRL/AgentTask-v0")
    env.reset(seed=0)
    env.step(0)
for _, one in compiled.buffer:
    function = one.data["dispatcher"].py_func
    if one.is_start and str(function.__module__).startswith("animarl"):  # None of what exec makes
        print(function.__name__)
"""


@pytest.mark.slow
def test_the_first_step_compiles_once_and_only_what_the_species_has(tmp_path: Path) -> None:
    folders = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    done = python(FIRST_STEP, env=os.environ | folders)
    compiled = done.stdout.split()
    assert {"_begin", "start", "advance", "judge", "look"} <= set(compiled)
    assert [compiled.count(name) for name in ("_begin", "start", "advance")] == [1, 1, 1]
    # Headings, crowds, free animals, and what the compact observation does not hold.
    absent = {"turned", "_in_each_copy", "look_around", "judge_free", "observe_own", "observe_wall"}
    assert not absent & set(compiled)
    assert "`animarl compile` does it beforehand" in done.stderr


def test_a_part_of_a_kernel_is_not_called_from_python() -> None:
    with pytest.raises(TypeError, match="averaged is a part of a kernel"):
        averaged(0.0, 1.0, 0.5, 1)
