"""F20: files of this version of the format mean tomorrow what they mean today, others are told which one is read.

The folder `golden` has the files, and beside each of this version what it means, as it was when it was first written.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from aiorts.errors import SystemFileError
from aiorts.model.wanted.system_text import system_text
from aiorts.system import SystemFile, check, load, parse, prepare, wanted
from run_parts import here
from system_parts import PARTS

GOLDEN = Path(__file__).with_name("golden")
SENTENCE = "schema: version {}, and this aiorts reads schema = 1 alone; {}"
OTHERS = {
    "version-0.toml": ("version-0.toml:1:10", SENTENCE.format(0, "write the file for schema 1")),
    "version-2.toml": ("version-2.toml:2:10", SENTENCE.format(2, "update aiorts")),
    "includes-2.toml": ("version-2.toml:2:10", SENTENCE.format(2, "update aiorts")),
}


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    """The files beside the components that they name."""
    folder = shutil.copytree(GOLDEN, tmp_path / "golden")
    (folder / "parts.py").write_text(PARTS)
    return folder


def told(system: SystemFile) -> str:
    """What a file means, in the one form that there is."""
    return system_text(wanted(prepare(system)), system.folder.resolve())


@pytest.mark.fault("F20")
@pytest.mark.parametrize("name", ["version-1.toml", "version-1.arms.toml"])
def test_a_file_of_this_version_means_what_it_meant(golden: Path, name: str) -> None:
    meant = (GOLDEN / f"{name}.meant").read_text()
    assert told(load(golden / name)) == meant
    assert told(parse(meant, golden / "meant.toml")) == meant


@pytest.mark.fault("F20")
@pytest.mark.parametrize("name", OTHERS)
def test_a_file_of_another_version_is_told_which_one_is_read(golden: Path, name: str) -> None:
    place, sentence = OTHERS[name]
    with pytest.raises(SystemFileError) as error:
        load(golden / name)
    assert str(error.value).replace(f"{golden}/", "") == f"{place}: {sentence}"
    (finding,) = [one for one in check(golden / name) if one.severity == "error"]
    assert f"{finding.where}: {finding.message}" == sentence
    assert finding.place.replace(f"{golden}/", "") == place


@pytest.mark.fault("F20")
@pytest.mark.parametrize("command", [("run",), ("check",), ("graph",), ("schema",), ("plan", "version-1.toml")])
@pytest.mark.parametrize("name", OTHERS)
def test_every_command_says_so_and_ends_with_status_2(golden: Path, command: tuple[str, ...], name: str) -> None:
    done = here(golden, *command, name)
    assert done.returncode == 2
    assert OTHERS[name][1] in done.stderr + done.stdout
    assert "Traceback" not in done.stderr
