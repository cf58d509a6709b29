"""What tests of the files that clients may name are made of: ways to name one, and places where it lies."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

from aiorts import Component, Goal, Provided
from aiorts.model.wanted.carried import carried
from aiorts.model.wanted.entries import ComponentEntry, Wanted

SECRET: Final = "do not overwrite, do not show"
Call = tuple[str, dict[str, Any]]
"""An operation, and its arguments."""


class Filing(Protocol):
    async def file(self, path: Path) -> str: ...
    async def files(self, paths: list[Path]) -> str: ...
    async def keep(self, path: Path) -> Goal[int, str]: ...


class Keeper(Component):
    """Writes the files that it is told to write."""

    filing = Provided[Filing]()

    async def file(self, path: Path) -> str:
        path.write_text("kept")
        return "kept"

    async def files(self, paths: list[Path]) -> str:
        for path in paths:
            path.write_text("kept")
        return "kept"

    async def keep(self, path: Path) -> Goal[int, str]:
        path.write_text("kept")
        goal: Goal[int, str] = Goal()
        goal.succeed("kept")
        return goal


def _logging(path: str, **more: Any) -> dict[str, Any]:
    return {"logfile": path, "existing": "overwrite", "text": True, "inputs": ["TimedDouble"], **more}


def _document(path: str) -> str:
    return (
        'schema = 1\n[components.log]\nactive = "default"\n[components.log.sets.default]\n'
        f"logfile = {json.dumps(path)}\n" + 'inputs = ["TimedDouble"]\n'
    )


def _wanted(**components: dict[str, Any]) -> list[str]:
    entries = {name: ComponentEntry(name, "FlexiLogger", params) for name, params in components.items()}
    return [carried(Wanted(entries))]


def _kept(home: Path) -> dict[str, Any]:
    return {"logfile": home / "own.mcap", "inputs": ("TimedDouble",)}


WAYS: Final[Mapping[str, Callable[[str, Path], Call]]] = {
    "create": lambda path, _: ("create", {"type": "FlexiLogger", "name": "new", "params": _logging(path)}),
    "create to replay": lambda path, _: (
        "create",
        {"type": "FlexiLogger", "name": "new", "params": {"logfile": path, "mode": "replay"}},
    ),
    "configure": lambda path, _: ("configure", {"component": "log", "values": {"": {"logfile": path}}}),
    "add a set": lambda path, _: (
        "configure",
        {"component": "log", "add": ["more"], "values": {"more": {"logfile": path}}, "activate": "more"},
    ),
    "load": lambda path, _: ("load_configuration", {"parts": [_document(path)]}),
    "apply, created": lambda path, home: (
        "apply",
        {"wanted": _wanted(log=_kept(home), new=_logging(path, inputs=("TimedDouble",)))},
    ),
    "apply, configured": lambda path, home: (
        "apply",
        {"wanted": _wanted(log={**_kept(home), "logfile": path})},
    ),
    "change": lambda path, home: ("change", {"wanted": _wanted(log={**_kept(home), "logfile": path})}),
    "call": lambda path, _: ("call", {"path": "keeper.filing.file", "args": [path]}),
    "call, in a list": lambda path, _: ("call", {"path": "keeper.filing.files", "kwargs": {"paths": [path]}}),
    "goal": lambda path, _: ("goal", {"path": "keeper.filing.keep", "args": [path]}),
}
"""By name: the operation and its arguments, for a path and the folder of the run."""

PLACES: Final[Mapping[str, tuple[str, bool]]] = {
    "below": ("allowed/new.txt", True),
    "deeper": ("allowed/deep/new.txt", True),
    "by dots inside": ("allowed/deep/../new.txt", True),
    "by a link inside": ("allowed/inside/new.txt", True),
    "outside": ("secret.txt", False),
    "by dots": ("allowed/../secret.txt", False),
    "by a link": ("allowed/link.txt", False),
    "by a link of a folder": ("allowed/out/secret.txt", False),
    "by its name's beginning": ("allowed-not/new.txt", False),
    "a device": ("/dev/shm/aiorts-never", False),
}
"""By name: the path from the folder of the run, and whether it may be named with `--files allowed`."""


def made(home: Path) -> Path:
    """The folder that may be named, with what tries to lead out of it."""
    for name in ("allowed/deep", "allowed-not"):
        (home / name).mkdir(parents=True)
    (home / "secret.txt").write_text(SECRET)
    (home / "allowed/inside").symlink_to(home / "allowed/deep")
    (home / "allowed/link.txt").symlink_to(home / "secret.txt")
    (home / "allowed/out").symlink_to(home)
    return home / "allowed"
