"""The wheel, installed elsewhere, has the first-party plugins, runs, and leaves examples and tests out."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from test_layers import ROOT

from aiorts.cli import main

SOURCES = ("pyproject.toml", "README.md", "LICENSE", "aiorts", "plugins", "examples", "tests")


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=cwd, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built by pip from a copy of the sources, by the build tool that is installed when there is one."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "source"
    copy.mkdir()
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            shutil.copy(ROOT / name, copy / name)
    isolation = ["--no-build-isolation"] if _installed("hatchling") else []
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", *isolation, "-w", folder, copy, cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


def _installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


@pytest.fixture(scope="module")
def elsewhere(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scripts folder of a new virtual environment with the wheel; dependencies come from this one."""
    folder = tmp_path_factory.mktemp("elsewhere") / "env"
    venv.create(folder, symlinks=True, with_pip=False)
    target = Path(sysconfig.get_path("purelib", "venv", vars={"base": str(folder), "platbase": str(folder)}))
    scripts = folder / "bin"
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        scripts / "python",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        wheel,
        cwd=folder,
    )
    here = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    # Appended by code, so that an editable install of this checkout, listed there in a .pth, is not followed.
    (target / "dependencies.pth").write_text(f"import sys; sys.path.extend({sorted(here)!r})\n")
    return scripts


@pytest.mark.slow(kept_by="test_what_is_installed_needs_a_python_of_today_and_five_packages")
def test_wheel_holds_package_and_plugins_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "aiorts",
        "aiorts_bench",
        "aiorts_flexi",
        "aiorts_foxglove",
        "aiorts_log",
        "aiorts_openrtm",
        "aiorts_studio",
        "aiorts_zenoh",
    }
    assert "aiorts/py.typed" in names
    assert "aiorts_flexi/py.typed" in names
    assert "aiorts_foxglove/py.typed" in names
    assert "aiorts_log/py.typed" in names
    assert "aiorts_openrtm/py.typed" in names
    assert "aiorts_studio/py.typed" in names
    assert "aiorts_zenoh/py.typed" in names
    assert not [name for name in names if "roomba" in name or name.endswith((".csv", ".txt.gz"))]
    assert [name for name in names if name.endswith("licenses/LICENSE")]


@pytest.mark.row(2, 3)
def test_what_is_installed_needs_a_python_of_today_and_five_packages() -> None:
    """No broker, no compiler: what pip is asked for is all there is, and the command is there with it."""
    installed = distribution("aiorts")
    assert installed.metadata["Requires-Python"] == ">=3.11"
    needed = {re.split(r"\W", one)[0] for one in installed.requires or () if "extra ==" not in one}
    assert needed == {"anyio", "click", "msgpack", "numpy", "uvloop"}
    (command,) = (one for one in installed.entry_points if one.group == "console_scripts")
    assert (command.name, command.load()) == ("aiorts", main)


@pytest.mark.slow(kept_by="test_what_is_installed_needs_a_python_of_today_and_five_packages")
@pytest.mark.row(2, 3)
def test_installed_wheel_runs_elsewhere(elsewhere: Path, tmp_path: Path) -> None:
    code = "import aiorts, aiorts_flexi, aiorts_log; print(aiorts.__file__, aiorts_flexi.__file__, aiorts_log.__file__)"
    places = run(elsewhere / "python", "-I", "-c", code, cwd=tmp_path).split()
    assert all(str(elsewhere.parent) in place for place in places)
    assert run(elsewhere / "aiorts", "--version", cwd=tmp_path).strip().endswith("0.1.0")
    assert "run" in run(elsewhere / "aiorts", "--help", cwd=tmp_path)


@pytest.mark.slow(kept_by="test_what_is_installed_needs_a_python_of_today_and_five_packages")
def test_installed_wheel_offers_its_extensions(elsewhere: Path, tmp_path: Path) -> None:
    code = (
        "from importlib.metadata import entry_points\n"
        "print(*(point.load().__name__ for point in entry_points(group='aiorts.components')))"
    )
    assert {"FlexiDump", "FlexiFilter"} <= set(run(elsewhere / "python", "-I", "-c", code, cwd=tmp_path).split())


@pytest.mark.slow(kept_by="test_what_is_installed_needs_a_python_of_today_and_five_packages")
def test_installed_wheel_shows_and_saves_its_demo(elsewhere: Path, tmp_path: Path) -> None:
    assert "the same 301 values" in run(elsewhere / "aiorts", "demo", cwd=tmp_path)
    run(elsewhere / "aiorts", "demo", "--save", "motor", cwd=tmp_path)
    assert "rpm TimedLong" in run(elsewhere / "aiorts", "run", "motor/system.toml", "--simulate", cwd=tmp_path)
