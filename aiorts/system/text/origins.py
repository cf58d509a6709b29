"""The place of each key of a system: its file, and its line there; a system may be written in several files.

A key of the system is mapped to a key of a file by its longest known beginning; the rest of the key is the same in
both. For a system of one file only that file is kept, and each key is mapped to itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from aiorts.errors import AiortsError
from aiorts.late import dataclass
from aiorts.system.text.places import Key, Place, places_of

_E = TypeVar("_E", bound=AiortsError)


@dataclass(frozen=True, slots=True)
class Source:
    """One file that was read."""

    path: Path
    text: str


@dataclass(frozen=True, slots=True)
class Spot:
    """A place in one of the files."""

    source: Source
    place: Place

    def __str__(self) -> str:
        return f"{self.source.path}:{self.place.line}:{self.place.column}"

    @property
    def quote(self) -> str:
        """The line of the place."""
        return places_of(self.source.text).line(self.place.line)

    def mark(self, error: _E) -> _E:
        """The error, marked with this place, so that the place is quoted."""
        # In columns of messages a carriage return before the end of a line does not count.
        text = self.source.text.replace("\r\n", "\n")
        return error.at(text, *places_of(text).extent(self.place))


@dataclass(frozen=True, slots=True)
class Origin:
    """The file in which a key of the system stands, and its key there."""

    source: Source
    key: Key

    def spot(self, *, of_key: bool = False) -> Spot:
        """The place of the value, or of the key itself."""
        places = places_of(self.source.text)
        return Spot(self.source, places.key(self.key) if of_key else places.value(self.key))

    def below(self, *key: str | int) -> Origin:
        """The origin of a key below this one."""
        return Origin(self.source, (*self.key, *key))


@dataclass(frozen=True, slots=True)
class Origins:
    """The origins of all keys of a system."""

    main: Source
    """The file that was named."""
    moved: Mapping[Key, Origin] = field(default_factory=lambda: MappingProxyType({}))
    """The origins of keys that have another name in their file, or stand in another file."""
    others: tuple[Source, ...] = ()
    """The included files."""

    def of(self, key: Key) -> Origin:
        """The origin of a key."""
        for length in range(len(key), 0, -1) if self.moved else ():
            if (found := self.moved.get(key[:length])) is not None:
                return found.below(*key[length:])
        return Origin(self.main, key)

    def spot(self, key: Key, *, of_key: bool = False) -> Spot:
        """The place of a key's value, or of the key itself."""
        return self.of(key).spot(of_key=of_key)

    def known(self, key: Key) -> Key:
        """The key, or as much of its beginning as stands in a file."""
        while key:
            origin = self.of(key)
            if places_of(origin.source.text).known(origin.key) == origin.key:
                break
            key = key[:-1]
        return key

    def inside(self, key: Key, text: str, offset: int) -> Spot | None:
        """The place of the character at `offset` of a part of a value; None when the part is not written literally."""
        origin = self.of(key)
        place = places_of(origin.source.text).inside(origin.key, text, offset)
        return None if place is None else Spot(origin.source, place)

    def sources(self) -> Iterator[Source]:
        """All files, the one that was named first."""
        yield self.main
        yield from self.others
