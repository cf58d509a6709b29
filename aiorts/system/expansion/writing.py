"""The tables of a system as one text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from aiorts.model.configuration.toml_values import basic_string, value_text
from aiorts.model.wanted.system_text import is_list_of_tables, literal
from aiorts.system.expansion.entries import NAMED


def document_text(top: Mapping[str, Any]) -> str:
    """The TOML text of the tables, in which nothing is left to be expanded."""
    return "\n".join(_lines(top)) + "\n"


def _lines(top: Mapping[str, Any]) -> Iterator[str]:
    for word, value in top.items():
        if not isinstance(value, dict) and not is_list_of_tables(value):
            yield _pair(word, value)
    for word, value in top.items():
        if word in NAMED and isinstance(value, dict):
            for name, table in value.items():
                yield from ("", f"[{word}.{_key(name)}]", *(_pair(key, one) for key, one in table.items()))
        elif is_list_of_tables(value):
            for table in value:
                yield from ("", f"[[{_key(word)}]]", *(_pair(key, one) for key, one in table.items()))
        elif isinstance(value, dict):
            yield from ("", f"[{_key(word)}]", *(_pair(key, one) for key, one in value.items()))


def _pair(key: str, value: Any) -> str:
    return f"{_key(key)} = {value_text(key, literal(value))}"


def _key(name: str) -> str:
    return basic_string(literal(name))
