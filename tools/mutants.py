"""Change one thing at a time in the code that all numbers hang on, and see whether a test notices.

    python tools/mutants.py                                  # every module below; hours
    python tools/mutants.py animarl_envs/locomotion.py --sample 60

Mutants are made by cosmic-ray's operators (comparison, sign, number, condition, loop) in a copy of
the project, one at a time, with numba off, so that kernels run as they are written. Each is tested
in a process forked from this one, where the libraries, which do not change, are imported already.
Printed are the share that tests noticed and each change that none did: either a test is missing, or
the change makes no difference.
"""

from __future__ import annotations

import argparse
import difflib
import gc
import importlib
import importlib.util
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
from pathlib import Path
from time import monotonic

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parents[1]
TIMES, GRACE = 8.0, 10.0  # a mutant that takes so many times as long, and so many seconds, hangs
LIBRARIES = (
    "numba", "torch", "torch._dynamo", "scipy.stats", "scipy.fft", "gymnasium", "pettingzoo",
    "hypothesis", "stable_baselines3", "sb3_contrib",
)  # fmt: skip

# What must notice a mutant: few and fast tests, or a run takes days.
TARGETS = {
    "animarl_envs/locomotion.py": ("test_locomotion.py",),
    "animarl_envs/kinematics.py": (
        "test_locomotion.py",
        "test_chase_headings.py",
        "test_chase_world.py",
    ),
    "animarl_envs/worlds/chase/kernels.py": ("test_chase_world.py",),
    "animarl_envs/dtw.py": ("test_dtw_rows.py",),
    "animarl_algos/losses/terms.py": ("test_losses.py",),
    "animarl_algos/losses/values.py": ("test_losses.py",),
    "animarl_algos/replay/sum_trees.py": ("test_sequence_buffer.py",),
    "animarl_algos/evaluation/statistics.py": ("test_statistics.py",),
}

_BINARY = ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul", "FloorDiv_Mul", "Mod_Mul")
_COMPARISON = (
    "Eq_NotEq", "NotEq_Eq", "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt",
    "GtE_Lt", "Is_IsNot", "IsNot_Is",
)  # fmt: skip
OPERATORS = (
    *(f"core/ReplaceBinaryOperator_{name}" for name in _BINARY),
    *(f"core/ReplaceComparisonOperator_{name}" for name in _COMPARISON),
    "core/ReplaceUnaryOperator_Delete_USub", "core/ReplaceUnaryOperator_Delete_Not",
    "core/ReplaceAndWithOr", "core/ReplaceOrWithAnd", "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue", "core/ReplaceBreakWithContinue", "core/ReplaceContinueWithBreak",
    "core/NumberReplacer", "core/AddNot", "core/ZeroIterationForLoop",
)  # fmt: skip


def mutants(text: str, most: int | None, seed: int) -> list[str]:
    """The source with one thing changed, for every operator and every place it applies to.

    Or as many of them as ``most``, drawn at random.
    """
    nodes = list(ast_nodes(get_ast(text)))
    operators = [get_operator(name)() for name in OPERATORS]
    places = [
        (operator, occurrence)
        for operator in operators
        for occurrence in range(sum(len(list(operator.mutation_positions(n))) for n in nodes))
    ]
    if most is not None:
        random.Random(seed).shuffle(places)
    made: dict[str, None] = {}  # a set that keeps the order
    for operator, occurrence in places:
        if len(made) == most:
            break
        changed = mutate_code(text, operator, occurrence)
        if changed is not None and changed != text:
            made[changed] = None
    return list(made)


def noticed(copy: Path, tests: tuple[str, ...], seconds: float | None) -> bool:
    """Whether a test fails, or hangs, in the copy of the project as it now stands."""
    process = multiprocessing.get_context("fork").Process(target=_run_tests, args=(copy, tests))
    process.start()
    process.join(seconds)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode != 0


def _run_tests(copy: Path, tests: tuple[str, ...]) -> None:
    """In a process of its own: run the copy's tests and leave with pytest's exit code."""
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(silence, stream.fileno())
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    code = pytest.main(
        ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not realdata"]
        + [str(path) for name in tests for path in Path("tests").rglob(name)]
    )
    os._exit(int(code))


def write(path: Path, text: str) -> None:
    """Put a mutant in its place, without the bytecode of the one before, which may look as new."""
    path.write_text(text)
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def examine(module: str, sample: int | None, seed: int, copy: Path) -> tuple[int, int]:
    """Print the mutants of a module that survive; returns how many were noticed, of how many."""
    path, tests = copy / module, TARGETS[module]
    text = path.read_text()
    start = monotonic()
    if noticed(copy, tests, None):
        raise SystemExit(f"{module}: {', '.join(tests)} fail without any change: mend them first")
    seconds = GRACE + TIMES * (monotonic() - start)
    made = mutants(text, sample, seed)
    killed = 0
    for changed in made:
        write(path, changed)
        if noticed(copy, tests, seconds):
            killed += 1
            continue
        lines = difflib.unified_diff(text.splitlines(), changed.splitlines(), lineterm="", n=0)
        print(f"{module} survives:", *list(lines)[2:], sep="\n  ", flush=True)
    write(path, text)
    return killed, len(made)


def main() -> None:
    """Examine the modules named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("modules", nargs="*", choices=[*TARGETS, []], help="default: all")
    parser.add_argument("--sample", type=int, help="as many mutants of each, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the drawing")
    asked = parser.parse_args()
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # before numba is imported, which is when it is read
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # they take longer than the tests
    for library in LIBRARIES:
        importlib.import_module(library)
    gc.freeze()  # or every fork copies what the collector touches
    counts = {}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "out", "build", "*.egg-info")
        shutil.copytree(ROOT, copy, ignore=ignored)
        for module in asked.modules or TARGETS:
            counts[module] = examine(module, asked.sample, asked.seed, copy)
            print(f"{module}: {_share(*counts[module])}", flush=True)
    print("\n| module | mutants | noticed |\n|---|---|---|")
    counts["all"] = (sum(k for k, _ in counts.values()), sum(n for _, n in counts.values()))
    for module, (killed, made) in counts.items():
        print(f"| {module} | {made} | {_share(killed, made)} |")


def _share(killed: int, made: int) -> str:
    return f"{killed} ({100 * killed / max(made, 1):.1f} %)"


if __name__ == "__main__":
    main()
