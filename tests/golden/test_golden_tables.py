"""Foreign files are read, or refused, as ``tables.json`` says: no number changes unnoticed."""

import json

from golden_tables import RESULTS, results


def test_foreign_files_are_read_as_before() -> None:
    stored, found = json.loads(RESULTS.read_text()), results()
    other = {name: found[name] for name in found if found[name] != stored.get(name)}
    assert found.keys() == stored.keys()
    assert not other, "say in the commit why, and run python tests/golden/golden_tables.py"
