"""``animarl simulate``: write simulated tracks for other programs."""

from pathlib import Path

from typer import Option

from animarl_algos.cli.shared import (
    TRACK_FILES,
    PlainConsole,
    named_split,
    refuse_overwriting,
    with_help,
    write_tracks,
)
from animarl_envs.errors import require


@with_help(
    model="A run's folder, or a packaged model by name, such as fly.",
    out=Option(help="File to write, .csv, .parquet, .nc for the package movement, or .nwb."),
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
    """Simulate a run's animals, and write their tracks as a table, movement's netCDF, or NWB.

    A table has a row for each frame and individual, netCDF a group and NWB a Position for each
    rollout. Lengths are in the recordings' own unit where it is known, as the names of the columns
    say (x_cm), and the middle of the arena is (0, 0).
    `animarl import` reads tables and netCDF.

    Examples:

      animarl simulate runs/first --out tracks.csv

      animarl simulate runs/first --out tracks.nc

      animarl simulate fly --split all --repetitions 5 --out tracks.parquet
    """
    formats = f"{out}: the suffix says the format: choose {', '.join(TRACK_FILES)}"
    require(out.suffix in TRACK_FILES, formats)
    from animarl_algos.cli.describing import counted
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
    write_tracks(out, rollouts, heads, unit_of(run.demos))
    PlainConsole().print(f"Wrote {out}: {counted(len(rollouts), 'rollout')}")
