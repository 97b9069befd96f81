"""Compile kernels, and keep their machine code under a key of all their sources.

Kernels inline each other across modules, but numba keeps the code of each under the path and the
date of its own file alone. So it is kept in a folder that is named after a hash of every source a
kernel may hold a part of: an edit of the transition, or another numba, has all that use it compiled
anew, and a copy of the package at another path does not. Folders of old sources stay behind, beside
Python's own ``__pycache__`` files, and may be deleted at any time.

Where that folder lacks a kernel, the code that installation left in the package is taken: a
checkout is compiled as the last step of ``make .venv/.installed``, for this processor, and a wheel
of a platform (``tools/make_wheel.py``) brings machine code for many processors.
"""

from __future__ import annotations

import atexit
import functools
import gc
import hashlib
import json
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import llvmlite.binding as llvm
import numba as nb
from numba.core import event
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    _CacheLocator,
)
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.misc import appdirs

_HERE = Path(__file__).resolve().parent
_SETTINGS: Any = nb.config
_user_cache_dir: Any = appdirs.user_cache_dir
# Modules with kernels, and what kernels take in as they are compiled: constants in capitals, and
# whatever they name of a module that they import whole.
_KERNELS = re.compile(r"^(?:import numba|from numba|from animarl_envs\.compiling)\b", re.MULTILINE)
_IMPORTS = re.compile(r"^from (\w+(?:\.\w+)*) import (\([^)]*\)|.*)$", re.MULTILINE)
COMPILING = "compiling for this machine, about a minute, once; `animarl compile` does it beforehand"
SHIPPED, TARGET = _HERE / "machine_code", "target.json"
"""Folder of the machine code that a wheel brings, and the file in it that names the target."""
_COMPILED = _HERE / "__pycache__"
FULL_VECTORS = "-vectorizer-maximize-bandwidth"
_CONSTANT = re.compile(r"\b[A-Z][A-Z0-9_]+\b")


class CompilationWarning(UserWarning):
    """Kernels are being compiled, which takes seconds, once on a machine."""


class Compilations(event.Listener):  # type: ignore[misc]
    """Say once in a process that kernels are being compiled: a line, or in a log a warning.

    Meanwhile Python's collector of cycles waits, since it would find nothing, and LLVM fills vector
    registers by the smaller numbers of a loop: what is observed is float32, of float64 states.
    """

    reported = False

    def __init__(self) -> None:
        self._depth = 0
        self._ours = 0  # the depth of a kernel of this project, from 1
        self._collects = False

    def on_start(self, of: Any) -> None:
        """Note that a compilation begins, perhaps within another; one read from disk is none."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        module = str(of.data["dispatcher"].py_func.__module__)  # None of what exec made
        if not module.startswith("animarl"):
            return
        if not self._ours:
            self._ours = self._depth
            llvm.set_option("animarl", f"{FULL_VECTORS}=true")
        if self.reported:
            return
        self.reported = True
        terminal = sys.stderr is not None and sys.stderr.isatty()
        try:
            if not terminal:
                warnings.warn(COMPILING, CompilationWarning, stacklevel=2)
        except CompilationWarning:  # one that is made an error would stop a kernel midway
            terminal = sys.stderr is not None
        if terminal:
            print(COMPILING, file=sys.stderr, flush=True)

    def on_end(self, of: Any) -> None:
        """Note that a compilation has ended."""
        if self._ours == self._depth:
            self._ours = 0
            llvm.set_option("animarl", f"{FULL_VECTORS}=false")
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


event.register("numba:compile", Compilations())  # type: ignore[no-untyped-call]


def jit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a kernel and keep its machine code on disk; divisions by zero are NumPy's.

    A decorator, with or without further options of ``numba.njit``.
    """
    if function is None:
        return functools.partial(jit, **options)
    kept = options.pop("cache", True)
    usual: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
    made = nb.njit(**usual | options)(function)
    if kept and not _SETTINGS.DISABLE_JIT:
        made._cache = KernelCache(function)  # type: ignore[no-untyped-call]
    return made


def inline_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that is inlined into kernels and never called from Python."""
    return _inlined(function, InlineCompiler)


def inline_wrapper(function: Callable[..., Any]) -> Any:
    """Compile an inlined function that mainly calls others, which are optimised instead."""
    return _inlined(function, WrapperCompiler)


def _inlined(function: Callable[..., Any], compiler: type[InlineCompiler]) -> Any:
    options = {"forceinline": True, "cache": False, "no_cpython_wrapper": True}
    made = jit(function, pipeline_class=compiler, **options)
    if not _SETTINGS.DISABLE_JIT:
        made.__class__ = InlineDispatcher
    return made


# Parts are compiled by subclasses of numba's own classes, which a release may change, so numba has
# an upper bound. Plain ``njit(forceinline=True)`` also makes machine code of every part: the cold
# first step then took 15 % more processor time (AnimaRL/Agent-v0, numba 0.68.1).


class InlineLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Optimised code to be inlined; only the kernels that hold it become machine code."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return no address, since there is no machine code."""
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        return 0

    @property
    def codegen(self) -> InlineLibrary:
        """The keeper of the function's environment."""
        return self

    def set_env(self, env_name: str, env: object) -> None:
        """Keep nothing: what needs an environment, such as printing, has no place in a part."""


class WrapperLibrary(InlineLibrary):
    """Code to be inlined whose parts are optimised already."""

    def _optimize_final_module(self) -> None:
        """Leave the optimisation to the kernel."""


class InlineCompiler(Compiler):  # type: ignore[misc]
    """A compiler of inlined functions."""

    library: type[InlineLibrary] = InlineLibrary

    def define_pipelines(self) -> Any:
        """Return numba's pipelines with a library that makes no machine code."""
        codegen = self.state.targetctx.codegen()
        self.state.library = self.library(codegen, self.state.func_id.func_qualname)
        return super().define_pipelines()  # type: ignore[no-untyped-call]


class WrapperCompiler(InlineCompiler):
    """A compiler of inlined functions that mainly call others."""

    library = WrapperLibrary


class InlineDispatcher(CPUDispatcher):  # type: ignore[misc]
    """An inlined function, which Python cannot call: numba would crash."""

    def __call__(self, *_: Any) -> None:
        """Refuse the call."""
        raise TypeError(
            f"{self.py_func.__name__} is a part of a kernel: mark it with jit to call it"
        )


class SourceLocator(_CacheLocator):  # type: ignore[misc]
    """Where a kernel's machine code is kept: by its module and the hash of all sources."""

    def __init__(self, kernel: Callable[..., Any]) -> None:
        self._kernel = kernel
        package = kernel.__module__.partition(".")[0]
        self._path = _folder(package, _SETTINGS.CACHE_DIR) / kernel.__module__

    def get_cache_path(self) -> str:
        """Return the folder of the kernel's files."""
        return str(self._path)

    def get_source_stamp(self) -> str:
        """Return nothing: the folder's name stands for the sources."""
        return ""

    def get_disambiguator(self) -> str:
        """Return the line of the kernel, which tells it from others of its name."""
        return str(self._kernel.__code__.co_firstlineno)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> SourceLocator:
        """Return the locator of a kernel, which does not look at the path of its file."""
        return cls(py_func)


class KernelCacheParts(CompileResultCacheImpl):  # type: ignore[misc]
    """What numba keeps of a kernel, with this package's locator in place of numba's."""

    _locator_classes: ClassVar[list[Any]] = [SourceLocator]  # type: ignore[misc]


class Target(NamedTuple):
    """The processors that a wheel's machine code is for, as numba names them."""

    triple: str
    cpu: str
    features: str

    def magic_tuple(self) -> tuple[str, str, str]:
        """Return what numba keeps machine code under, as its code generators do."""
        return self.triple, self.cpu, self.features

    def runs_here(self) -> bool:
        """Return whether this processor has all that the code needs."""
        own = {f"+{name}" for name, there in llvm.get_host_cpu_features().items() if there}
        return llvm.get_process_triple() == self.triple and own >= set(self.features.split(","))


@functools.cache
def shipped_target() -> Target | None:
    """Return what a wheel's machine code is for; None if there is none, or it does not run here."""
    file = SHIPPED / TARGET
    target = Target(**json.loads(file.read_text())) if file.is_file() else None
    return target if target is not None and target.runs_here() else None


class KernelCache(FunctionCache):  # type: ignore[misc]
    """The machine code of a kernel on disk: of the usual folder, or else what installation left."""

    _impl_class = KernelCacheParts
    takes_installed: ClassVar[bool] = True

    def _load_overload(self, signature: Any, context: Any) -> Any:
        kept = super()._load_overload(signature, context)  # type: ignore[no-untyped-call]
        if kept is not None or not self.takes_installed:
            return kept
        for root, target in ((_COMPILED, context.codegen()), (SHIPPED, shipped_target())):
            folder = root.joinpath(*Path(self.cache_path).parts[-2:])  # key of sources, module
            if target is None or not folder.is_dir():
                continue
            file: Any = IndexDataCacheFile(str(folder), self._impl.filename_base, "")  # type: ignore[no-untyped-call]
            data = file.load(self._index_key(signature, target))  # type: ignore[no-untyped-call]
            if data is not None:
                return self._impl.rebuild(context, data)
        return None


@functools.cache
def _folder(package: str, of_user: str) -> Path:
    """Return the folder for a package's machine code; in ``NUMBA_CACHE_DIR`` if that is set."""
    name = f"kernels-{source_key(package)}"
    usual = (_COMPILED, Path(_user_cache_dir("animarl", appauthor=False)))
    for root in (Path(of_user),) if of_user else usual:
        if _can_write(root / name):
            return root / name
    return _temporary() / name


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@functools.cache
def _temporary() -> Path:
    """Return a folder of this process alone: in a shared one could lie code of somebody else."""
    folder = Path(tempfile.mkdtemp(prefix="animarl-kernels-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    warnings.warn(
        "there is no folder to keep compiled kernels in, so every start compiles them anew: set "
        "NUMBA_CACHE_DIR to a folder that can be written",
        stacklevel=2,
    )
    return folder


@functools.cache
def source_key(package: str) -> str:
    """Return a hash of numba's version and of the sources that a package's kernels are made of.

    These are the modules of the environments and of ``package`` that have kernels, those that such
    modules take constants from, and those that they import whole.
    """
    digest = hashlib.sha256(nb.__version__.encode())
    roots = {_HERE.name: _HERE}
    locations = getattr(sys.modules.get(package), "__path__", None)
    roots |= {package: Path(next(iter(locations)))} if locations else {}
    for path in _kernel_sources(roots):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _kernel_sources(roots: dict[str, Path]) -> list[Path]:
    sources: set[Path] = set()
    for root in roots.values():
        for path in root.rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not _KERNELS.search(text):
                continue
            sources.add(path)
            for module, names in _IMPORTS.findall(text):
                top, *below = module.split(".")
                if top not in roots:
                    continue
                source = roots[top].joinpath(*below)
                held = [source / name for name in re.findall(r"\w+", names)]
                if _CONSTANT.search(names):
                    held += [source, source / "__init__"]
                sources |= {p for p in (one.with_suffix(".py") for one in held) if p.is_file()}
    return sorted(sources)


def by_reference(make_reference: Callable[[Any], Any], parts: Any) -> Any:
    """Return ``make_reference(parts)``, one object in place of a tuple of many arrays.

    Handing over the arrays one by one would take longer than the step of a single copy. Without
    compilation the tuple itself has the same attributes.
    """
    return parts if _SETTINGS.DISABLE_JIT else make_reference(parts)
