"""What importing the environments brings along, and what is said where an extra is missing."""

import copy
import json
import pickle
from pathlib import Path

import pytest
from pages import python

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError, MissingExtraError, UnknownOptionError

HEAVY = (
    "numba", "torch", "matplotlib", "pandas", "scipy", "stable_baselines3", "animarl_algos",
    "pydantic", "pygame", "imageio", "yaml", "h5py", "minari", "sleap_io", "movement",
)  # fmt: skip
# numba looks for yaml and scipy's BLAS by itself, where they are installed; not ours to change.
NUMBA = "import numba; numba.njit(lambda x: x + 1)(1)"

USE_ALL = """
import gymnasium as gym
import animarl_envs
for name in animarl_envs.SPECIES:
    env = gym.make(animarl_envs.environment_id(name))
    env.reset(seed=0)
    env.step(0)
    vector = gym.make_vec(animarl_envs.environment_id(name), num_envs=2)
    vector.reset(seed=0)
    vector.step(vector.action_space.sample())
    everyone = animarl_envs.parallel_env(name)
    everyone.reset(seed=0)
    everyone.step(dict.fromkeys(everyone.agents, 0))
"""
CUSTOM = """
import sys
import gymnasium as gym
import animarl_envs
gym.make("AnimaRL/Custom-v0", demos=sys.argv[1]).reset(seed=0)
"""


def loaded_after(program: str, *arguments: str) -> set[str]:
    """Modules of heavy packages that a fresh interpreter has loaded after a program."""
    report = "\nimport json, sys; print(json.dumps(list(sys.modules)))"
    loaded = json.loads(python(program + report, *arguments).stdout)
    return {m for m in loaded if m.partition(".")[0] in HEAVY}


def but_numba(modules: set[str]) -> set[str]:
    return {m for m in modules if m.partition(".")[0] != "numba"}


@pytest.fixture(scope="module")
def numbas_own() -> set[str]:
    return loaded_after(NUMBA)


def test_importing_the_environments_imports_nothing_heavy() -> None:
    assert loaded_after("import animarl_envs") == set()


def test_using_the_environments_needs_nothing_heavy_but_numba(numbas_own: set[str]) -> None:
    assert but_numba(loaded_after(USE_ALL) - numbas_own) == set()
    assert numbas_own.isdisjoint({"torch", "matplotlib", "pandas"})


def test_the_custom_species_needs_no_heavy_package(tmp_path: Path, numbas_own: set[str]) -> None:
    demos = load_packaged("agent").select(split="train", condition=0)
    loaded = loaded_after(CUSTOM, str(demos.save(tmp_path / "demos.npz")))
    assert but_numba(loaded - numbas_own) == set()


WITHOUT = """
import pathlib, sys, tempfile
folder = tempfile.TemporaryDirectory()  # also seen by processes that this one starts
for name in ("pygame", "imageio", "pandas", "scipy", "yaml", "h5py", "typer"):
    said = f"raise ModuleNotFoundError('No module named {name!r}', name={name!r})"
    (pathlib.Path(folder.name) / f"{name}.py").write_text(said.replace(repr(name), name, 1))
sys.path.insert(0, folder.name)
import gymnasium as gym, animarl_envs
from animarl_envs.errors import MissingExtraError
"""
NEEDS = {
    "render": "e = gym.make('AnimaRL/Agent-v0', render_mode='rgb_array'); e.reset(); e.render()",
    "data": "from animarl_envs.importing.readers import read; read(sys.argv[1], source='sleap')",
    "data ": "from animarl_envs.importing.readers import read; read(sys.argv[1])",
    " data": "from animarl_envs.species.traits import fit_traits; fit_traits(*[None] * 5)",
}


@pytest.mark.parametrize("need", NEEDS)
def test_a_missing_extra_is_named_in_a_sentence(need: str, tmp_path: Path) -> None:
    if need == "data":
        pytest.importorskip("sleap_io")  # or its extra would be named
    (tmp_path / "tracks.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    program = f"{WITHOUT}\ntry:\n    {NEEDS[need]}\nexcept MissingExtraError as e:\n    print(e)"
    said = python(program, tmp_path / "tracks.h5").stdout
    assert said.count("\n") == 1 and f"pip install 'animarl[{need.strip()}]'" in said


def test_the_command_line_without_its_extra_says_so() -> None:
    done = python(f"{WITHOUT}\nfrom animarl_algos.cli.main import main; main()", check=False)
    assert done.returncode == 2
    assert done.stderr == (
        "animarl: the command line needs the extra 'cli': pip install 'animarl[cli]'\n"
    )


BROKEN = """
import sys
from animarl_envs.errors import require_extra
kind, name = sys.argv[1:]
with require_extra("reading", "data"):
    raise getattr(__import__("builtins"), kind)("libcudart.so is missing", name=name)
"""


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        ("ModuleNotFoundError", "scipy.signal", "MissingExtraError: reading needs the extra"),
        ("ModuleNotFoundError", "markupsafe", "ModuleNotFoundError: libcudart.so is missing"),
        ("ImportError", "torch", "ImportError: libcudart.so is missing"),
    ],
)
def test_a_broken_installation_is_not_taken_for_a_missing_extra(
    kind: str, name: str, said: str
) -> None:
    assert said in python(BROKEN, kind, name, check=False).stderr.splitlines()[-1]


def test_a_missing_extra_can_be_raised_anew() -> None:
    """Gymnasium's process vectors and pickle make an error again from its text."""
    error = MissingExtraError("rendering", "render")
    sentence = "rendering needs the extra 'render': pip install 'animarl[render]'"
    assert str(error) == sentence
    for twin in (type(error)(str(error)), pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert isinstance(twin, MissingExtraError)
        assert str(twin) == sentence
    # Gymnasium raises a constructor's TypeError anew with all keyword arguments appended.
    sentence = "start has shape (2, 2): give x and y of 3 individuals"
    raised = f"{sentence} was raised from the environment creator for X with kwargs ([[0\n0]])"
    for kind in (InputError, UnknownOptionError):
        again = kind(raised)
        assert str(again) == sentence
        assert str(pickle.loads(pickle.dumps(again))) == sentence
