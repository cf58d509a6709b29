"""The catalogue under attack: odd names, damaged metadata, folders that vanish, many offers; every fault is named."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component
from aiorts.errors import PluginError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.extensions.loading import load
from plugin_dists import COMPONENT, install, project
from run_parts import here

pytestmark = pytest.mark.fault("F05")


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path, modules = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    sys.path_importer_cache.clear()
    for name in set(sys.modules) - modules:
        if name.startswith(("plug_", "aiorts_system.")):
            del sys.modules[name]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    folder = tmp_path / "site"
    folder.mkdir()
    sys.path.insert(0, str(folder))
    return folder


def names(catalogue: Catalogue) -> set[str]:
    return set(catalogue.extensions("components"))


# -- what is installed -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("entry_points.txt", b"\xff\xfe\x00"),
        ("entry_points.txt", b"[aiorts.components]\nno equals sign\n"),
        ("METADATA", b"Version: 1.0\n"),
        ("METADATA", b"\xff"),
    ],
)
def test_a_distribution_with_damaged_metadata_hides_no_other(site: Path, file: str, content: bytes) -> None:
    install(site, "plug-bad", {"plug_bad": COMPONENT}, {"components/Bad": "plug_bad:Good"})
    install(site, "plug-good", {"plug_good": COMPONENT}, {"components/Good": "plug_good:Good"})
    (site / "plug_bad-1.0.dist-info" / file).write_bytes(content)
    catalogue = Catalogue()
    assert {"Good", "FlexiDump"} <= names(catalogue)
    if "Bad" not in names(catalogue):
        assert [problem for problem in catalogue.problems if "plug_bad-1.0.dist-info" in problem.source]


def test_of_two_versions_the_one_that_is_imported_is_listed(site: Path, tmp_path: Path) -> None:
    install(site, "plug-two", {"plug_two": COMPONENT}, {"components/Two": "plug_two:Good"}, version="2.0")
    behind = tmp_path / "behind"
    install(behind, "Plug.Two", {"plug_two": "raise SystemExit"}, {"components/Two": "plug_two:Good"})
    sys.path.append(str(behind))
    found = Catalogue().find("components", "Two")
    assert found.source == "package plug-two 2.0"
    assert issubclass(load(found), Component)


def test_an_unknown_kind_is_a_problem_with_a_near_one(site: Path) -> None:
    install(site, "plug-kind", {}, {"component/Odd": "plug_kind:Odd"})
    (problem,) = Catalogue().problems
    assert problem.source == "package plug-kind 1.0"
    assert "'aiorts.component': no such kind of plugin; did you mean aiorts.components?" in problem.reason


@pytest.mark.slow(kept_by="extensions/test_loading.py::test_a_folder_offers_what_its_pyproject_declares")
def test_a_plugin_in_a_zip_file_is_one(tmp_path: Path) -> None:
    install(tmp_path / "in", "plug-zip", {"plug_zip": COMPONENT}, {"components/Zipped": "plug_zip:Good"})
    with zipfile.ZipFile(tmp_path / "plug.zip", "w") as archive:
        for path in (tmp_path / "in").rglob("*"):
            archive.write(path, path.relative_to(tmp_path / "in"))
    code = "from aiorts import Catalogue; print(Catalogue().find('components', 'Zipped').load().__qualname__)"
    # In a process of its own: the importing of Python keeps the archive open.
    path = os.pathsep.join(filter(None, (str(tmp_path / "plug.zip"), os.environ.get("PYTHONPATH", ""))))
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.stdout, done.stderr) == ("Good\n", "")


def test_a_zip_file_as_a_folder_is_a_problem(tmp_path: Path) -> None:
    (tmp_path / "plug.zip").write_bytes(b"PK")
    (problem,) = Catalogue([tmp_path / "plug.zip"]).problems
    assert problem.reason == "Not a directory"


def test_a_project_that_is_installed_for_editing_and_named_as_a_folder_is_one(site: Path, tmp_path: Path) -> None:
    folder = project(tmp_path / "edit", "plug_edit", {"plug_edit": COMPONENT}, {"components/Edit": "plug_edit:Good"})
    install(site, "plug-edit", {}, {"components/Edit": "plug_edit:Good"})
    sys.path.append(str(folder))  # what the .pth file of an editable install does
    found = Catalogue([folder]).find("components", "Edit")
    assert found.source == "package plug-edit 1.0"
    assert issubclass(load(found), Component)


@pytest.mark.slow
def test_ten_thousand_entry_points_are_listed_in_a_moment(site: Path) -> None:
    entries = {f"components/Part{number}": "plug_many:Good" for number in range(10_000)}
    install(site, "plug-many", {"plug_many": COMPONENT}, entries)
    catalogue = Catalogue()
    began = time.perf_counter()
    assert len(names(catalogue)) > 10_000
    assert time.perf_counter() - began < 5.0  # 0.1 s on an idle machine
    with pytest.raises(PluginError) as raised:
        catalogue.find("components", "Part10001x")
    assert len(str(raised.value)) < 200
    with pytest.raises(PluginError) as raised:
        catalogue.find("components", "?")
    assert len(str(raised.value)) < 2000


# -- folders -----------------------------------------------------------------------------------------------------------


def test_a_folder_that_goes_between_listing_and_loading_is_an_error_of_the_plugin(tmp_path: Path) -> None:
    folder = project(tmp_path / "gone", "plug_gone", {"plug_gone": COMPONENT}, {"components/Gone": "plug_gone:Good"})
    (tmp_path / "single").mkdir()
    (tmp_path / "single" / "plug_file.py").write_text(COMPONENT)
    catalogue = Catalogue([folder, tmp_path / "single"])
    gone, single = catalogue.find("components", "Gone"), catalogue.find("components", "Good")
    (folder / "plug_gone.py").unlink()
    (folder / "pyproject.toml").unlink()
    folder.rmdir()
    (tmp_path / "single" / "plug_file.py").unlink()
    with pytest.raises(PluginError, match=r"component 'Gone' of folder .*gone \(plug_gone:Good\) cannot be loaded"):
        load(gone)
    with pytest.raises(PluginError, match="FileNotFoundError"):
        load(single)


@pytest.mark.skipif(os.name != "posix", reason="links need no rights there alone")
def test_links_that_lead_nowhere_or_round_in_a_circle_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    (tmp_path / "self").symlink_to(tmp_path)
    (tmp_path / "nowhere").symlink_to(tmp_path / "none")
    (tmp_path / "loop.py").symlink_to(tmp_path / "loop.py")
    (tmp_path / "part.py").write_text(COMPONENT)
    assert "Good" in names(Catalogue([tmp_path]))
    assert Catalogue([tmp_path / "circle"]).problems
    assert len(Catalogue([tmp_path, tmp_path / "self"]).extensions("components")["Good"]) == 1


@pytest.fixture
def nobodys() -> Iterator[Path]:
    """A folder of somebody who is not root, as whom the test runs: root may read everything."""
    with tempfile.TemporaryDirectory() as name:
        user = os.geteuid()
        if user == 0:
            os.chown(name, 65534, -1)
            os.seteuid(65534)
        try:
            yield Path(name)
        finally:
            os.seteuid(user)


@pytest.mark.skipif(os.name != "posix", reason="modes of files are POSIX")
def test_what_may_not_be_read_is_a_problem_and_the_rest_is_there(nobodys: Path) -> None:
    (nobodys / "part.py").write_text(COMPONENT)
    (nobodys / "secret.py").write_text(COMPONENT)
    (nobodys / "closed").mkdir()
    for name in ("secret.py", "closed"):
        (nobodys / name).chmod(0)
    catalogue = Catalogue([nobodys, nobodys / "closed"])
    assert [offer.target for offer in catalogue.extensions("components")["Good"]] == ["part.py:Good"]
    assert {problem.reason for problem in catalogue.problems} == {"Permission denied"}
    assert {problem.source.partition(" ")[0] for problem in catalogue.problems} == {"file", "folder"}
    (nobodys / "closed").chmod(0o700)


def test_two_folders_with_one_project_each_are_two(tmp_path: Path) -> None:
    folders = [
        project(tmp_path / name, "plug_same", {"plug_same": COMPONENT}, {"components/Same": "plug_same:Good"})
        for name in ("a", "b")
    ]
    with pytest.raises(PluginError, match=r"offered twice, by .*a\) and .*b\)"):
        Catalogue(folders).find("components", "Same")
    assert Catalogue([folders[0], tmp_path / "a", folders[0]]).find("components", "Same").folder == folders[0]


def test_a_target_outside_its_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "outside.py").write_text(COMPONENT)
    folder = project(tmp_path / "in", "plug_in", {}, {"components/Out": "../outside.py:Good"})
    with pytest.raises(PluginError, match=r"'\.\./outside\.py' is outside its folder"):
        load(Catalogue([folder]).find("components", "Out"))


def test_a_class_derived_from_one_of_the_same_file_is_offered(tmp_path: Path) -> None:
    (tmp_path / "two.py").write_text(COMPONENT + "class Better(Good): pass\nclass Other(dict): pass\n")
    assert {"Good", "Better"} <= names(Catalogue([tmp_path]))
    assert "Other" not in names(Catalogue([tmp_path]))


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbf" + COMPONENT.encode(),
        b"# -*- coding: latin-1 -*-\n# \xe4\n" + COMPONENT.encode(),
        b"x = '\\d'\n" + COMPONENT.encode(),
    ],
    ids=["with a byte order mark", "in latin-1", "with an escape that python warns of"],
)
def test_a_file_is_read_as_python_reads_it(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "part.py").write_bytes(text)
    catalogue = Catalogue([tmp_path])
    assert "Good" in names(catalogue)
    assert catalogue.problems == ()


@pytest.mark.parametrize(
    "text", [b"\0", b"(" * 5000, b"-" * 200_000, b"x = " + b"[" * 3000, b"\xff", b"x" * (1 << 20) + b"y"]
)
def test_a_file_that_is_no_python_is_a_problem(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "odd.py").write_bytes(text)
    (tmp_path / "part.py").write_text(COMPONENT)
    catalogue = Catalogue([tmp_path])
    assert "Good" in names(catalogue)
    assert [problem.source.removesuffix(":1") for problem in catalogue.problems] == [f"file {tmp_path / 'odd.py'}"]


def test_a_thousand_other_files_hide_nothing(tmp_path: Path) -> None:
    for number in range(1100):
        (tmp_path / f"a{number}.txt").touch()
    (tmp_path / "part.py").write_text(COMPONENT)
    assert "Good" in names(Catalogue([tmp_path]))


@pytest.mark.slow(kept_by="test_an_unknown_kind_is_a_problem_with_a_near_one")
@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.text(min_size=1, max_size=8), st.text(max_size=12), max_size=4))
def test_any_name_and_target_is_listed_as_it_is_and_loads_or_is_a_plugin_error(entries: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = [f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in entries.items()]
        text = '[project]\n[project.entry-points."aiorts.components"]\n' + "".join(lines)
        (folder / "pyproject.toml").write_text(text, encoding="utf-8", errors="replace")
        catalogue = Catalogue([folder])
        listed = names(catalogue)
        if not catalogue.problems:
            assert set(entries) <= listed
        for key in listed - {
            "FlexiAdd",
            "FlexiConst",
            "FlexiDump",
            "FlexiDupe",
            "FlexiFilter",
            "FlexiLogger",
            "FlexiSelect",
        }:
            with pytest.raises(PluginError):
                load_class_of(catalogue, key)


def load_class_of(catalogue: Catalogue, key: str) -> type[Component]:
    """Nothing that can be imported by chance is a component."""
    return catalogue.find("components", key).load_class(Component)


@pytest.mark.slow
def test_what_a_project_names_and_is_not_installed_is_told_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = project(tmp_path / "kit", "ucat-kit", {}, {"components/Horn": "ucat:Horn", "types/Blast": "ucat:Blast"})
    (folder / "src").mkdir()
    for place, file, where in ((folder, "pyproject.toml", "."), (folder / "src", "../pyproject.toml", "..")):
        monkeypatch.chdir(place)
        said = f"{file} names it: pip install -e {where} again"
        for command in (["inspect", "Horn"], ["inspect", "Blast"], ["run", "Horn"], ["horn"]):
            done = here(place, *command)
            assert (done.returncode, said in done.stderr) == (6 if command[0] == "inspect" else 2, True), done.stderr
        with pytest.raises(PluginError, match=re.escape(f"no component named 'Horn'; {said}")):
            Catalogue().find("components", "Horn")
    for name in ("Horns", "Blast"):
        with pytest.raises(PluginError, match=f"no component named '{name}'; there are"):
            Catalogue().find("components", name)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PluginError, match="no component named 'Horn'; there are"):
        Catalogue().find("components", "Horn")
