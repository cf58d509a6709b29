"""A system file as it was read: what it says, where it lies, and what a command line says against it."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

from aiorts.late import dataclass
from aiorts.model.wanted.entries import Wanted
from aiorts.system.file.places import Place, places_of


@dataclass(frozen=True, slots=True)
class Override:
    """`component.param=value` from a command line."""

    component: str
    param: str
    value: str

    @property
    def text(self) -> str:
        """As it was written."""
        return f"{self.component}.{self.param}={self.value}"


@dataclass(frozen=True, slots=True)
class SystemFile(Wanted):
    """A whole system, read and checked as far as that goes without loading any component.

    Which service brings a table is looked up when the system is prepared.
    """

    path: Path = Path()
    overrides: tuple[Override, ...] = ()
    text: str = field(default="", repr=False, compare=False)
    """What was read; "" for a system that was not made of a text."""

    def place(self, *key: str | int, of_key: bool = False) -> Place:
        """Where the value of a key stands in the text, or the key itself: `place("contexts", "loop", "rate")`."""
        places = places_of(self.text)
        return places.key(key) if of_key else places.value(key)

    def at(self, *key: str | int, of_key: bool = False) -> str:
        """The same as a message has it: "system.toml:7:3"."""
        if not self.text:
            return str(self.path)
        place = self.place(*key, of_key=of_key)
        return f"{self.path}:{place.line}:{place.column}"

    @property
    def folder(self) -> Path:
        """Where the system file lies; relative paths in it are counted from here."""
        return self.path.parent
