"""What the tests of reloading get: a maker of component files, which are forgotten at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from reload_files import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@pytest.fixture
def source(tmp_path: Path) -> Iterator[Callable[[str], Source]]:
    made: list[Source] = []

    def make(text: str) -> Source:
        made.append(Source(tmp_path, text))
        return made[-1]

    yield make
    for one in made:
        one.forget()
