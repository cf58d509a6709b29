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
