"""A type as text: FILE.py:Class, package.module:Class or a name that a plugin offers; it is one class in any way."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, Kernel
from aiorts.errors import AbsentError, AiortsError, PluginError, SystemFileError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.extensions.type_names import extension_of, split_type
from aiorts.system import load, prepare
from aiorts.testing import simulated
from plugin_dists import install, project
from run_parts import here

PART = "from aiorts import Component\nfrom {} import N\nclass Part(Component):\n    n = N\n"


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path, modules = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        if name.startswith(("tnm_", "aiorts_system.")):
            del sys.modules[name]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package `tnm_pack` with modules that need each other, and two files by themselves that do."""
    package = tmp_path / "tnm_pack"
    package.mkdir()
    (package / "__init__.py").write_text("from .part import Part as Part\n")
    (package / "numbers.py").write_text("N = 5\n")
    (package / "part.py").write_text(PART.format(".numbers"))
    (tmp_path / "tnm_alone.py").write_text(PART.format("tnm_beside"))
    (tmp_path / "tnm_beside.py").write_text("class N:\n    pass\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def found(text: str, catalogue: Catalogue | None = None) -> type[Component]:
    return extension_of(text, catalogue or Catalogue()).load_class(Component)


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("home", ["tnm_pack/part.py", "tnm_alone.py"])
def test_by_path_and_by_module_it_is_one_class_whatever_comes_first(folder: Path, home: str, turn: int) -> None:
    module = home.removesuffix(".py").replace("/", ".")
    ways = [f"{home}:Part", f"{folder / home}:Part", f"./{home}:Part", f"{module}:Part"][::turn]
    assert len({found(way) for way in ways}) == 1
    if home != "tnm_alone.py":
        assert found("tnm_pack:Part") is found(ways[0])
        assert sys.modules["tnm_pack.part"].Part is found(ways[0])


def test_files_of_one_name_in_two_folders_are_two_and_take_what_lies_beside_them(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tnm_same.py").write_text(PART.format(f"tnm_of_{name}"))
        (tmp_path / name / f"tnm_of_{name}.py").write_text(f"N = {name!r}\n")
    one, two = (found(f"{tmp_path / name / 'tnm_same.py'}:Part") for name in ("one", "two"))
    assert (vars(one)["n"], vars(two)["n"]) == ("one", "two")


def test_a_module_of_another_folder_is_not_taken_for_one_beside_it(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tnm_same.py").write_text(PART.format("tnm_own"))
        (tmp_path / name / "tnm_own.py").write_text("class N:\n    pass\n")
    found(f"{tmp_path / 'one' / 'tnm_same.py'}:Part")
    with pytest.raises(PluginError, match=f"'tnm_own' comes from {tmp_path}/one/tnm_own.py, loaded before"):
        found(f"{tmp_path / 'two' / 'tnm_same.py'}:Part")


def test_in_a_system_file_all_forms_are_one_and_counted_from_its_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forms = ["tnm_pack/part.py:Part", "tnm_pack.part:Part", "tnm_pack:Part", "Part"]
    (folder / "pyproject.toml").write_text(
        '[project]\nname = "tnm"\n[project.entry-points."aiorts.components"]\nPart = "tnm_pack:Part"\n'
    )
    text = "".join(f'[components.c{number}]\ntype = "{form}"\n' for number, form in enumerate(forms))
    (folder / "system.toml").write_text(f"schema = 1\n{text}")
    monkeypatch.chdir("/")
    assert len(set(prepare(load(folder / "system.toml")).types.values())) == 1


@simulated
async def test_a_kernel_creates_and_reloads_by_text(folder: Path) -> None:
    async with Kernel() as kernel:
        first = await kernel.create("tnm_alone.py:Part")
        second = await kernel.create("tnm_alone:Part", "named")
        assert (first.name, second.name, type(first)) == ("part0", "named", type(second))
        with pytest.raises(PluginError, match="did you mean 'Part'"):
            await kernel.create("tnm_alone.py:Patr")
        with pytest.raises(AbsentError, match="did you mean 'Part'"):
            await kernel.reload("Patr", cycles=0)
        with pytest.raises(PluginError, match="expected FILE"):
            await kernel.reload("tnm alone:Part", cycles=0)
        for text in ("tnm_alone.py:Part", "tnm_alone:Part"):
            await kernel.reload(text, cycles=0)


@pytest.mark.fault("F04")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tnm_alone.py:Prat", "tnm_alone.py:Prat: there is no 'Prat'; did you mean 'Part'?"),
        ("tnm_pack.part:Prat", "tnm_pack.part:Prat: there is no 'Prat'; did you mean 'Part'?"),
        ("tnm_alnoe.py:Part", "no file 'tnm_alnoe.py' in {}; did you mean 'tnm_alone.py:Part'?"),
        ("tnm_pakc.part:Part", "no module named 'tnm_pakc'; did you mean tnm_pack.part?"),
        ("tnm_pack.prat:Part", "no module named 'tnm_pack.prat'; did you mean tnm_pack.part?"),
        ("tnm_alone.py:", "which class? write tnm_alone.py:Part; it has Part"),
        ("tnm_alone.py", "which class? write tnm_alone.py:Part; it has Part"),
        ("tnm_beside.py:N.no.more", "tnm_beside.py:N.no.more: there is no 'no'; it has no class"),
        ("tnm_beside.py:N", "tnm_beside.py:N: N is no class derived from Component"),
        ("aiorts:Component", "aiorts:Component: Component itself does nothing; name a class derived from it"),
        ("FlexiDmp", "no component named 'FlexiDmp'; did you mean FlexiDump"),
        ("tnm alone:Part", "expected FILE.py:Class, package.module:Class or an installed name"),
        ("a:b:c", "expected FILE.py:Class, package.module:Class or an installed name"),
        ("tnm\0.py:Part", "no file"),
    ],
)
def test_mistakes_are_the_same_everywhere(folder: Path, text: str, said: str) -> None:
    said = said.format(folder)
    with pytest.raises(PluginError) as caught:
        found(text)
    assert said in str(caught.value)
    if "\0" in text:
        return
    (folder / "system.toml").write_text(f'schema = 1\n[components.it]\ntype = "{text}"\n')
    with pytest.raises(PluginError) as caught:
        prepare(load(folder / "system.toml"))
    assert said in str(caught.value)
    if ":" in text or text.endswith(".py"):
        assert said in here(folder, text).stderr
    if ":" in text:
        done = here(folder, "run", text)
        assert (done.returncode, done.stdout) == (2, "")
        assert said in done.stderr
        if text not in ("tnm_beside.py:N", "aiorts:Component"):  # which can be looked at
            assert said in here(folder, "inspect", text).stderr


def test_a_system_file_takes_no_file_from_elsewhere(folder: Path) -> None:
    below = folder / "below"
    below.mkdir()
    for text in ("../tnm_alone.py:Part", f"{folder}/tnm_alone.py:Part"):
        (below / "system.toml").write_text(f'schema = 1\n[components.it]\ntype = "{text}"\n')
        with pytest.raises(SystemFileError, match="outside the system file's folder"):
            prepare(load(below / "system.toml"))


@pytest.mark.fault("F05")
def test_what_is_installed_and_reached_by_path_is_one_offer(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(folder, "tnm-pack", {}, {"components/Part": "tnm_pack:Part"})
    monkeypatch.syspath_prepend(str(folder))
    catalogue = Catalogue([folder / "tnm_pack", folder])
    (offer,) = catalogue.extensions("components")["Part"][:1]
    assert offer.source == "package tnm-pack 1.0"
    other = catalogue.extensions("components")["Part"][1:]
    assert [one.target for one in other] == ["tnm_alone.py:Part"]  # which is another class
    with pytest.raises(PluginError, match=r"offered twice, by tnm_pack:Part .* and tnm_alone.py:Part"):
        catalogue.find("components", "Part")
    # What may be written in place of the name needs nothing removed.
    with pytest.raises(PluginError, match=r'or write "(.*)" or "(.*)" in place of the name') as caught:
        catalogue.find("components", "Part")
    texts = re.findall(r'"(.*?)"', str(caught.value))
    assert len({found(text, catalogue) for text in texts}) == 2
    assert found("Part", Catalogue([folder / "tnm_pack"])) is found("tnm_pack/part.py:Part")


def test_two_projects_that_offer_one_module_are_one_offer(folder: Path) -> None:
    text = {"components/Part": "tnm_pack.part:Part"}
    project(folder, "tnm-one", {}, text)
    (folder / "pyproject.toml").rename(folder / "first.toml")
    install(folder, "tnm-two", {}, text)
    (folder / "first.toml").rename(folder / "pyproject.toml")
    sys.path.append(str(folder))
    assert len(Catalogue([folder]).extensions("components")["Part"]) == 1


@settings(max_examples=40)
@given(st.text("ab.:/ py\0é-", max_size=30))
def test_any_text_is_of_one_form_or_refused(text: str) -> None:
    try:
        home, name = split_type(text)
    except AiortsError:
        assert ":" in text
    else:
        assert not home or home.endswith(".py") or all(part.isidentifier() for part in home.split("."))
        assert ":" not in name
