"""Imports of large tables: memory, progress, and Ctrl-C, which leaves nothing half done."""

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pages import python

ANIMARL = [sys.executable, "-c", "from animarl_algos.cli.main import main; main()"]
ROWS_IN_A_GIGABYTE = 28_800_000
GIGABYTE = 10**9


def write_table(path: Path, rows: int, block: int = 200_000) -> Path:
    """A long table of two individuals who walk in a circle; distinct digits in every block."""
    frames = block // 2
    time = 2 * np.pi * np.arange(frames) / frames
    near = [f"{np.cos(t):.9f},{np.sin(t):.9f}" for t in time]
    far = [f"{-2 * np.cos(t):.9f},{2 * np.sin(t):.9f}" for t in time]
    with path.open("w") as file:
        file.write("frame,id,x,y\n")
        for start in range(0, rows // 2, frames):
            file.writelines(
                f"{start + t},a,{near[t]}\n{start + t},b,{far[t]}\n"
                for t in range(min(frames, rows // 2 - start))
            )
    return path


def started(*words: object) -> tuple[subprocess.Popen[bytes], int]:
    """A running command, and the terminal that its messages appear on."""
    terminal, end = os.openpty()
    process = subprocess.Popen(
        [*ANIMARL, *map(str, words)], stdout=subprocess.DEVNULL, stderr=end,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(end)
    return process, terminal


def messages(terminal: int) -> str:
    """What appears on the terminal next; nothing once the command has ended."""
    with contextlib.suppress(OSError):  # so Linux says that the other end is closed
        return os.read(terminal, 65536).decode(errors="replace")
    return ""


def test_imports_read_a_large_table_in_pieces(tmp_path: Path) -> None:
    """Memory above the start stays below six times the table's size (1 GB within 4 GB: docs)."""
    rng = np.random.default_rng(0)
    path = tmp_path / "large.csv"
    with path.open("w") as file:
        file.write("frame,id,x,y\n")
        steps = np.cumsum(rng.normal(0, 1e-3, (100_000, 2, 2)), axis=0)
        for t, bodies in enumerate(steps.tolist()):
            for name, (x, y) in zip("ab", bodies, strict=True):
                file.write(f"{t},{name},{x:.12f},{y:.12f}\n")
    script = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "import pandas, scipy.signal\n"
        "from animarl_envs.importing.readers import default_recipe, follow, get_reader\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024\n"
        "before, told = peak(), []\n"
        "recipe = default_recipe(get_reader('long-table'), frame_rate=100.0, decision_rate=10.0)\n"
        "demos = follow(recipe, [Path(sys.argv[1])], told.append)\n"
        "assert demos.lengths.sum() == 9999 and told and told[-1] == 1.0 == max(told)\n"
        "print((peak() - before) / Path(sys.argv[1]).stat().st_size)\n"
    )
    assert float(python(script, path).stdout) < 6.0


def test_ctrl_c_while_a_table_is_imported_leaves_what_was_there(tmp_path: Path) -> None:
    table, out = write_table(tmp_path / "t.csv", 3_000_000), tmp_path / "out" / "demos.npz"
    out.parent.mkdir()
    out.write_bytes(b"from an earlier import")
    process, terminal = started("import", table, "--fps", 100, "--out", out)
    said = ""
    while "Reading" not in said:
        said += (new := messages(terminal))
        assert new, f"it ended before it was interrupted: {said}"
    process.send_signal(signal.SIGINT)
    while new := messages(terminal):
        said += new
    os.close(terminal)
    assert process.wait() not in (0, 2) and "Traceback" not in said
    assert [path.name for path in out.parent.iterdir()] == ["demos.npz"]
    assert out.read_bytes() == b"from an earlier import"


@pytest.mark.slow
def test_import_of_a_gigabyte_stays_within_four_and_shows_progress(tmp_path: Path) -> None:
    """Prints size, processor time and highest memory: ``pytest -m slow -s -k gigabyte``."""
    table, out = write_table(tmp_path / "t.csv", ROWS_IN_A_GIGABYTE), tmp_path / "demos.npz"
    assert table.stat().st_size > GIGABYTE
    process, terminal = started(
        "import", table, "--fps", 100, "--decision-rate", 10, "--target", "b", "--out", out
    )
    said = ""
    while new := messages(terminal):
        said += new
    os.close(terminal)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, said
    shares = [int(share) for share in re.findall(r"(\d+)%", said)]
    assert len(set(shares)) > 20 and shares == sorted(shares) and "Cleaning and cutting" in said
    print(
        f"{table.stat().st_size / GIGABYTE:.2f} GB in {used.ru_utime + used.ru_stime:.0f} s of "
        f"processor time, at most {used.ru_maxrss * 1024 / GIGABYTE:.2f} GB of memory"
    )
    assert used.ru_maxrss * 1024 < 4 * GIGABYTE
    assert out.exists()
