"""Compute the golden corpus and say what differs; ``--write`` stores it.

python tests/golden                         # compare, all parts
python tests/golden worlds "agent single"   # one part, entries whose name begins so
python tests/golden --write                 # store: say in the commit why numbers changed
"""

import sys
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[n]) for n in (1, 2)]

import golden_corpus as golden  # noqa: E402


def main(words: list[str]) -> int:
    """Number of entries that differ."""
    write, names = "--write" in words, [word for word in words if word != "--write"]
    start = names[1] if len(names) > 1 else ""
    differing = 0
    for part in names[:1] or golden.PARTS:
        entries = {} if write and not start else golden.stored(part)["entries"]
        for name, compute in golden.PARTS[part]():
            if not name.startswith(start):
                continue
            began, entry = time.process_time(), compute()
            took = time.process_time() - began
            same = entries.get(name) == entry
            differing += not same
            changed = [k for k, v in entry.items() if entries.get(name, {}).get(k) != v]
            print(f"{part} {name}: {'same' if same else 'DIFFERS in ' + ', '.join(changed)} "
                  f"({took:.1f} s)", flush=True)  # fmt: skip
            entries[name] = entry
        if write:
            golden.store(part, entries)
    return 0 if write else differing


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
