"""YAML as plain data: no tags that name code, no text that becomes larger than it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animarl_envs.errors import InputError, MissingExtraError, require
from animarl_envs.files import refuse_special

LONGEST = 64 * 2**10  # [bytes]
MOST_ALIASES = 32  # repeated within each other, a few dozen make a text of any size
DEEPEST = 50  # tables and lists within each other


def read_yaml(path: Path) -> Any:
    """The data in a YAML file.

    Raises
    ------
    InputError
        If it is no file, too long, not valid, names code, repeats itself too often, or gives a key
        twice.
    """
    refuse_special(path)
    short = path.stat().st_size <= LONGEST
    require(short, f"{path}: it is longer than {LONGEST:,} bytes: it is no file of settings")
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

    class Loader(yaml.SafeLoader):
        depth = aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.aliases += self.check_event(yaml.AliasEvent)
            self.depth += 1
            most = f"{place}: it repeats itself by more than {MOST_ALIASES} aliases"
            require(self.aliases <= MOST_ALIASES, most)
            require(self.depth <= DEEPEST, f"{place}: it nests deeper than {DEEPEST}: flatten it")
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def compose_mapping_node(self, anchor: Any) -> Any:
            """Of a key that is given twice YAML would take the last, without a word."""
            node = super().compose_mapping_node(anchor)
            lines: dict[tuple[str, str], int] = {}
            for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
                kind, line = (key.tag, key.value), key.start_mark.line + 1
                if kind in lines:
                    raise InputError(
                        f"{place}: line {line}: key {key.value!r} was given in line "
                        f"{lines[kind]} already: give it once"
                    )
                lines[kind] = line
            return node

    try:
        return yaml.load(text, Loader)
    except InputError:
        raise
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{place}: it is not valid YAML ({first}): correct it") from None
