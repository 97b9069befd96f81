"""Processes that read damaged files, and what became of each file.

Readers run foreign code in processes of their own (:mod:`animarl_envs.wall`), so that a crash, an
endless loop or a demand for memory ends as a sentence here; those sentences are counted apart.
"""

from __future__ import annotations

import multiprocessing
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from tools.fuzz.mutations import Damage
from tools.fuzz.targets import MARKER, TARGETS

OUTCOMES = ("refused", "equal", "different", "unexplained", "traceback")
CONTAINED = {
    "crash": "a library crashes over it", "hang": "s of processor time", "memory": "more memory",
}  # fmt: skip
"""What a process of its own kept from the caller, by the sentence that tells it."""


@dataclass
class Result:
    """Counts by outcome, and a line for each file that should not be."""

    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys((*OUTCOMES, *CONTAINED, "ran"), 0)
    )
    findings: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """Every file ends in one of the outcomes; what was contained or ran is counted as well."""
        return sum(self.counts[name] for name in OUTCOMES)

    def note(self, outcome: str, label: str = "", said: str = "") -> None:
        self.counts[outcome] += 1
        if label:
            self.findings.append(f"{outcome}: {label}: {said!r:.200}")


def damage_number(number: int, seed: int, raw: bytes, name: str) -> Damage:
    """Return the damage that a seed and a number stand for."""
    return TARGETS[name].make(raw, np.random.default_rng([seed, number]))


def fuzz(count: int, workers: int, seed: int, names: Sequence[str]) -> Result:
    """Read ``count`` damaged files, those of each name in turn."""
    if workers == 1:
        return _work(range(count), seed, names)
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        shares = [range(which, count, workers) for which in range(workers)]
        found = [pool.submit(_work, share, seed, names) for share in shares]
        result = Result()
        for one in found:
            part = one.result()
            result.findings += part.findings
            for name, number in part.counts.items():
                result.counts[name] += number
        return result


def _work(numbers: range, seed: int, names: Sequence[str]) -> Result:
    place = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
    result, files = Result(), {}
    with tempfile.TemporaryDirectory(dir=place) as folder:
        for name in names:
            target, own = TARGETS[name], Path(folder) / name
            own.mkdir(parents=True)
            path = target.write(own)
            whole = {p: p.read_bytes() for p in (path, *(path.with_name(b) for b in target.beside))}
            try:
                clean = target.read(path)
            except InputError:  # what is planted is refused from the start
                clean = {}
            files[name] = path, whole, clean
        for number in numbers:
            name = names[number % len(names)]
            path, whole, clean = files[name]
            paths = list(whole)
            aim = paths[(number // len(names)) % len(paths)] if number % 4 == 3 else path
            damage = damage_number(number, seed, whole[aim], name)
            aim.write_bytes(damage.data)
            label = f"{name} number {number}"
            outcome, said = _outcome(name, path, aim, clean, damage)
            result.note(outcome, label if outcome in ("unexplained", "traceback") else "", said)
            for kind, words in CONTAINED.items():
                if outcome == "refused" and words in said:
                    result.note(kind, label if kind != "memory" else "", said)
            if (path.parent / MARKER).exists():
                result.note("ran", label)
                (path.parent / MARKER).unlink()
            aim.write_bytes(whole[aim])
    return result


def _outcome(name: str, path: Path, aim: Path, clean: Any, damage: Damage) -> tuple[str, str]:
    target = TARGETS[name]
    try:
        found = target.read(path)
    except InputError as error:
        sentences = getattr(error, "sentences", [str(error)])
        one_line = all(one and "\n" not in one for one in sentences)
        return ("refused", str(error)) if one_line else ("traceback", "not a sentence")
    except Exception as error:  # the very thing that is looked for
        return "traceback", f"{type(error).__name__}: {error}"
    if aim != path:
        return "different", ""  # a scale or a name beside the tracks
    try:
        target.judge(path, found, clean, damage)
    except AssertionError as error:
        return "unexplained", str(error).splitlines()[0]
    except Exception as error:
        return "unexplained", f"{type(error).__name__}: {error}"
    return ("equal" if _same(found, clean) else "different"), ""


def _same(found: Any, clean: Any) -> bool:
    if not isinstance(found, dict) or not isinstance(clean, dict):
        return repr(found) == repr(clean)
    return found.keys() == clean.keys() and all(
        np.array_equal(found[key], clean[key], equal_nan=True)
        if isinstance(found[key], np.ndarray)
        else repr(found[key]) == repr(clean[key])
        for key in found
    )
