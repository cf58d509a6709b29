"""The reference has everything that there is, and says of it what the code says now.

What there is, is asked of the commands and of the modules themselves, not of the generator.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
from enum import Enum
from pathlib import Path
from typing import Any

import pytest
from test_layers import PUBLIC, ROOT

from aiorts import events
from aiorts.cli.app import run_command
from aiorts.guide import pages
from aiorts.tiers import NOT_STABLE
from reference import FOLDER, HEADS, LINKS, links_page, noted, page
from reference_api import report_class

GENERATED = ["exit-status", *sorted(HEADS.keys() - {"exit-status"})]
ENVIRONMENT = "AIORTS_PLUGINS"


@pytest.fixture(autouse=True)
def only_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ENVIRONMENT, raising=False)
    monkeypatch.setenv("COLUMNS", "200")


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    assert run_command(arguments) == 0
    return capsys.readouterr().out


def sections(name: str) -> dict[str, str]:
    """The text below each heading of a page."""
    parts = re.split(r"^#{2,3} (.*)$", (FOLDER / f"{name}.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {head.strip("`"): " ".join(text.split()) for head, text in zip(parts[1::2], parts[2::2], strict=True)}


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("name", GENERATED)
def test_a_page_is_what_the_generator_gives_now(name: str) -> None:
    assert (FOLDER / f"{name}.md").read_text(encoding="utf-8") == page(name), "run: python tests/reference.py"


def test_the_diagrams_of_links_are_those_of_the_table() -> None:
    text = LINKS.read_text(encoding="utf-8")
    assert text.count("stateDiagram-v2") == 3
    assert text == links_page(text), "run: python tests/reference.py"


def test_a_page_about_something_that_is_not_stable_says_so_below_its_title_and_no_other_does() -> None:
    assert [one.name for one in pages() if one.text != noted(one.name, one.text)] == [], (
        "run: python tests/reference.py"
    )
    said = {
        one.name: one.text.splitlines()[2].partition(":")[0] for one in pages() if one.text.splitlines()[2][0] == "*"
    }
    assert said == {name: f"*{tier.name}" for tier in NOT_STABLE for name in tier.pages}


def test_every_public_name_has_an_entry() -> None:
    entries = sections("api")
    names = [f"{module}.{name}" for module in PUBLIC for name in importlib.import_module(module).__all__]
    assert [name for name in names if name not in entries] == []
    assert [name for name, text in entries.items() if not text] == []


def listed(option: str, text: str) -> bool:
    """Whether an option has a line of its own."""
    return re.search(rf"- `[^`]*(?<![\w-]){option}(?![\w-])", text) is not None


def commands(shown: str) -> list[str]:
    """The commands that a help names, filters included."""
    below = shown.partition("\nOptions:\n")[2] if "\nOptions:\n" in shown else f"\n\n{shown}"
    lists, _, filters = below.partition("\nExit status:")[0].partition("Components, as filters:\n")
    lists = "".join(lists.partition("\n\n")[1:])
    return re.findall(r"^  ([a-z][\w-]*) +[A-Z]", lists, re.MULTILINE) + re.findall(r"[a-z]+", filters)


@pytest.mark.slow(kept_by="test_a_page_is_what_the_generator_gives_now")
def test_every_command_and_option_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    entries, lacking, seen = sections("command-line"), [], list[str]()
    waiting: list[tuple[str, ...]] = [()]
    while waiting:
        words = waiting.pop()
        shown = printed(capsys, *words, "--help")
        path = " ".join(["aiorts", *words])
        seen.append(path)
        text = entries.get(path, "")
        options = re.findall(r"^  (?:-\w, )?(--[\w-]+)", shown.partition("ptions:\n")[2], re.MULTILINE)
        lacking += [f"{path} {option}" for option in options if option != "--help" and not listed(option, text)]
        if "COMMAND [ARGS]" in shown:
            waiting += [(*words, name) for name in commands(shown if words else printed(capsys, "help", "commands"))]
    assert lacking == []
    assert set(entries) == set(seen)
    assert {"aiorts run", "aiorts log plot", "aiorts bench push", "aiorts flexiselect"} < set(seen)


def test_every_error_code_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    codes = re.findall(r"^([EWN]-[A-Z-]+)", printed(capsys, "help", "errors"), re.MULTILINE)
    assert len(codes) > 50
    assert sorted(codes) == list(sections("error-codes"))


def test_every_exit_status_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    statuses = re.findall(
        r"^  (\d[\d +n]*?)  ", printed(capsys, "help", "commands").partition("Exit status:")[2], re.MULTILINE
    )
    text = (FOLDER / "exit-status.md").read_text(encoding="utf-8")
    assert statuses == re.findall(r"^- `([^`]+)`", text, re.MULTILINE)


@pytest.mark.slow
def test_every_record_type_is_there_with_its_fields(capsys: pytest.CaptureFixture[str]) -> None:
    entries = sections("record-types")
    known = [one for one in json.loads(printed(capsys, "types", "--json")) if one["group"] not in ("user", "plain")]
    assert len(known) > 150
    for one in known:
        text = entries[one["name"]]
        for name in one.get("members", ()):
            assert f"`{name}`" in text
        for field in one.get("fields", ()):
            assert f"`{field['name']}: {field['type']}{' [' + field['unit'] + ']' if field['unit'] else ''}`" in text


def test_every_event_is_there_with_its_fields() -> None:
    entries = sections("events")
    assert sorted(entries) == sorted(events.__all__)
    for name, text in entries.items():
        cls: Any = getattr(events, name)
        names = cls.__members__ if issubclass(cls, Enum) else [one.name for one in dataclasses.fields(cls)]
        for field in names:
            assert re.search(rf"`{field}\b", text) or field == "sequence", f"{name}.{field}"


def test_every_key_of_a_system_file_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    schema = json.loads(printed(capsys, "schema"))
    text = (FOLDER / "system-file.md").read_text(encoding="utf-8")
    tables = [schema, *schema["properties"].values(), *schema["properties"]["clock"]["oneOf"]]
    tables += [
        *schema["$defs"].values(),
        *schema["$defs"]["context"]["oneOf"],
        schema["$defs"]["component"]["oneOf"][-1],
    ]
    keys = {key for table in tables for key in table.get("properties", ())}
    assert len(keys) > 60
    assert [key for key in sorted(keys) if f"`{key}`" not in text and f"[{key}" not in text] == []


@pytest.mark.slow(kept_by="first")
def test_every_option_and_parameter_of_a_flexi_component_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    entries = sections("flexi")
    assert len(entries) == 7
    for name, text in entries.items():
        options = re.findall(r"^  (?:-\w, )?(--[\w-]+)", printed(capsys, name.lower(), "--help"), re.MULTILINE)
        common = {
            "--for",
            "--loop",
            "--codec",
            "--debug",
            "--help",
            "--count",
            "--rate",
            "--name",
            "--connect",
            "--plugins",
        }
        assert [option for option in options if not listed(option, text) and option not in common] == []
        params = json.loads(printed(capsys, "inspect", name, "--json"))["parameters"]
        assert [one["name"] for one in params if f"`{one['name']}: " not in text] == []


@pytest.mark.slow(kept_by="first")
def test_every_class_of_statistics_is_there_with_its_fields() -> None:
    entries = sections("statistics")
    sources = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "aiorts").rglob("*.py"))]
    declared = {
        name
        for text in sources
        for name in re.findall(r"^class ([A-Z]\w+(?:Statistics|Profile|Report))\b", text, re.MULTILINE)
    }
    assert len(declared) > 20
    assert declared <= entries.keys()
    for name in declared - {"ParameterProfile"}:
        cls: Any = report_class(name)
        for field in dataclasses.fields(cls):
            assert f"`{field.name}: " in entries[name], f"{name}.{field.name}"


def test_the_reference_adds_little_to_the_wheel() -> None:
    assert sum(path.stat().st_size for path in Path(FOLDER).glob("*.md")) < 530_000
