"""Make the wheel of this platform and Python, which brings kernels as machine code.

    python -m tools.make_wheel [--out dist]

The wheel holds what `animarl compile` compiles, for every processor of the last ten years of the
platform (x86-64-v3, or ARM with NEON), and for the numba that is installed. On an older processor,
or beside another numba, kernels are compiled at their first use, as from the source archive.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import llvmlite.binding as llvm
import typer

from animarl_envs.compiling import SHIPPED, TARGET, Target

ROOT = Path(__file__).resolve().parents[1]
V3 = "+avx,+avx2,+bmi,+bmi2,+cx16,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse4.2,+ssse3"
PROCESSORS = {
    "x86_64": ("x86-64-v3", V3),
    "AMD64": ("x86-64-v3", V3),
    "aarch64": ("generic", "+neon"),
    "arm64": ("apple-m1", "+neon"),
}
"""LLVM's name of the least processor and its features, by Python's name of the machine."""


def main(
    out: Annotated[Path, typer.Option(help="Folder for the wheel.")] = Path("dist"),
) -> None:
    """Build the source archive, compile its kernels, and build the wheel of both."""
    machine = platform.machine()
    if machine not in PROCESSORS:
        sys.exit(f"machine {machine}: no wheel is known for it: add it to PROCESSORS in {__file__}")
    cpu, features = PROCESSORS[machine]
    target = Target(llvm.get_process_triple(), cpu, features)
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _run("-m", "build", "--sdist", "--outdir", temporary, cwd=ROOT)
        (archive,) = folder.glob("*.tar.gz")
        with tarfile.open(archive) as packed:
            packed.extractall(folder, filter="data")
        source = folder / archive.name.removesuffix(".tar.gz")
        code = source / SHIPPED.relative_to(ROOT)
        here = {"PYTHONPATH": str(source), "NUMBA_CACHE_DIR": str(code)}
        names = {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": features}
        _run("-m", "animarl_algos.cli.main", "compile", cwd=source, **here, **names)
        (code / TARGET).write_text(json.dumps(target._asdict()))
        system = sysconfig.get_platform().replace("linux", "manylinux_2_28")
        tags = (
            f"--plat-name={system}",
            f"--python-tag=cp{sysconfig.get_config_var('py_version_nodot')}",
        )
        options = [f"--config-setting=--build-option={tag}" for tag in tags]
        _run("-m", "build", "--wheel", "--outdir", temporary, *options, cwd=source)
        (wheel,) = folder.glob("*.whl")
        out.mkdir(parents=True, exist_ok=True)
        print(f"{shutil.copy(wheel, out)}: {wheel.stat().st_size / 1e6:.1f} MB")


def _run(*arguments: str, cwd: Path, **environment: str) -> None:
    subprocess.run([sys.executable, *arguments], cwd=cwd, env=os.environ | environment, check=True)


if __name__ == "__main__":
    typer.run(main)
