"""What the tests of system files share: a folder with component files in which they write theirs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from system_parts import PARTS

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a system file beside the components of `system_parts.PARTS`."""

    def write(text: str, name: str = "system.toml") -> Path:
        (tmp_path / "parts.py").write_text(PARTS)
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture
def put(write: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """Write several files; answers with the first."""

    def put(**files: str) -> Path:
        for name, text in files.items():
            path = tmp_path / f"{name.replace('__', '/')}.toml"
            path.parent.mkdir(exist_ok=True)
            write(text if text.startswith("schema") else f"schema = 1\n{text}", str(path.relative_to(tmp_path)))
        return tmp_path / f"{next(iter(files))}.toml"

    return put
