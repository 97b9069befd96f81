"""``animarl simulate``: write simulated tracks as a table for other programs."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer import Option

from animarl_algos.cli.shared import (
    PlainConsole,
    named_split,
    refuse_overwriting,
    with_help,
    write_csv,
)
from animarl_envs.errors import require

SUFFIXES = (".csv", ".parquet")


@with_help(
    model="A run's folder, or a packaged model by name, such as fly.",
    out=Option(help="Table to write, .csv or .parquet."),
    repetitions=Option(min=1, help="Rollouts from each start."),
    split="Episodes to start from: train, val, test or all.",
    seed="Seed of the rollouts; by default that of the run.",
)
def simulate_command(
    model: str,
    out: Path = Path("simulated.csv"),
    repetitions: int = 1,
    split: str = "test",
    seed: int | None = None,
) -> None:
    """Simulate a run's animals, and write their tracks as a table.

    There is a row for each frame and individual. Lengths are in the recordings' own unit where it
    is known, as the names of the columns say (x_cm), and the middle of the arena is (0, 0).
    `animarl import` reads the table.

    Examples:

      animarl simulate runs/first --out tracks.csv

      animarl simulate fly --split all --repetitions 5 --out tracks.parquet
    """
    require(
        out.suffix in SUFFIXES, f"{out}: the suffix says the format: choose {' or '.join(SUFFIXES)}"
    )
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run import Run

    run = Run(model_folder(model))
    refuse_overwriting(out, run.path)
    rows = list(_rows(run, split, repetitions, seed))
    if out.suffix == ".csv":
        write_csv(out, rows)
    else:
        import pandas as pd

        from animarl_envs.files import write_then_rename

        with write_then_rename(out) as part:
            pd.DataFrame(rows).to_parquet(part)
    count = len({(row["recording"], row["repetition"]) for row in rows})
    PlainConsole().print(f"Wrote {out}: {count} rollouts, {len(rows)} rows")


def _rows(run: Any, split: str, repetitions: int, seed: int | None) -> Iterator[dict[str, Any]]:
    """Yield a row per frame and individual of each rollout."""
    from animarl_envs.demos.summary import unit_of

    demos = run.demos.select(split=named_split(split))
    rollouts = run.simulate(split=named_split(split), repetitions=repetitions, seed=seed)
    unit = unit_of(run.demos)
    conditions = run.species.conditions or ("0", "1")
    x, y = ((axis if " " in unit.name else f"{axis}_{unit.name}") for axis in "xy")
    for number, start in enumerate(rollouts.demo.tolist()):
        repetition = int(rollouts.repetition[number])
        for frame, places in enumerate((unit.per_arena_unit * rollouts.path(number)).tolist()):
            for name, place in zip(rollouts.individuals, places, strict=True):
                yield {
                    "recording": f"simulated {demos.recording[start]}/{start}/{repetition}",
                    "condition": conditions[int(rollouts.condition[number])],
                    "repetition": repetition,
                    "frame": frame,
                    "time_s": round(frame * rollouts.dt, 9),
                    "individual": name,
                    x: round(place[0], 6),
                    y: round(place[1], 6),
                }
