"""Reads and checks values of TOML tables, and keeps mistakes with their keys; knows no particular table."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from aiorts.errors import InvalidNameError
from aiorts.late import dataclass
from aiorts.model.names import check_name
from aiorts.model.values import WORDS
from aiorts.spelling import nearest, suggestion
from aiorts.system.text.origins import Origin, Origins, Spot
from aiorts.system.text.places import Key

_WORDS: Final = {**WORDS, dict: "a table"}
NOTHING: Final[Any] = object()
_MOST_MISTAKES: Final = 200
"""The most mistakes that are named at once."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake, and the key that it is about; `of_key` if the key itself is wrong, not its value."""

    key: Key
    where: str
    what: str
    of_key: bool = False
    origin: Origin | None = None
    """The origin of the key, if it is no key of the whole system."""

    def spot(self, origins: Origins) -> Spot:
        """The place of the mistake."""
        return (origins.of(self.key) if self.origin is None else self.origin).spot(of_key=self.of_key)

    @property
    def typed(self) -> bool:
        """Whether the mistake is in the command line, and in no file."""
        return self.where.startswith("--")


class Reading:
    """The base class of readers of tables."""

    def __init__(self) -> None:
        self.mistakes: list[Mistake] = []

    def _get(
        self, key: Key, table: dict[str, Any], word: str, kind: type, default: Any = NOTHING, *, missing: Any = NOTHING
    ) -> Any:
        """The value of a key, or `default`. Without a default, an absent key is a mistake; the value is `missing`."""
        if word not in table:
            if default is NOTHING:
                self._missing(key, table, word)
                return missing
            return default
        value = table[word]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind not in (bool, object)):
            self._say((*key, word), f"expected {_WORDS.get(kind, 'a value')}, got {value!r:.80}")
            return missing if default is NOTHING else default
        return value

    def _missing(self, key: Key, table: Mapping[str, Any], word: str) -> None:
        """Report a missing key: at a misspelt form of it, once; else at the table."""
        near = nearest(word, table)
        misspelt = (*key, near)
        if not near:
            self._say(key, f"{word} is missing", of_key=True)
        elif all(one.key != misspelt for one in self.mistakes):
            self._say(misspelt, f"unknown key {near[:80]!r}; did you mean {word!r}?", of_key=True)

    def _tables(self, top: dict[str, Any], key: str, word: str) -> dict[str, dict[str, Any]]:
        tables = top.get(key, {})
        if not isinstance(tables, dict):
            self._say((key,), f"expected tables such as [{key}.NAME], got {tables!r:.60}; write [{key}.NAME]")
            return {}
        good = {}
        for name, table in tables.items():
            try:
                check_name(name, word)
            except InvalidNameError as error:
                self._say((key, name), str(error), of_key=True)
                continue
            if isinstance(table, dict):
                good[name] = table
            else:
                self._say((key, name), f"expected a table, [{key}.{name}], got {table!r:.60}")
        return good

    def _texts(self, key: Key, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list):
            self._say(key, f"expected a list of texts, got {value!r:.80}")
            return ()
        for number, item in enumerate(value):
            if not isinstance(item, str):
                self._say((*key, number), f"expected a list of texts, got {item!r:.80}")
        return tuple(item for item in value if isinstance(item, str))

    def _only(self, key: Key, table: Mapping[str, Any], known: Collection[str]) -> list[str]:
        unknown = [word for word in table if word not in known]
        for word in unknown:
            self._unknown((*key, word), "key", word, known, of_key=True)
        return unknown

    def _unknown(self, key: Key, word: str, name: str, known: Iterable[str], *, of_key: bool = False) -> None:
        if len(self.mistakes) < _MOST_MISTAKES:  # near names take their time
            self._say(key, f"unknown {word} {name[:80]!r}; {suggestion(name, known)}", of_key=of_key)

    def _say(self, key: Key, what: str, *, of_key: bool = False) -> None:
        if len(self.mistakes) < _MOST_MISTAKES:
            self.mistakes.append(Mistake(key, spelled(key) or "file", what, of_key))


def spelled(key: Key) -> str:
    """A key as messages spell it: elements of lists count from 1."""
    text = ""
    for part in key:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part[:80]}" if text else part[:80]
    return text
