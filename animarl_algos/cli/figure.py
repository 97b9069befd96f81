"""``animarl figure``: a figure for a paper, recorded against simulated."""

from pathlib import Path

from animarl_algos.cli.shared import PlainConsole, with_help


@with_help(
    model="A run's folder, or a packaged model by name, such as fly.",
    out="Figure to write, .pdf, .svg or .png; the numbers of each panel stand beside it as CSV.",
    panel="Panels, separated by commas: paths, speeds, turning, bouts, neighbours, verdict; by "
    "default all that can be drawn.",
    width="Of a column of the journal, single (89 mm) or double (183 mm), or a number of mm.",
)
def figure_command(
    model: str, out: Path = Path("figure.pdf"), panel: str | None = None, width: str = "double"
) -> None:
    """Draw recorded against simulated animals as a figure for a paper.

    Examples:

      animarl figure runs/first --out fig.pdf

      animarl figure fly --panel paths,speeds,turning --width single --out fig.svg
    """
    from animarl_algos.report.panels import fitting_panels, width_in_mm, write_panels
    from animarl_algos.runs.evaluating import figure_sides
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run import Run

    millimetres, sides = width_in_mm(width), figure_sides(Run(model_folder(model)))
    names = [one.strip() for one in panel.split(",")] if panel else fitting_panels(sides)
    written = write_panels(sides, names, out, millimetres)
    tables = ", ".join(file.name for file in written[1:])
    PlainConsole().print(f"Wrote {out}, and beside it {tables}")
