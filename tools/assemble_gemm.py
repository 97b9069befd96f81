"""Assemble the page's matrix product: ``python tools/assemble_gemm.py`` (needs ``wasmtime``).

``animarl_algos/whatif/page/gemm.wat`` is its source; ``engine.js`` holds it as base64.
"""

import base64
import hashlib
import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "animarl_algos" / "whatif" / "page"
CONSTANT = re.compile(r'// gemm.wat \(sha256 (\w*)\)(.*?)const GEMM = "([^"]*)";', re.DOTALL)


def assemble() -> str:
    """Return ``engine.js`` with the module of ``gemm.wat`` and the hash of its source."""
    import wasmtime

    source = (PAGE / "gemm.wat").read_bytes()
    code = base64.b64encode(wasmtime.wat2wasm(source)).decode()
    constant = rf'// gemm.wat (sha256 {hashlib.sha256(source).hexdigest()})\2const GEMM = "{code}";'
    return CONSTANT.sub(constant, (PAGE / "engine.js").read_text(encoding="utf-8"))


if __name__ == "__main__":
    (PAGE / "engine.js").write_text(assemble(), encoding="utf-8")
