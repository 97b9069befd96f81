"""Settings of the documentation site: ``make docs`` builds it offline, with warnings as errors."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
os.environ.setdefault("OMP_NUM_THREADS", "1")
# A line with this machine's paths that kernels print for want of a widget.
os.environ["PYTHONWARNINGS"] = "ignore:IProgress not found"
# Notebooks call `animarl`: it is that of the Python that builds, activated or not.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

project = "AnimaRL"
author = "the AnimaRL developers"
extensions = [
    "myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "sphinx_copybutton",
]  # fmt: skip
root_doc = "index"
source_suffix = {".md": "myst-nb"}
exclude_patterns = ["_build", "_generated/extra", "package_index.md"]
html_theme = "furo"
html_title = "AnimaRL"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_copyright = False
html_extra_path = ["_generated/extra"]
html_show_sourcelink = False

# Pages are read on a repository's site too, where README.md is a folder's first page.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "dollarmath"]
# `sphinx-build -t unexecuted` is what make test builds: all pages, no notebook is executed.
unexecuted = tags.has("unexecuted")  # type: ignore[name-defined]  # noqa: F821
nb_execution_mode = "off" if unexecuted else "cache"
nb_execution_in_temp = True
nb_merge_streams = True
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True

autodoc_typehints = "none"
autodoc_member_order = "bysource"
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
suppress_warnings = ["mystnb.unknown_mime_type", "misc.highlighting_failure"]
if unexecuted:
    suppress_warnings.append("myst-nb.lexer")  # the kernel would have named the language
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

(HERE / "_generated" / "extra").mkdir(parents=True, exist_ok=True)
# Kernels warn that they use the machine's own network, which is no warning of a page.
kernel = HERE / "_generated" / "ipython" / "profile_default"
kernel.mkdir(parents=True, exist_ok=True)
(kernel / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 'ERROR'\n")
os.environ["IPYTHONDIR"] = str(kernel.parent)
SPECIES = ("agent", "fly", "newt", "silkmoth")


def make_live_pages(app: Any) -> None:
    """Write the what-if page of each packaged model beside the site's own pages."""
    from animarl_algos import load_run
    from animarl_algos.whatif.live_page import write_page

    folder = HERE / "_generated" / "extra" / "live"
    folder.mkdir(parents=True, exist_ok=True)
    for species in SPECIES:
        write_page(load_run(species), folder / f"{species}.html")


def list_public_names(app: Any) -> None:
    """Write the reference page from the list of public names that tests hold."""
    from importlib import import_module

    names = (HERE.parent / "tests" / "public_names.txt").read_text().splitlines()
    modules: dict[str, list[str]] = {}
    for name in names:
        if name and not name.startswith("animarl "):
            module, _, member = name.rpartition(".")
            modules.setdefault(module, []).append(member)
    lines = ["# API reference", "", "Every public name, by module.", ""]
    documented = set()
    for module, members in modules.items():
        lines += [f"## `{module}`", ""]
        for member in members:
            thing = getattr(import_module(module), member)
            kind = "function" if callable(thing) else "data"
            if isinstance(thing, type):
                kind = "exception" if issubclass(thing, BaseException) else "class"
            if kind != "data" and id(thing) in documented:
                continue
            documented.add(id(thing))
            option = "   :no-value:\n" if kind == "data" else ""
            lines += ["```{eval-rst}", f".. auto{kind}:: {module}.{member}\n{option}```", ""]
    folder = HERE / "_generated"
    folder.mkdir(exist_ok=True)
    (folder / "api.md").write_text("\n".join(lines), encoding="utf-8")


def copy_changelog(app: Any) -> None:
    """Write the changelog as a page of the site."""
    text = (HERE.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    text = re.sub(r"\]\((?!https?:)", "](../../", text).replace("](../../docs/", "](../")
    (HERE / "_generated" / "changes.md").write_text(text, encoding="utf-8")


def resolve_links(app: Any, docname: str, source: list[str]) -> None:
    """Let links to a folder lead to its README.md; the repository's other files become text."""
    page = HERE / f"{docname}.md"

    def resolved(found: re.Match[str]) -> str:
        text, target, anchor = found[1], found[2], found[3] or ""
        path = (page.parent / target).resolve()
        if (path / "README.md").is_file():
            target, path = f"{target.rstrip('/')}/README.md", path / "README.md"
        if path.is_file() and (HERE in path.parents or path.suffix != ".md"):
            return f"[{text}]({target}{anchor})"
        return text

    source[0] = re.sub(r"\[([^\]\n]*)\]\(((?!https?:)[\w./-]+?)(#[\w-]+)?\)", resolved, source[0])


def setup(app: Any) -> None:
    """Connect what is made at build."""
    if not unexecuted:
        app.connect("builder-inited", make_live_pages)
    app.connect("builder-inited", list_public_names)
    app.connect("builder-inited", copy_changelog)
    app.connect("source-read", resolve_links)
