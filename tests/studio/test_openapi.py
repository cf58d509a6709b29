"""The description is OpenAPI 3.1, says the types of everything, and is what the server answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from aiorts.control import OPERATIONS, Right
from aiorts_studio.openapi import document, page
from control_parts import controlled
from studio_parts import site

LOOSE = {
    # What users decide the types of: values of parameters, options, arguments and results of services, samples.
    *("given.Calling.args", "given.Calling.kwargs", "given.Configuring.values", "given.Creation.params"),
    *("given.Sending.data", "given.Start.options", "given.Wiring.options", "Tapping.data"),
    *("ComponentEntry.limits", "ComponentEntry.params", "ComponentEntry.sets"),
    *("ConfigurationProfile.sets", "ConfigurationReport.sets", "ConnectionEntry.options", "ContextEntry.options"),
    *("Limits.choices", "ParameterReport.choices", "ParameterReport.value", "Reading.values"),
    *("configuration_profile.ParameterProfile.choices", "configuration_profile.ParameterProfile.value"),
    *("PlannedStep.after", "PlannedStep.before", "Result.value", "GoalEnd.result", "goal"),
    # What services say of themselves, and events, which have a type each.
    *("SystemProfile.services", "Happened.event", "ToldChange.event"),
}
"""Schemas that say nothing, and operations whose answer is one."""


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if isinstance(found := value.get("$ref"), str):
            yield found
        for one in value.values():
            yield from references(one)
    elif isinstance(value, list):
        for one in value:
            yield from references(one)


def empty(value: Any, path: str = "") -> Iterator[str]:
    """Where a schema says nothing."""
    if isinstance(value, dict) and value.keys() <= {"default", "description"}:
        yield path
    elif isinstance(value, dict):
        for name, one in value.items():
            inside = name in ("properties", "items", "additionalProperties", "anyOf", "prefixItems")
            if name not in ("default", "description", "const", "enum") and (name, one) != ("properties", {}):
                yield from empty(one, path if inside else f"{path}.{name}".strip("."))
    elif isinstance(value, list):
        for one in value:
            yield from empty(one, path)


@pytest.mark.slow(kept_by="test_answers_are_as_described")
@pytest.mark.row(151)
@pytest.mark.parametrize("right", [Right.VIEW, Right.OPERATE])
def test_it_has_what_the_right_allows_with_types(right: Right) -> None:
    described = document(right, "http://127.0.0.1:1")
    offered = {path.rpartition("/")[2] for path in described["paths"] if "{kernel}" in path}
    allowed = {name for name, one in OPERATIONS.items() if right.allows(one.right) and one.right is not Right.CODE}
    assert offered == allowed
    assert "reload" not in offered
    schemas = described["components"]["schemas"]
    assert {one.rpartition("/")[2] for one in references(described)} <= schemas.keys()
    for name, schema in schemas.items():
        jsonschema.Draft202012Validator.check_schema(schema)
        assert schema["type"] == "object", name
    answers = {
        path.rpartition("/")[2]: [found["schema"] for found in one["post"]["responses"]["200"]["content"].values()]
        for path, one in described["paths"].items()
        if "{kernel}" in path
    }
    loose = {one for name, schema in schemas.items() for one in empty(schema, name)}
    loose |= {name for name, found in answers.items() if any(True for _ in empty(found))}
    assert loose <= LOOSE
    assert right is Right.VIEW or loose == LOOSE


def test_the_page_shows_all_of_it_and_loads_nothing_from_elsewhere() -> None:
    described = document(Right.OPERATE, "http://127.0.0.1:1")
    shown = page(described)
    assert all(path.replace("&", "&amp;") in shown for path in described["paths"])
    assert "<script" not in shown
    assert shown.count("href=") == 1
    assert 'href="/docs.css"' in shown


@pytest.mark.anyio
@pytest.mark.row(151)
async def test_answers_are_as_described() -> None:
    async with controlled("robot"), site() as client:
        described = (await client.ask("GET", "/openapi.json", headers={"Authorization": ""})).value
        checked = 0
        for path, one in described["paths"].items():
            name = path.rpartition("/")[2]
            if one.get("post", {}).get("x-right") != "view" or OPERATIONS[name].streams:
                continue
            known = {
                "component": "counter0",
                "components": ["counter0"],
                "type": "TimedDouble",
                "wanted": ["version = 1\n"],
            }
            wanted = OPERATIONS[name].arguments.__dataclass_fields__
            reply = await client.call("robot", name, **{key: value for key, value in known.items() if key in wanted})
            schema = one["post"]["responses"][str(reply.status)]["content"][reply.headers["content-type"]]["schema"]
            jsonschema.validate(reply.value, {**schema, "components": described["components"]})
            checked += reply.status == 200
        assert checked >= 12
        for path in ("/", "/docs", "/docs.css"):
            assert (await client.ask("GET", path, headers={"Authorization": ""})).status == 200


def test_the_values_of_a_row_have_names() -> None:
    counters = document(Right.VIEW, "http://127.0.0.1:1")["components"]["schemas"]["Counters"]
    row = counters["properties"]["connectors"]["additionalProperties"]
    assert [one["title"] for one in row["prefixItems"]] == ["written", "delivered", "buffered", "dropped", "measure"]
