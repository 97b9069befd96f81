"""``animarl simulate``: write simulated tracks as a table for other programs."""

from pathlib import Path

from typer import Option

from animarl_algos.cli.shared import (
    PlainConsole,
    named_split,
    refuse_overwriting,
    track_rows,
    with_help,
    write_csv,
)
from animarl_envs.errors import require
from animarl_envs.files import write_then_rename

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
    formats = f"{out}: the suffix says the format: choose {' or '.join(SUFFIXES)}"
    require(out.suffix in SUFFIXES, formats)
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run import Run
    from animarl_envs.demos.summary import unit_of

    run, starts = Run(model_folder(model)), named_split(split)
    refuse_overwriting(out, run.path)
    recordings = run.demos.select(split=starts).recording
    rollouts = run.simulate(split=starts, repetitions=repetitions, seed=seed)
    conditions = run.species.conditions or ("0", "1")
    each = zip(rollouts.demo, rollouts.repetition, rollouts.condition, strict=True)
    heads = [
        {
            "recording": f"simulated {recordings[start]}/{start}/{repetition}",
            "condition": conditions[condition],
        }
        for start, repetition, condition in each
    ]
    rows = track_rows(rollouts, heads, unit_of(run.demos))
    if out.suffix == ".csv":
        write_csv(out, rows)
    else:
        import pandas as pd

        with write_then_rename(out) as part:
            pd.DataFrame(rows).to_parquet(part)
    PlainConsole().print(f"Wrote {out}: {len(rollouts)} rollouts")
