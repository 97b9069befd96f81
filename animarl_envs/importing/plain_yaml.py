"""YAML as plain data: no tags that name code, no text that becomes larger than it is."""

from __future__ import annotations

import re
from itertools import accumulate
from pathlib import Path
from typing import Any

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import refuse_special

LONGEST = 64 * 2**10  # [bytes]
MOST_ALIASES = 32  # repeated within each other, a few dozen make a text of any size
ALIAS = re.compile(r"(?:^|[\s,\[\]{}])\*[^\s,\[\]{}]")
DEEPEST = 50  # brackets within brackets, for which the parser takes the square of the time


def read_yaml(path: Path) -> Any:
    """The data in a YAML file.

    Raises
    ------
    InputError
        If it is no file, too long, not valid, names code, repeats itself too often, or gives a key
        twice.
    """
    refuse_special(path)
    if path.stat().st_size > LONGEST:
        raise InputError(f"{path}: it is longer than {LONGEST:,} bytes: it is no file of settings")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: it cannot be read ({error}): check it") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, place: str) -> Any:
    """The data in a YAML text; ``place`` is for messages."""
    try:
        import yaml
    except ImportError as error:
        raise MissingExtraError("settings in YAML", "data") from error
    if len(ALIAS.findall(text)) > MOST_ALIASES:
        raise InputError(f"{place}: it repeats itself by more than {MOST_ALIASES} aliases")
    if _depth(text) > DEEPEST:
        raise InputError(f"{place}: its brackets nest deeper than {DEEPEST}: flatten it")
    try:
        loader = yaml.SafeLoader(text)
        try:
            node = loader.get_single_node()
            _refuse_twice(node, place)
            return None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{place}: it is not valid YAML ({first}): correct it") from None
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{place}: it is not valid YAML ({error}): correct it") from None


def _refuse_twice(root: Any, place: str) -> None:
    """Of a key that is given twice in one table YAML would take the last, without a word."""
    import yaml

    todo, seen = [root], set()
    while todo:
        node = todo.pop()
        if id(node) in seen:  # an alias
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            todo += node.value
        if not isinstance(node, yaml.MappingNode):
            continue
        lines: dict[tuple[str, str], int] = {}
        for key, value in node.value:
            todo += [key, value]
            if isinstance(key, yaml.ScalarNode):
                kind, line = (key.tag, key.value), key.start_mark.line + 1
                if kind in lines:
                    raise InputError(
                        f"{place}: line {line}: key {key.value!r} was given in line "
                        f"{lines[kind]} already: give it once"
                    )
                lines[kind] = line


def _depth(text: str) -> int:
    """Most brackets that are open at once, those in quotes included."""
    steps = ((c in "[{") - (c in "]}") for c in text)
    return max(accumulate(steps, initial=0))
