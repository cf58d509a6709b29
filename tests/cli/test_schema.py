"""`aiorts schema`: printed as strict JSON, with the types of a system file's own plugins when one is named."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from aiorts.cli.app import run_command

ROOT = Path(__file__).parents[2]


@pytest.mark.slow(kept_by="first")
def test_it_is_a_schema_in_strict_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["schema"]) == 0
    printed = capsys.readouterr()

    def refuse(name: str) -> None:
        raise AssertionError(name)

    schema = json.loads(printed.out, parse_constant=refuse)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"


@pytest.mark.slow
def test_with_a_file_it_has_the_types_of_its_folders(capsys: pytest.CaptureFixture[str]) -> None:
    def types() -> set[str]:
        schema = json.loads(capsys.readouterr().out)
        return {one["properties"]["type"].get("const", "") for one in schema["$defs"]["component"]["oneOf"]}

    assert run_command(["schema", str(ROOT / "examples" / "roomba" / "system.toml")]) == 0
    with_file = types()
    assert run_command(["schema"]) == 0
    assert with_file - types() == {"Checker", "Odometry", "Recording"}
