"""What plugins offer is found without importing; what is broken is named and hides nothing else."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from aiorts import Component, Kernel
from aiorts.errors import PluginError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.extensions.loading import load, load_aside
from aiorts.testing import simulated

GOOD = "from aiorts import Component\nclass Good(Component):\n    '''A component.'''\n"


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path, modules = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        if name.startswith(("plug_", "aiorts_system.")):
            del sys.modules[name]


def plugin(folder: Path, module: str, text: str, entries: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{module}.py").write_text(text)
    (folder / "pyproject.toml").write_text(
        f'[project]\nname = "{module}"\n[project.entry-points."aiorts.components"]\n{entries}'
    )
    return folder


def test_installed_packages_are_listed_without_importing_them() -> None:
    found = Catalogue().extensions("components")
    (flexi,) = found["FlexiFilter"]
    assert (flexi.kind, flexi.target) == ("components", "aiorts_flexi.mapping.filter:FlexiFilter")
    assert flexi.source.startswith("package aiorts ")


def test_a_folder_offers_what_its_pyproject_declares(tmp_path: Path) -> None:
    plugin(tmp_path, "plug_one", GOOD, 'Good = "plug_one:Good"\n')
    plugin(tmp_path / "below", "plug_two", GOOD, 'Two = "plug_two:Good"\n')
    catalogue = Catalogue([tmp_path])
    assert "plug_one" not in sys.modules
    assert catalogue.find("components", "Two").source == f"folder {tmp_path / 'below'}"
    assert issubclass(load(catalogue.find("components", "Two")), Component)
    assert "plug_one" not in sys.modules
    assert catalogue.problems == ()


def test_a_file_offers_the_components_its_text_defines(tmp_path: Path) -> None:
    (tmp_path / "odometry.py").write_text(
        "print('imported')\nimport aiorts\nclass Odometry(aiorts.Component): pass\nclass X: pass\n"
    )
    catalogue = Catalogue([tmp_path])
    assert catalogue.find("components", "Odometry").target == "odometry.py:Odometry"
    with pytest.raises(PluginError, match="no component named 'X'"):
        catalogue.find("components", "X")


@pytest.mark.fault("F04")
def test_an_unknown_name_gets_near_ones() -> None:
    with pytest.raises(PluginError, match="no component named 'FlexFilter'; did you mean FlexiFilter"):
        Catalogue().find("components", "FlexFilter")


@pytest.mark.fault("F05")
def test_a_name_offered_twice_names_both_sources(tmp_path: Path) -> None:
    for name in ("a", "b"):
        plugin(tmp_path / name, f"plug_{name}", GOOD, f'Same = "plug_{name}:Good"\n')
    with pytest.raises(PluginError, match=r"twice, by plug_a:Good \(folder .*a\) and plug_b:Good \(folder .*b\)"):
        Catalogue([tmp_path]).find("components", "Same")


@pytest.mark.fault("F05")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("def broken(:", "SyntaxError"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("AIORTS_API = 99\n" + GOOD, "written for version 99 of the plugin interface, this is 1"),
        ("x = 1", "there is no 'Good'; it has no class"),
    ],
)
def test_a_broken_plugin_is_named_and_the_others_work(tmp_path: Path, text: str, message: str) -> None:
    plugin(tmp_path / "bad", "plug_bad", text, 'Bad = "plug_bad:Good"\n')
    plugin(tmp_path / "good", "plug_good", GOOD, 'Good = "plug_good:Good"\n')
    catalogue = Catalogue([tmp_path])
    with pytest.raises(PluginError, match=message) as raised:
        load(catalogue.find("components", "Bad"))
    assert f"component 'Bad' of folder {tmp_path / 'bad'} (plug_bad:Good)" in str(raised.value)
    assert issubclass(load(catalogue.find("components", "Good")), Component)


@pytest.mark.fault("F05")
@pytest.mark.parametrize(
    "text", ["[project", "project = 3", '[project.entry-points]\n"aiorts.components" = 5', "\xff" * 3]
)
def test_a_broken_pyproject_is_a_problem_and_hides_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "pyproject.toml").write_bytes(text.encode("latin-1"))
    (tmp_path / "half.py").write_text("class Broken(Component:\n")
    plugin(tmp_path / "good", "plug_good", GOOD, 'Good = "plug_good:Good"\n')
    catalogue = Catalogue([tmp_path])
    assert catalogue.find("components", "Good").source == f"folder {tmp_path / 'good'}"
    assert len(catalogue.problems) == 2
    assert any("half.py:1" in problem.source for problem in catalogue.problems)


def test_a_folder_that_is_not_there_is_a_problem(tmp_path: Path) -> None:
    catalogue = Catalogue([tmp_path / "none"])
    assert "FlexiDump" in catalogue.extensions("components")
    assert "No such file" in catalogue.problems[0].reason


def test_a_module_that_comes_from_elsewhere_is_not_taken_for_the_plugins(tmp_path: Path) -> None:
    plugin(tmp_path, "json", GOOD, 'Good = "json:Good"\n')
    with pytest.raises(PluginError, match=r"its module 'json' comes from .*; rename"):
        load(Catalogue([tmp_path]).find("components", "Good"))


@pytest.mark.fault("F05")
def test_an_import_that_never_ends_is_left_behind_and_the_loop_goes_on(tmp_path: Path) -> None:
    stop = threading.Event()
    sys.modules["plug_stop"] = stop  # type: ignore[assignment]
    plugin(tmp_path, "plug_slow", "import plug_stop\nplug_stop.wait()\n", 'Slow = "plug_slow:Good"\n')
    extension = Catalogue([tmp_path]).find("components", "Slow")

    async def main() -> int:
        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0.001)

        counting = asyncio.ensure_future(count())
        async with Kernel() as kernel:
            with pytest.raises(PluginError, match=r"still being imported after 0.2 s; it was abandoned"):
                await load_aside(extension, kernel.clock, Component, limit=0.2)
        counting.cancel()
        return turns

    try:
        assert asyncio.run(main()) > 20
    finally:
        stop.set()


@simulated
async def test_time_stands_still_while_a_plugin_is_imported() -> None:
    async with Kernel() as kernel:
        before = kernel.clock.monotonic_ns()
        component = await kernel.create("FlexiDump", inputs=("TimedLong",))
        assert kernel.clock.monotonic_ns() == before
        assert component.name == "flexidump0"


def test_an_extension_that_is_no_component_is_refused(tmp_path: Path) -> None:
    plugin(tmp_path, "plug_odd", "Good = 5\n", 'Odd = "plug_odd:Good"\n')

    async def main() -> None:
        async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
            with pytest.raises(PluginError, match="an object of int is no class derived from Component"):
                await kernel.create("Odd")

    asyncio.run(main())


@pytest.mark.slow
def test_two_components_of_one_file_created_together_find_it_whole(tmp_path: Path) -> None:
    text = "import time\nfrom aiorts import Component\nclass Aa(Component): pass\n"
    (tmp_path / "plug_two.py").write_text(f"{text}time.sleep(0.2)\nclass Bb(Component): pass\n")

    async def main() -> list[str]:
        async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
            return [component.name for component in await asyncio.gather(kernel.create("Aa"), kernel.create("Bb"))]

    assert sorted(asyncio.run(main())) == ["aa0", "bb0"]


def test_an_error_without_a_text_of_its_own_is_told_at_once(tmp_path: Path) -> None:
    text = "class Odd(Exception):\n    def __str__(self): raise ValueError\nraise Odd\n"
    plugin(tmp_path, "plug_mute", text, 'Mute = "plug_mute:Good"\n')
    with pytest.raises(PluginError, match=r"Odd: \(its text cannot be had\)"):
        load(Catalogue([tmp_path]).find("components", "Mute"))
