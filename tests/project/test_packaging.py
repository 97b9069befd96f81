"""What is asked of an installation, and that a built wheel holds all that the project needs."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
from configparser import ConfigParser
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml
from pages import python

from animarl_envs.errors import EXTRA_MODULES

ROOT = Path(__file__).resolve().parents[2]
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUP = ConfigParser()
SETUP.read_string((ROOT / "setup.cfg").read_text())


def entries(section: str, key: str) -> list[str]:
    """Return the lines of a list in ``setup.cfg``."""
    return SETUP[section][key].split("\n")[1:]


CORE = entries("options", "install_requires")
EXTRAS = {name: entries("options.extras_require", name) for name in SETUP["options.extras_require"]}


def pins() -> dict[str, str]:
    """Version by name in ``constraints.txt``, names as pip compares them."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = (line.partition(" ; ")[0] for line in lines if line and not line.startswith("#"))
    return {canonical(name): version for name, version in (line.split("==") for line in pinned)}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def requirements() -> list[str]:
    """Return everything that the project asks for, extras and groups included."""
    lists = [CORE, *EXTRAS.values(), *CONFIG["dependency-groups"].values()]
    return [line for entry in lists for line in entry if not line.startswith("animarl[")]


def test_versions_are_fixed_in_the_constraints_alone() -> None:
    fixed = pins()
    for requirement in requirements():
        name = re.split(r"[<>=!~]", requirement)[0]
        assert "==" not in requirement, requirement
        assert canonical(name) in fixed, f"{name} is not in constraints.txt"
    assert "torch>=2.2" in requirements()
    # No version of torch stands anywhere else, so that nothing can ask for another build.
    assert "torch==" not in (ROOT / "Makefile").read_text()


BROUGHT = {"loguru": "movement"}


def test_modules_of_extras_are_of_their_packages() -> None:
    """Each is of a package in an extra, and none is of the core."""
    named = {canonical(re.split(r"[<>=]", line)[0]) for lines in EXTRAS.values() for line in lines}
    homes = packages_distributions()
    for module in EXTRA_MODULES & homes.keys():
        owners = {BROUGHT.get(module) or canonical(name) for name in homes[module]}
        assert owners & named, module
    imported: set[str] = set()
    for package in ("animarl_envs", "animarl_algos"):
        for file in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module:
                    imported.add(node.module.partition(".")[0])
    core = {canonical(re.split(r"[<>=]", line)[0]) for line in CORE}
    core |= {"animarl-envs", "animarl-algos", "pydantic-core", "typing-extensions"}
    foreign = {name for name in imported if canonical(name) not in core}
    assert foreign - set(sys.stdlib_module_names) <= EXTRA_MODULES


def test_everybody_uses_the_same_ruff() -> None:
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    (hooks,) = config["repos"]
    assert hooks["rev"] == f"v{pins()['ruff']}"
    assert [hook["id"] for hook in hooks["hooks"]] == ["ruff-check", "ruff-format"]


def test_hosted_tests_are_those_of_the_makefile() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())
    steps = {name: job["steps"] for name, job in workflow["jobs"].items()}
    for job, target in (("test", "test"), ("core", "test-core")):
        commands = [step["run"] for step in steps[job] if "run" in step]
        assert [command.split()[:2] for command in commands] == [["make", target]]
    actions = [step["uses"] for job in steps.values() for step in job if "uses" in step]
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", action) for action in actions)
    pythons = workflow["jobs"]["core"]["strategy"]["matrix"]["python-version"]
    classifiers = entries("metadata", "classifiers")
    named = [line.rpartition(" ")[2] for line in classifiers if "Python :: 3." in line]
    assert pythons == named and CONFIG["project"]["requires-python"] == f">={pythons[0]}"


def test_locks_hold_every_package_that_is_asked_for_by_hash_and_no_address() -> None:
    core, whole = ((ROOT / "locks" / f"{name}.txt").read_text() for name in ("core", "all"))
    asked = {canonical(re.split(r"[<>=!~]", line)[0]) for line in requirements()}
    for text, names in (
        (whole, asked),
        (core, {re.split(r"[<>=]", line)[0] for line in CORE} | {"pytest", "hypothesis"}),
    ):
        locked = set(re.findall(r"^([\w.-]+)==", text, re.MULTILINE))
        assert names <= locked
        assert "://" not in text
        assert text.count("--hash=sha256:") > len(locked)


def test_locks_hold_the_versions_that_are_tested() -> None:
    """Constraints are what Python 3.11 on Linux is tested with; more is for other systems."""
    tested = pins()
    for name in ("core", "all"):
        text = (ROOT / "locks" / f"{name}.txt").read_text()
        locked = re.findall(r"^([\w.-]+)==([^ ]+)(?: ; (.+))? \\$", text, re.MULTILINE)
        assert locked
        for package, version, where in locked:
            if where != "sys_platform == 'win32'" and (package in tested or not where):
                assert (package, version) == (package, tested.get(package))
        if name == "all":
            assert tested.keys() == tested.keys() & {package for package, _, _ in locked}


def test_the_page_of_a_registry_links_to_nothing_that_is_not_there() -> None:
    page = (ROOT / SETUP["metadata"]["long_description"].removeprefix("file: ")).read_text()
    links = re.findall(r"\]\(([^)]*)\)", page)
    assert links and all(link.startswith("https://") for link in links)
    for extra in EXTRAS:
        assert extra == "test" or f"| `{extra}` |" in page
    for name in re.findall(r"`(\w+\.(?:md|cff))`", page):
        assert (ROOT / name).exists() or (ROOT / "docs" / name).exists()


WATCHED = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
sys.argv = ["animarl", *sys.argv[1:]]
from animarl_algos.cli.main import main
main()
"""


@pytest.mark.parametrize(
    "more", [("AnimaRL/Agent-v0",), ("AnimaRL/Newt-v0", "--by", "script"), ("AnimaRL/Silkmoth-v0",)]
)
def test_animals_are_watched_without_what_learns(tmp_path: Path, more: tuple[str, ...]) -> None:
    """The packages that ``render`` and ``cli`` bring are enough."""
    enough = [*CORE, *EXTRAS["render"], *EXTRAS["cli"]]
    here = {re.split(r"[<>=]", line)[0] for line in enough}
    asked = {re.split(r"[<>=]", line)[0] for e in ("algos", "data") for line in EXTRAS[e]}
    modules = {"pyyaml": "yaml"}
    absent = {modules.get(name, name).replace("-", "_") for name in asked - here}
    assert {"torch", "stable_baselines3", "scipy", "pandas"} <= absent
    script = WATCHED.replace("{absent}", repr(absent))
    clip = tmp_path / "clip.gif"
    python(script, "watch", *more, "--steps", "3", "--out", clip, cwd=ROOT)
    assert clip.stat().st_size > 0


USED = """
import importlib, pkgutil, sys
from pathlib import Path
import gymnasium as gym
import animarl_algos, animarl_envs
from animarl_envs.demos.packaged import load_packaged

for package in (animarl_envs, animarl_algos):
    assert Path(package.__file__).is_relative_to(sys.prefix), package.__file__
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
for name in animarl_envs.SPECIES:
    load_packaged(name)
    env = gym.make(animarl_envs.environment_id(name))
    env.reset(seed=0)
    env.step(0)
from animarl_algos import DQN, SlotVecEnv
from animarl_algos.learner.presets import learner_preset
DQN("GruPolicy", SlotVecEnv("agent", 2), seed=0).learn(20)
"""


@pytest.mark.slow
def test_a_wheel_is_built_and_used_in_an_empty_environment(tmp_path: Path) -> None:
    """Its own packages come from the wheel, those of others from where the tests run."""
    source = tmp_path / "source"
    ignored = shutil.ignore_patterns(".*", "__pycache__", "out", "build", "dist", "*.egg-info")
    shutil.copytree(ROOT, source, ignore=ignored)
    files = {str(path.relative_to(source)) for path in source.rglob("*") if path.is_file()}
    dist = tmp_path / "dist"
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(dist), cwd=source)
    made = sorted(dist.iterdir())
    assert [path.suffix for path in made] == [".whl", ".gz"]
    checked = run(sys.executable, "-m", "twine", "check", "--strict", *map(str, made), cwd=tmp_path)
    assert checked.count("PASSED") == 2
    with tarfile.open(made[1]) as archive:  # whole, so that its tests run as they do here
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert files <= held, sorted(files - held)

    empty = tmp_path / "empty"
    venv.create(empty, with_pip=True)
    python = empty / "bin" / "python"
    install = ("-m", "pip", "install", "--no-deps", "--no-index", "--quiet", str(made[0]))
    run(str(python), *install, cwd=tmp_path)
    (site,) = (empty / "lib").glob("python*/site-packages")
    others = [path for path in sys.path if path.endswith("site-packages")]
    # Folders named in a .pth file are looked in, but their own .pth files are not followed: the
    # project as it stands here, if it is installed from its source, is not found through them.
    (site / "others.pth").write_text("\n".join(others))
    run(str(python), "-c", USED, cwd=tmp_path)
    assert "train" in run(str(empty / "bin" / "animarl"), "--help", cwd=tmp_path)


def run(*command: str, cwd: Path) -> str:
    """What a command prints; if it fails, that is shown."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
