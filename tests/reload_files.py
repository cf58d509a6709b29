"""Component files that the tests of reloading write, import, edit and import anew."""

from __future__ import annotations

import importlib.util
import itertools
import sys
from pathlib import Path
from textwrap import dedent
from typing import Any

HEAD = """\
from __future__ import annotations

import asyncio
import aiorts
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble, TimedLong, Time
"""
READ: list[str] = []
"""Names of the modules that were run, of files that say so."""
_NUMBERS = itertools.count()


class Source:
    """One component file: `write` it anew, `get` a class as it was imported first."""

    def __init__(self, folder: Path, text: str) -> None:
        self.name = f"reloaded_{next(_NUMBERS)}"
        self.path = folder / f"{self.name}.py"
        self.write(text)
        spec = importlib.util.spec_from_file_location(self.name, self.path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[self.name] = module
        spec.loader.exec_module(module)

    def write(self, text: str) -> None:
        self.path.write_text(HEAD + dedent(text), encoding="utf-8")

    def replace(self, old: str, new: str) -> None:
        text = self.path.read_text(encoding="utf-8")
        assert old in text
        self.path.write_text(text.replace(old, new), encoding="utf-8")

    def get(self, name: str) -> Any:
        return getattr(sys.modules[self.name], name)

    def line_of(self, text: str) -> int:
        return 1 + self.path.read_text(encoding="utf-8").splitlines().index(text)

    def forget(self) -> None:
        sys.modules.pop(self.name, None)
