"""How often a verdict errs, and how often it finds a known fault.

    python benchmarks/verdict_power.py
    python benchmarks/verdict_power.py --quick

Perfect simulators and simulators with one known fault (:mod:`benchmarks.known_worlds`) are judged
as any other. The first table counts how often something *differs* although the simulator is
perfect, and how many questions are *alike*; the second how often something *differs* where there is
a fault, and how often the page is green all the same. Classifiers take most of the time. They judge
the first ``--judged`` perfect simulators of each row, and faults that measures find too rarely.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from tqdm.auto import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos.evaluation.classifier import classify_all
from animarl_algos.evaluation.verdict import compare
from animarl_algos.evaluation.verdict_rows import ALIKE, DIFFERS, LITTLE, UNKNOWN, classifier_row
from animarl_algos.learner.progress import progress_display
from benchmarks.known_worlds import FAULTS, SETTINGS, WORLDS

EACH = 5  # rollouts from every start
PERFECT = "perfect"
FEW = 2  # runs of many starts
FAULT_STARTS = 50  # of simulators with a fault
SEEN = 0.8  # of runs, in which a fault should be found


def judgements(
    world: str, simulator: str, starts: int, run: int, bar: tqdm, *, classifiers: bool
) -> list[str]:
    """Return the words of all questions of one simulated experiment.

    With ``classifiers`` those of classifiers come last, unless a measure differs already. The
    ``bar`` counts starts.
    """
    bar.update(starts)
    names = [PERFECT, *FAULTS, *SETTINGS]
    rng = np.random.default_rng([run, starts, names.index(simulator), [*WORLDS].index(world)])
    known = WORLDS[world]
    recorded = known.recordings(starts, rng)
    if simulator == PERFECT:
        rollouts = known.rollouts(recorded, EACH, rng)
    else:
        rollouts = known.faulty_rollouts(recorded, EACH, simulator, rng)
    compared, streams = compare(recorded, rollouts, run)
    words = [row.judgement for row in compared.rows()]
    if classifiers and DIFFERS not in words:
        prepared, counted = compared.prepared, compared.counted
        answers = classify_all(prepared, counted, {}, None, compared.unit, streams[:3], alone=True)
        words += [classifier_row(*answer).judgement for answer in answers]
    return words


def perfect_rows(
    worlds: Sequence[str],
    starts: Sequence[int],
    many: Sequence[int],
    runs: int,
    judged: int,
    bar: tqdm,
) -> Iterator[str]:
    """Yield the table of perfect simulators."""
    yield "| world | recordings | runs | something differs | page green | alike | not known |"
    yield "|---|---|---|---|---|---|---|"
    for world in worlds:
        for number in [*starts, *many]:
            times = FEW if number in many else runs
            last = 0 if number in many else judged
            words = [
                judgements(world, PERFECT, number, run, bar, classifiers=run < last)
                for run in range(times)
            ]
            counted = [
                (DIFFERS in w, is_green(w), w.count(ALIKE) / len(w), w.count(UNKNOWN) / len(w))
                for w in words
            ]
            shares = " | ".join(f"{100 * s:.0f} %" for s in np.mean(counted, axis=0))
            yield f"| {world} | {number} | {times} | {shares} |"


def fault_rows(
    worlds: Sequence[str], faults: Sequence[str], runs: int, bar: tqdm, *, classifiers: bool
) -> Iterator[str]:
    """Yield the table of faults."""
    yield f"| fault | {' | '.join(worlds)} |"
    yield "|---|" + "---|" * len(worlds)
    for fault in faults:
        cells = []
        for world in worlds:
            if fault not in WORLDS[world].faults:
                cells.append("–")
                continue
            words = [
                judgements(world, fault, FAULT_STARTS, r, bar, classifiers=False)
                for r in range(runs)
            ]
            if classifiers and np.mean([DIFFERS in each for each in words]) < SEEN:
                for run, each in enumerate(words):
                    if DIFFERS not in each:
                        bar.total += FAULT_STARTS
                        words[run] = judgements(
                            world, fault, FAULT_STARTS, run, bar, classifiers=True
                        )
            found = np.mean([DIFFERS in each for each in words])
            green = np.mean([is_green(each) for each in words])
            cells.append(f"{100 * found:.0f} %, {100 * green:.0f} %")
        yield f"| {fault} | {' | '.join(cells)} |"


def is_green(words: Sequence[str]) -> bool:
    """Whether everything is alike, or differs a little."""
    return set(words) <= {ALIKE, LITTLE}


def main() -> None:
    faults = [*FAULTS, *SETTINGS]
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=60, help="of perfect simulators")
    parser.add_argument("--judged", type=int, default=10, help="of these with classifiers")
    parser.add_argument("--fault-runs", type=int, default=10)
    parser.add_argument("--starts", type=int, nargs="*", default=[10, 20, 50])
    parser.add_argument(
        "--many",
        type=int,
        nargs="*",
        default=[200, 1000],
        help=f"starts of {FEW} more runs, without classifiers",
    )
    parser.add_argument("--worlds", nargs="+", default=[*WORLDS], choices=[*WORLDS])
    parser.add_argument("--faults", nargs="*", default=faults, choices=faults)
    parser.add_argument("--quick", action="store_true", help="few runs, without classifiers")
    args = parser.parse_args()
    runs, judged, fault_runs, many = args.runs, args.judged, args.fault_runs, args.many
    if args.quick:
        runs, judged, fault_runs, many = 5, 0, 1, []
    perfect = sum(args.starts) * runs + sum(many) * FEW
    known = [WORLDS[world].faults for world in args.worlds]
    faulty = sum(fault in there for there in known for fault in args.faults) * FAULT_STARTS
    total = perfect * len(args.worlds) + faulty * fault_runs
    with progress_display("simulated experiments", "start", total) as bar:
        for line in perfect_rows(args.worlds, args.starts, many, runs, judged, bar):
            print(line, flush=True)
        print(f"\nFaults, {FAULT_STARTS} recordings: something differs, page green\n")
        for line in fault_rows(args.worlds, args.faults, fault_runs, bar, classifiers=judged > 0):
            print(line, flush=True)
    print(f"\n{time.process_time():.0f} s of processor time", file=sys.stderr)


if __name__ == "__main__":
    main()
