"""The profile of each example that is a system file is read back as it was."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from aiorts import Kernel, SystemProfile, profile_from_plain
from aiorts.system import build, load
from aiorts.testing import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = (
    *("hello/system.toml", "pid/system.toml", "manipulator/sim.toml", "roomba/system.toml"),
    *("flexi/vector.toml", "flexi/millimetres.toml", "deploy/robot.toml"),
)


@pytest.mark.parametrize("file", FILES)
def test_the_profile_of_a_real_system_is_read_back(file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "example"
    shutil.copytree((EXAMPLES / file).parent, folder)
    monkeypatch.chdir(folder)

    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            await build(kernel, load(folder / Path(file).name))
            await kernel.sleep(0.3)
            profile = kernel.profile()
            unknown: dict[str, object] = {}
            read = profile_from_plain(SystemProfile, json.loads(profile.to_json()), unknown=unknown)
            assert unknown == {}
            assert profile.components
            assert read == profile
            assert read.to_json() == profile.to_json()

    simulate(main)
