"""The contents of a system file after parsing, with the places of keys, and the overrides of a command line."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

from aiorts.late import dataclass
from aiorts.model.names import names_kernel, split_path
from aiorts.model.wanted.entries import Wanted
from aiorts.system.text.origins import Origins, Source
from aiorts.system.text.places import Key
from aiorts.system.text.reading import Mistake


@dataclass(frozen=True, slots=True)
class Override:
    """`component.param=value` from a command line."""

    component: str
    param: str
    value: str

    @property
    def text(self) -> str:
        """The override as it was written."""
        return f"{self.component}.{self.param}={self.value}"


@dataclass(frozen=True, slots=True)
class SystemFile(Wanted):
    """A whole system, read and checked as far as possible without loading any component.

    A service is looked up by the name of its table when the system is prepared.
    """

    path: Path = Path()
    overrides: tuple[Override, ...] = ()
    text: str = field(default="", repr=False, compare=False)
    """The whole system as one text; "" for a system that was not made of a text."""
    origins: Origins = field(default_factory=lambda: Origins(Source(Path(), "")), repr=False, compare=False)
    """The places of its keys."""

    def at(self, *key: str | int, of_key: bool = False) -> str:
        """The place of a key's value, or of the key itself, in the form for messages: "system.toml:7:3"."""
        return str(self.origins.spot(key, of_key=of_key)) if self.text else str(self.path)

    notes: tuple[Mistake, ...] = field(default=(), repr=False, compare=False)
    """Remarks about the file that are no mistakes."""

    def is_elsewhere(self, port: str) -> bool:
        """Whether a port, given by its path, is in another process than this one when the system runs."""
        if names_kernel(port):
            return True
        component = self.components.get(split_path(port)[2])
        return component is not None and bool(component.isolation) and self.clock.kind != "simulated"

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the system: the one that was named first, then those that it includes."""
        return tuple(source.path for source in self.origins.sources()) if self.text else (self.path,)

    @property
    def folder(self) -> Path:
        """The folder of the system file, from which relative paths in it are taken."""
        return self.path.parent

    def folder_of(self, key: Key) -> Path:
        """The folder of the file that has this key."""
        return self.origins.of(key).source.path.parent if self.text else self.folder

    def folders(self, key: Key) -> tuple[Path, ...]:
        """The folders with plugins; those of the file that has this key come first."""
        own = self.folder_of(key)
        if own == self.folder:
            return self.plugin_paths
        own = own.resolve()
        return tuple(sorted(self.plugin_paths, key=lambda folder: not folder.is_relative_to(own)))
