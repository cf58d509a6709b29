"""The guide's page about a plugin, each of its blocks run as its reader runs it."""

from __future__ import annotations

import asyncio
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import aiorts
from aiorts import Catalogue
from aiorts.errors import RecordError

PAGE = Path(aiorts.__file__).parent / "guide" / "pages" / "tutorial" / "plugin.md"
FILES = ("pyproject.toml", "acme_tanks.py", "test_tanks.py", "system.toml", "app.py")


class FastAPI:
    """Of FastAPI what the page uses, where it is not installed."""

    def __init__(self, lifespan: Callable[[Any], AbstractAsyncContextManager[None]]) -> None:
        self.state = SimpleNamespace()
        self.router = SimpleNamespace(lifespan_context=lifespan)

    def get(self, path: str) -> Callable[[Any], Any]:
        assert path == "/level"
        return lambda function: function


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The files of the page in a folder, which Python imports from."""
    blocks = [part.partition("\n")[2] for part in PAGE.read_text(encoding="utf-8").split("\n```")[1::2]]
    for name, text in zip(FILES, blocks, strict=True):
        (tmp_path / name).write_text(text + "\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    if importlib.util.find_spec("fastapi") is None:
        fastapi = ModuleType("fastapi")
        fastapi.FastAPI = FastAPI  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "fastapi", fastapi)
    yield tmp_path
    for name in FILES:
        sys.modules.pop(name.removesuffix(".py"), None)


def test_its_component_and_its_test_do_what_they_say(project: Path) -> None:
    importlib.import_module("test_tanks").test_a_higher_tank_is_less_full()
    catalogue = Catalogue([project])
    assert catalogue.find("components", "TankWatch").load().__name__ == "TankWatch"
    tank = catalogue.find("types", "TankLevel").load()
    with pytest.raises(RecordError, match="at most 3 levels, got 4"):
        tank(recent=[0.0] * 4)


def test_its_system_lives_as_long_as_the_web_application(project: Path) -> None:
    page = importlib.import_module("app")

    async def serve() -> dict[str, Any]:
        async with page.app.router.lifespan_context(page.app):
            kernel = page.app.state.kernel
            async with asyncio.timeout(10):
                while not kernel.components["watch"].last:
                    await asyncio.sleep(0.005)
            return dict(await page.level())

    assert asyncio.run(serve())["levels"][0] == 0.75
    assert page.app.state.kernel.closed
