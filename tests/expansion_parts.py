"""What the tests of included files, variables and repeated parts share."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts.errors import SystemFileError
from aiorts.system import AS_WRITTEN, Choices, SystemFile, check, load

ARM = """\
schema = 1
[variables]
speed = 1.0
side = "none"
[components.motor]
type = "parts.py:Source"
[components.gauge]
type = "parts.py:Middle"
params = { gain = "${speed}" }
start = { after = ["motor active"] }
[composites.arm]
members = ["motor", "gauge"]
exported = { "gauge.output" = "force", "motor.*" = "{port}" }
groups = "motor|gauge"
[[connections]]
from = "motor.out"
to = "gauge.input"
name = "wire"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["arm"]
"""


def refused(path: Path, choices: Choices = AS_WRITTEN) -> str:
    """Why a file is refused, without its folder; `check` says the same."""
    with pytest.raises(SystemFileError) as error:
        load(path, (), choices)
    text = str(error.value).replace(f"{path.parent}/", "")
    found = [one for one in check(path, (), (), choices) if one.severity == "error"]
    assert any(one.message.replace(f"{path.parent}/", "") in text for one in found)
    return text


def wires(system: SystemFile) -> list[tuple[str, ...]]:
    """The ports of each connection."""
    return [one.ports for one in system.connections]
