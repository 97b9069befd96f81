"""Change one thing at a time in the code that all numbers hang on, and see whether a test notices.

    python tools/mutants.py                                  # every module below; hours
    python tools/mutants.py animarl_envs/locomotion.py --sample 60

Mutants are made by cosmic-ray's operators (comparison, sign, number, condition, loop) in a copy of
the project, one at a time; where tests can do without numba it is off, so that kernels run as they
are written. Printed are the share that tests noticed and each change that none did: either a test
is missing, or the change makes no difference.
"""

from __future__ import annotations

import argparse
import difflib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parents[1]
TIMES = 8.0  # a mutant that takes so many times as long as the original hangs: noticed


class Target(NamedTuple):
    """What must notice a mutant: few and fast test files, or a run takes days."""

    tests: tuple[str, ...]
    compiled: bool = False  # tests that step a world need its kernels compiled, which is slow


TARGETS = {
    "animarl_envs/locomotion.py": Target(("test_locomotion.py",)),
    "animarl_envs/worlds/rules.py": Target(("test_chase_world.py",), compiled=True),
    "animarl_envs/dtw.py": Target(("test_dtw.py",), compiled=True),
    "animarl_algos/losses/losses.py": Target(("test_losses.py",)),
    "animarl_algos/losses/terms.py": Target(("test_losses.py", "test_recipes_by_hand.py")),
    "animarl_algos/losses/values.py": Target(("test_losses.py",)),
    "animarl_algos/replay/sum_tree.py": Target(("test_prioritised_replay.py",)),
    "animarl_algos/evaluation/statistics.py": Target(("test_statistics.py",)),
    "animarl_algos/evaluation/distances.py": Target(("test_statistics.py",)),
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


def mutants(text: str) -> Iterator[str]:
    """The source with one thing changed, for every operator and every place it applies to."""
    places = list(ast_nodes(get_ast(text)))
    for name in OPERATORS:
        operator = get_operator(name)()
        count = sum(len(list(operator.mutation_positions(node))) for node in places)
        for occurrence in range(count):
            changed = mutate_code(text, operator, occurrence)
            if changed is not None and changed != text:
                yield changed


def noticed(copy: Path, target: Target, seconds: float | None) -> bool:
    """Whether a test fails, or hangs, in the copy of the project as it now stands."""
    command = [
        sys.executable, "-B", "-m", "pytest", "-x", "-q", "-p", "no:xdist",
        "-p", "no:cacheprovider",
        "-m", "not slow and not realdata", *(f"tests/{name}" for name in target.tests),
    ]  # fmt: skip
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": str(int(not target.compiled)),
        "PYTHONPATH": str(copy),
    }
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def examine(module: str, sample: int | None, seed: int, copy: Path) -> tuple[int, int]:
    """Print the mutants of a module that survive; returns how many were noticed, of how many."""
    path, target = copy / module, TARGETS[module]
    text = path.read_text()
    start = monotonic()
    if noticed(copy, target, None):
        raise SystemExit(
            f"{module}: {', '.join(target.tests)} fail without any change: mend them first"
        )
    seconds = TIMES * (monotonic() - start)
    made = list(dict.fromkeys(mutants(text)))
    if sample is not None and sample < len(made):
        made = random.Random(seed).sample(made, sample)
    killed = 0
    for changed in made:
        path.write_text(changed)
        if noticed(copy, target, seconds):
            killed += 1
            continue
        lines = difflib.unified_diff(text.splitlines(), changed.splitlines(), lineterm="", n=0)
        print(f"{module} survives:", *list(lines)[2:], sep="\n  ", flush=True)
    path.write_text(text)
    share = killed / max(len(made), 1)
    print(f"{module}: {killed} of {len(made)} noticed ({100 * share:.1f} %)", flush=True)
    return killed, len(made)


def main() -> None:
    """Examine the modules named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("modules", nargs="*", choices=[*TARGETS, []], help="default: all")
    parser.add_argument("--sample", type=int, help="as many mutants of each, drawn at random")
    parser.add_argument("--seed", type=int, default=0, help="of the drawing")
    asked = parser.parse_args()
    totals = [0, 0]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "out", "build", "*.egg-info")
        shutil.copytree(ROOT, copy, ignore=ignored)
        for module in asked.modules or TARGETS:
            for i, number in enumerate(examine(module, asked.sample, asked.seed, copy)):
                totals[i] += number
    print(f"all: {totals[0]} of {totals[1]} noticed ({100 * totals[0] / max(totals[1], 1):.1f} %)")


if __name__ == "__main__":
    main()
