"""What a release holds: the source distribution and its wheel are complete, the same and clean, and install offline."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tarfile
import tomllib
import zipfile
from email.message import Message
from email.parser import Parser
from importlib.metadata import distribution
from pathlib import Path

import pytest
from test_layers import ROOT
from test_wheel import run

import aiorts
from aiorts.guide.contents import FOLDER
from aiorts.system.file.parse import SCHEMA
from aiorts_log.mcap.source import MAJOR, MINOR

CHANGELOG = ROOT / "CHANGELOG.md"
FILES = (
    *("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "noxfile.py", "pyproject.toml"),
    *(".ci/run", ".gitignore", ".pre-commit-config.yaml"),
)
FOLDERS = ("aiorts", "plugins", "tests", "examples")
CACHES = ("__pycache__/old.cpython-311.pyc", ".mypy_cache/old.json", ".hypothesis/old", ".pytest_cache/old")
OF_OTHERS = ("imu.txt", "NOTICE")
"""The recording in `examples/roomba` and what says that it is not covered by the licence of aiorts."""


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources with what tools leave in it."""
    copy = tmp_path_factory.mktemp("release") / "sources"
    (copy / ".ci").mkdir(parents=True)
    for name in FILES:
        shutil.copy(ROOT / name, copy / name)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    for place in (copy, *(copy / folder for folder in (*FOLDERS, "aiorts/guide/pages", "plugins/aiorts_log"))):
        for cache in CACHES:
            (place / cache).parent.mkdir()
            (place / cache).touch()
    return copy


@pytest.fixture(scope="module")
def sdist(sources: Path) -> Path:
    pytest.importorskip("hatchling")
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", sources.parent, cwd=sources)
    (built,) = sources.parent.glob("*.tar.gz")
    return built


@pytest.fixture(scope="module")
def unpacked(sdist: Path) -> Path:
    with tarfile.open(sdist) as archive:
        archive.extractall(sdist.parent, filter="data")
    return sdist.parent / sdist.name.removesuffix(".tar.gz")


@pytest.fixture(scope="module")
def wheel(unpacked: Path) -> Path:
    """The wheel that is made of the source distribution."""
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", unpacked.parent, cwd=unpacked)
    (built,) = unpacked.parent.glob("*.whl")
    return built


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return Parser().parsestr(archive.read(name).decode())


def contents(wheel: Path) -> dict[str, int]:
    with zipfile.ZipFile(wheel) as archive:
        return {entry.filename: entry.CRC for entry in archive.infolist()}


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_the_source_distribution_makes_the_wheel_that_the_sources_make(
    wheel: Path, sources: Path, tmp_path: Path
) -> None:
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=sources)
    (built,) = tmp_path.glob("*.whl")
    assert contents(built) == contents(wheel)


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_the_source_distribution_has_every_source_and_no_cache(sources: Path, unpacked: Path) -> None:
    def files(folder: Path) -> set[str]:
        return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}

    caches = {name for name in files(sources) if name.endswith(CACHES)}
    assert len(caches) == (1 + len(FOLDERS) + 2) * len(CACHES)
    assert files(unpacked) == files(sources) - caches | {"PKG-INFO"}


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_the_tests_of_the_source_distribution_are_collected(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the code that stands beside them."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(unpacked), str(unpacked / "plugins")]))
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    here = "import aiorts, aiorts_log; print(aiorts.__file__, aiorts_log.__file__)"
    assert run(sys.executable, "-c", here, cwd=unpacked).count(str(unpacked)) == 2
    said = run(
        sys.executable, "-m", "pytest", "-q", "--collect-only", "--assert=plain", "-p", "no:cacheprovider", cwd=unpacked
    )
    assert re.search(r"\d{4} tests collected|\d{4}/\d{4} tests collected", said), said[-2000:]


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_the_wheel_has_the_guide_the_types_and_the_licences_and_no_data_of_others(wheel: Path) -> None:
    names = set(contents(wheel))
    assert {f"aiorts/guide/pages/{page.relative_to(FOLDER)}" for page in FOLDER.rglob("*") if page.is_file()} <= names
    plugins = ("bench", "flexi", "foxglove", "log", "openrtm", "studio", "zenoh")
    packages = ("aiorts", *(f"aiorts_{plugin}" for plugin in plugins))
    assert {f"{package}/py.typed" for package in packages} <= names
    assert [name for name in names if re.search(r"\.pyc$|cache|hypothesis|\.(mcap|bag|db3|csv|ipynb)$", name)] == []
    assert [name for name in names if name.endswith(OF_OTHERS)] == []
    assert {name.rpartition("/")[2] for name in names if "/licenses/" in name} == {"LICENSE", "LICENSES.txt"}
    assert metadata(wheel)["License-Expression"] == "Apache-2.0 AND MIT AND ISC AND BSD-3-Clause"


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_the_source_distribution_says_whose_the_recording_is(unpacked: Path) -> None:
    assert "not covered by its licence" in (unpacked / "examples/roomba/NOTICE").read_text(encoding="utf-8")


def test_the_classifiers_are_valid_and_nothing_is_promised_that_is_not_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = pytest.importorskip("trove_classifiers")
    classifiers = project["classifiers"]
    assert set(classifiers) <= set(known.classifiers) - set(known.deprecated_classifiers)
    assert classifiers == sorted(classifiers)
    assert not [one for one in classifiers if one.startswith("License ::")], "the field license is the place for it"
    pythons = [one.rpartition(" ")[2] for one in classifiers if re.search(r":: 3\.\d+$", one)]
    assert pythons[0] == project["requires-python"].removeprefix(">=")
    assert "urls" not in project, "a URL needs a page that is there"


def as_wheel(name: str, folder: Path) -> list[str]:
    """Write an installed distribution as a wheel; returns what it requires without an extra."""
    found = distribution(name)
    files = [file for file in found.files or () if ".." not in file.parts and "__pycache__" not in file.parts]
    left_out = ("INSTALLER", "REQUESTED", "direct_url.json")
    tags = re.findall(r"^Tag: (\S+)", found.read_text("WHEEL") or "", re.MULTILINE)
    python, abi, _ = tags[0].split("-")
    platforms = ".".join(tag.split("-")[2] for tag in tags)
    title = re.sub(r"[-_.]+", "_", found.metadata["Name"])
    with zipfile.ZipFile(folder / f"{title}-{found.version}-{python}-{abi}-{platforms}.whl", "w") as archive:
        for file in files:
            if file.name not in left_out:
                archive.write(str(file.locate()), str(file))
    return [one for one in found.requires or () if "extra ==" not in one]


@pytest.mark.slow(
    kept_by="architecture/test_wheel.py::test_what_is_installed_needs_a_python_of_today_and_five_packages"
)
def test_it_installs_without_a_network_from_a_folder_of_wheels(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`pip wheel` needs an index to make that folder (`nox -s release` does): here it is made of what is installed."""
    house = tmp_path / "wheelhouse"
    house.mkdir()
    shutil.copy(wheel, house)
    todo, done = [one for one in metadata(wheel).get_all("Requires-Dist") or () if "extra ==" not in one], set()
    while todo:
        requirement, _, marker = todo.pop().partition(";")
        name = re.match(r"[\w.-]+", requirement)
        assert name
        if name[0] not in done and not re.search(r'python_version < "3\.(\d|1[01])"', marker):
            done.add(name[0])
            todo += as_wheel(name[0], house)
    for variable in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(variable)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    run(sys.executable, "-m", "venv", "--without-pip", "new", cwd=tmp_path)
    pip = (sys.executable, "-m", "pip", "--python", "new/bin/python")
    run(*pip, "install", "-q", "--no-index", "--find-links", house, "aiorts", cwd=tmp_path)
    run(*pip, "check", cwd=tmp_path)
    assert "the same 301 values" in run(tmp_path / "new/bin/aiorts", "demo", cwd=tmp_path)
    assert "releases" in run(tmp_path / "new/bin/aiorts", "help", "--list", cwd=tmp_path)


def test_the_changelog_says_what_each_version_is_on_a_few_pages() -> None:
    text = CHANGELOG.read_text(encoding="utf-8")
    lines = text.splitlines()
    assert len(lines) <= 110
    assert [line for line in lines if len(line) > 120] == []
    entries = re.findall(r"^- ((?:.|\n  )+)", text, re.MULTILINE)
    assert len(entries) > 20
    # Nothing was released yet that could break.
    assert "0.1.0 (unreleased)" not in text or "breaking" not in text.lower()


def test_the_page_on_what_stays_names_the_formats() -> None:
    text = (FOLDER / "explanation" / "stability.md").read_text(encoding="utf-8")
    assert f"`schema = {SCHEMA}`" in text
    assert f"recording format, now {MAJOR}.{MINOR}." in text


def test_the_version_is_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert aiorts.__version__ == project["version"]
    assert f"\n## {aiorts.__version__}" in CHANGELOG.read_text(encoding="utf-8")
