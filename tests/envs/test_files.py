"""Files are written whole or not at all; what a kill leaves goes with the next write."""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from refusals import refuses

from animarl_envs.files import all_files_or_none, write_then_rename

WRITERS = {"write_then_rename": write_then_rename, "all_files_or_none": all_files_or_none}
KILLED = """
import os, signal, sys
from pathlib import Path
from animarl_envs import files
with getattr(files, sys.argv[1])(sys.argv[2]) as part:
    (part / "a.txt" if part.is_dir() else part).write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL and locks on files")
@pytest.mark.parametrize("name", WRITERS)
def test_a_part_that_a_kill_left_goes_with_the_next_write_and_one_in_use_stays(
    name: str, tmp_path: Path
) -> None:
    writer: Callable[[Path], AbstractContextManager[Path]] = WRITERS[name]
    path = tmp_path / "out[1]"
    subprocess.run([sys.executable, "-c", KILLED, name, str(path)], check=False)
    (orphan,) = tmp_path.iterdir()
    assert ".part" in orphan.name
    os.utime(orphan, (0, 0))
    with writer(path) as part:
        assert not orphan.exists()
        os.utime(part, (0, 0))
        with writer(path) as other:  # does not take it for an orphan
            assert part.exists() and other != part
    assert not [one for one in tmp_path.iterdir() if ".part" in one.name]


def test_files_are_moved_only_when_all_are_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "old.csv").write_text("old")
    with pytest.raises(RuntimeError), all_files_or_none(out) as part:
        (part / "old.csv").write_text("new")
        raise RuntimeError
    assert [*out.iterdir()] == [out / "old.csv"] and (out / "old.csv").read_text() == "old"
    with all_files_or_none(out) as part:
        (part / "below").mkdir()
        (part / "below" / "new.csv").write_text("new")
    assert {path.name for path in out.rglob("*.csv")} == {"old.csv", "new.csv"}


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes, links and permissions")
def test_devices_are_not_replaced_links_are_followed_and_the_umask_is_kept(tmp_path: Path) -> None:
    pipe, link, file = tmp_path / "pipe", tmp_path / "link.csv", tmp_path / "file.csv"
    os.mkfifo(pipe)
    for special in (pipe, Path("/dev/null")):
        refuses("it is a pipe or a device: name another file", write_then_rename(special).__enter__)
    assert pipe.is_fifo()
    link.symlink_to(file)
    before = os.umask(0o077)
    try:
        with write_then_rename(link) as part:
            part.write_text("private")
        assert link.is_symlink() and file.read_text() == "private"
        assert file.stat().st_mode & 0o777 == 0o600
        os.umask(0o002)
        with write_then_rename(file):
            pass
        assert file.stat().st_mode & 0o777 == 0o664
    finally:
        os.umask(before)
