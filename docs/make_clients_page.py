"""Write ``docs/clients.md``: run every example and note against which versions it ran.

    python docs/make_clients_page.py

The examples run one after the other in processes of their own, a few thousand steps each; the
command stops at the first that fails. Clients whose libraries ask for other versions than this
project's tests get an environment of their own, made here. ``tests/public/test_clients.py`` runs
the same examples, those in their own environments among the slow tests.
"""

from __future__ import annotations

import argparse
import ast
import platform
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from animarl_envs.files import write_then_rename

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "clients.md"


@dataclass(frozen=True)
class Client:
    """An example and the libraries it shows."""

    example: str
    libraries: tuple[str, ...]
    view: str  # of the environment
    own: tuple[str, ...] = ()
    """What is installed beside this project in an environment of its own, if it needs one."""
    argument: str = ""
    """Which of the functions of ``more_libraries.py``."""
    alone: tuple[str, ...] = ()
    """What is installed after ``own`` without what it asks for, which is older than ours."""
    checkout: str = ""
    """The variable that names a folder of its sources, of what is no package."""

    @property
    def name(self) -> str:
        return self.argument or self.example

    @property
    def path(self) -> Path:
        return ROOT / "examples" / f"{self.example}.py"

    @property
    def summary(self) -> str:
        """First line of the docstring of the example, or of its function."""
        tree: ast.Module | ast.FunctionDef = ast.parse(self.path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name == self.argument:
                tree = node
        text = ast.get_docstring(tree)
        assert text is not None, self.path
        return text.splitlines()[0]


def more(name: str, libraries: tuple[str, ...], view: str, *own: str, **given: Any) -> Client:
    """A library of ``more_libraries.py``; all but SuperSuit in an environment of their own."""
    return Client("more_libraries", libraries, view, own, argument=name, **given)


PARALLEL = "`newt_v0.parallel_env`"
CLIENTS = (
    Client("sb3_dqn", ("stable-baselines3",), "`gym.make`"),
    Client("sb3_ppo", ("stable-baselines3",), "`make_vec_env`"),
    Client("sb3_contrib_qrdqn", ("sb3-contrib",), "`gym.make`"),
    Client("sb3_contrib_recurrent_ppo", ("sb3-contrib",), "`make_vec_env`"),
    Client("cleanrl_style_dqn", ("gymnasium", "torch"), "`gym.make_vec`"),
    Client(
        "pettingzoo_supersuit_sb3", ("pettingzoo", "supersuit", "stable-baselines3"),
        "`parallel_env`",
    ),
    Client("torchrl_env", ("torchrl",), "`GymEnv`"),
    Client("tianshou_env", ("tianshou",), "`gym.make` in `DummyVectorEnv`"),
    Client(
        "minari_collector", ("minari", "jax"), "`gym.make`",
        ("minari[hdf5,create]>=0.5", "pillow"),  # Minari 0.5.4 imports Pillow unasked
    ),
    Client(
        "rllib_ppo", ("ray", "gymnasium", "pettingzoo"), "`parallel_env`",
        ("ray[rllib]>=2.40", "torch"),  # which RLlib asks for, but does not bring
    ),
    more("torchrl", ("torchrl",), PARALLEL, "torchrl>=0.14"),
    more("benchmarl", ("benchmarl", "torchrl"), PARALLEL, "benchmarl>=1.5"),
    more("skrl", ("skrl",), PARALLEL, "skrl[torch]>=2"),
    more("tianshou", ("tianshou",), "`newt_v0.env`", "tianshou>=2"),
    more("epymarl", ("gymnasium", "pettingzoo"), PARALLEL, "torch", checkout="EPYMARL"),
    more(
        "d3rlpy", ("d3rlpy", "minari"), "`gym.make`",
        *("d3rlpy>=2.8", "minari[hdf5,create]", "pillow"),
    ),
    more(
        "cleanrl", ("gymnasium", "torch"), "`gym.make`", *("torch", "tyro", "tensorboard"),
        checkout="CLEANRL",
    ),
    more(
        "pufferlib", ("pufferlib-core",), f"`gym.make`, {PARALLEL}", *("torch", "psutil"),
        alone=("pufferlib-core>=3",),  # PufferLib itself downloads sources while it is built
    ),
    more(
        "sample_factory", ("sample-factory",), "`gym.make`",
        *("numpy<2.3", "torch", "tensorboard", "tensorboardx", "psutil", "threadpoolctl"),
        *("colorlog", "filelock", "opencv-python-headless", "wandb", "huggingface-hub"),
        alone=("sample-factory>=2.1", "faster-fifo", "signal-slot-mp"),
    ),
    more("supersuit", ("supersuit",), PARALLEL),
)  # fmt: skip

HEAD = """# AnimaRL in other libraries

<!-- Written by `python docs/make_clients_page.py`; do not edit. -->

Use the environments from stable-baselines3, CleanRL, SuperSuit, TorchRL, BenchMARL, skrl, Tianshou,
EPyMARL, d3rlpy, PufferLib, Sample Factory, Minari or RLlib. Each example below is one file in
[`examples/`](../examples) with the options `--steps` and `--seed`, or one function of
`more_libraries.py`, and tests run it.

`import animarl_envs` registers the environments with Gymnasium. Libraries that start worker
processes, such as stable-baselines3's `SubprocVecEnv`, take `"animarl_envs:AnimaRL/Agent-v0"`
instead.

The last column is what each example printed with `--steps {steps}` on Python {python}. This shows
that the libraries work together. It is no benchmark: nothing is learned in so few steps.

| example | what it does | view | versions | last line printed |
|---|---|---|---|---|
"""

FOOT = """
What to know:

- A time limit *truncates* an episode and never terminates it, so learners bootstrap there.
  Gymnasium's views return it as the fourth value of `step`. The parallel view also says it in
  `info["TimeLimit.truncated"]`, which SuperSuit's stable-baselines3 wrapper reads.
- `gym.make(...).spec.max_episode_steps` is the time limit in force, as Gymnasium's
  `TimeAwareObservation` expects. `make_vec(..., max_episode_steps=7)` and PettingZoo's
  `make("parallel", "AnimaRL/Agent-v0", max_cycles=7)` shorten it.
- `gym.make_vec` returns the native vector environment. It resets a copy in the step after its end
  (`AutoresetMode.NEXT_STEP`), or at once with `autoreset_mode="SameStep"`.
- All individuals of a chase have the same observation and action spaces and end together. You need
  neither padding nor `black_death`.
- `make` compiles the kernels of a checkout as it installs it, and a wheel of a platform brings
  them. From a source archive the first step on a machine compiles for about a minute and says so;
  `animarl compile` does it beforehand ([the first step](scale.md#the-first-step)).
- Tasks, such as `AnimaRL/AgentTask-v0`, have compact observations, 10 to 20 numbers for a chase.
  Animals' worlds show all that this package's own models see; `observation="compact"` shortens it.
- `infos` of the parallel view have the same flat numbers at reset and at every step.
  `env.state()`, in `state_space`, is the positions and velocities of all. `env.scenario_data`
  describes the world.
- `from animarl_envs import newt_v0` gives a module as PettingZoo has them:
  `newt_v0.parallel_env()`, `newt_v0.env()`.
- CleanRL and EPyMARL are no packages. Their tests run where `$CLEANRL` and `$EPYMARL` name the
  folder of a checkout: `ppo.py` and the wrappers are used unchanged. The rows above are of CleanRL
  `b5fb801` and of EPyMARL's `gymma.py` of `692b1f1`, without its other simulators.
- PufferLib 3.0.0 downloads sources while it is built (`urlopen error: Name or service not known`
  where that is not possible). `pufferlib-core`, in which others package its core, has the
  emulation that is tested. Sample Factory 2.1.1 asks for `gymnasium<1.0` and `numpy<2`; it runs
  with Gymnasium 1.4 and NumPy 2.2 if it is installed with `--no-deps`.
- TorchRL 0.14.1 reads every Minari set as zeros, not ours alone: its loader ends with
  `memmap_like`, which copies shapes and no values. Until that is mended,
  `TensorDict.memmap_like = lambda self, prefix=None, **kept: self.memmap(prefix)` before
  `MinariExperienceReplay(..., load_from_local_minari=True)` gives the recorded values.
- SuperSuit's SB3 wrapper has no `seed()`. Give SB3 no `seed=`; seed as the example does.
"""


def interpreter(client: Client, folder: Path) -> Path:
    """The Python that runs a client: this one, or that of an environment made in ``folder``.

    An environment that is there already is used again. Torch is of the build that stands in
    ``constraints.txt``; all else is what the client asks for.
    """
    if not client.own:
        return Path(sys.executable)
    home = folder / client.name
    python = home / "bin" / "python"
    ready = home / ".installed"
    if not ready.exists():
        venv.create(home, with_pip=True, clear=True)
        limits = home / "limits.txt"
        lines = (ROOT / "constraints.txt").read_text().splitlines()
        limits.write_text("".join(f"{line}\n" for line in lines if line.startswith("torch==")))
        install = [str(python), "-m", "pip", "install", "-q", "-c", str(limits)]
        subprocess.run([*install, str(ROOT), *client.own], check=True)
        if client.alone:
            subprocess.run([*install, "--no-deps", *client.alone], check=True)
        ready.touch()
    return python


def run(client: Client, python: Path, steps: int) -> str:
    """Run one example; its last line of output."""
    which = [client.argument] if client.argument else []
    command = [str(python), "-W", "ignore", str(client.path), *which, "--steps", str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode != 0:
        raise SystemExit(f"{client.path} failed:\n{done.stderr[-2000:]}")
    return done.stdout.strip().splitlines()[-1]


def versions(client: Client, python: Path) -> str:
    """The versions of a client's libraries where it ran."""
    ask = "import sys; from importlib.metadata import version; print(*map(version, sys.argv[1:]))"
    command = [str(python), "-c", ask, *client.libraries]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    pairs = zip(client.libraries, found, strict=True)
    return ", ".join(f"{name} {version}" for name, version in pairs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument(
        "--environments", type=Path, default=ROOT / "out" / "clients",
        help="folder of the environments of clients that need one of their own",
    )  # fmt: skip
    given = parser.parse_args()
    rows = []
    for client in CLIENTS:
        python = interpreter(client, given.environments)
        said, ran = run(client, python, given.steps), versions(client, python)
        ran += " (own environment)" if client.own else ""
        which = f"{client.example}.py {client.argument}".rstrip()
        link = f"[`{which}`](../examples/{client.example}.py)"
        rows.append(f"| {link} | {client.summary} | {client.view} | {ran} | {said} |")
        print(client.name, "-", said, flush=True)
    head = HEAD.format(steps=given.steps, python=platform.python_version())
    with write_then_rename(PAGE) as part:
        part.write_text(head + "\n".join(rows) + "\n" + FOOT)
    print(f"Wrote {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
