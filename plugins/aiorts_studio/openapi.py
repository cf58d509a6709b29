"""The description of the API (OpenAPI 3.1), made from the types of the operations, and as a page for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from json import dumps
from types import NoneType
from typing import Any, Final

from aiorts import __version__
from aiorts.control import Operation, Right, Schemas
from aiorts_studio.kernels import Running
from aiorts_studio.offered import offered
from aiorts_studio.plain.problems import STATUSES

Json = dict[str, Any]

_TEXT: Final = """Running systems of this user on this machine.

A code, which the server prints, is exchanged for a token at `/api/token`; every other request under `/api` has the
token in its header `Authorization: Bearer TOKEN`. What an operation answers when it fails is a problem: an object with
the status, the code of the error and its text. Integers beyond 2^53 are texts, numbers that are not finite words.
Operations that stream answer with lines of JSON (`application/x-ndjson`) as long as the client reads them; over a
WebSocket at `/api/socket` one connection carries many of them.
"""
_PLACE: Final = "#/components/schemas/"
_INTEGER: Final = {"anyOf": [{"type": "integer"}, {"type": "string", "pattern": "^-?[0-9]{16,20}$"}]}
"""The schema of an integer in an answer: beyond 2^53 it is a text."""
_PROBLEM: Final[Json] = {
    "type": "object",
    "description": "What is wrong.",
    "properties": {
        "status": {"type": "integer"},
        "code": {"type": "string", "pattern": "^E-[A-Z-]+$"},
        "detail": {"type": "string"},
    },
    "required": ["status", "code", "detail"],
    "additionalProperties": False,
}
_TOKEN: Final[Json] = {
    "type": "object",
    "description": "A token, and what it allows.",
    "properties": {"token": {"type": "string"}, "right": {"enum": [Right.VIEW.value, Right.OPERATE.value]}},
    "required": ["token", "right"],
    "additionalProperties": False,
}
_CODE: Final[Json] = {
    "type": "object",
    "properties": {"code": {"type": "string"}},
    "required": ["code"],
    "additionalProperties": False,
}
_KERNEL: Final[Json] = {
    "name": "kernel",
    "in": "path",
    "required": True,
    "description": "The name or the address of a kernel, as `/api/kernels` has them.",
    "schema": {"type": "string", "minLength": 1},
}


def document(right: Right, server: str) -> Json:
    """The description of the operations that a server with this right offers.

    Args:
        right: the right that its tokens give.
        server: its address, "http://127.0.0.1:8080".
    """
    answers = Schemas(_PLACE, defaults=True, simple={int: _INTEGER})
    given = Schemas(f"{_PLACE}given.", defaults=True)
    paths: Json = {
        "/api/token": {
            "post": _described(
                "exchange",
                "Exchange a code for a token; needs the header `Origin`.",
                _json({"$ref": f"{_PLACE}Token"}),
                _CODE,
                security=[],
            ),
            "delete": _described("end_token", "End the token of this request.", {"204": {"description": "It ended."}}),
        },
        "/api/kernels": {"get": _described("kernels", "The kernels that run.", _json(answers.of(tuple[Running, ...])))},
    }
    for name, one in offered(right).items():
        answer = _lines(one, answers) if one.streams else _json(answers.of(one.result))
        path = _described(name, one.text, answer, given.of(one.arguments), parameters=[_KERNEL])
        paths[f"/api/kernels/{{kernel}}/{name}"] = {"post": path | {"x-right": one.right.value}}
    schemas = {"Problem": _PROBLEM, "Token": _TOKEN, **answers.definitions}
    schemas |= {f"given.{name}": schema for name, schema in given.definitions.items()}
    return {
        "openapi": "3.1.0",
        "info": {"title": "aiorts studio", "version": __version__, "description": _TEXT},
        "servers": [{"url": server}],
        "security": [{"token": []}],
        "paths": paths,
        "components": {
            "schemas": dict(sorted(schemas.items())),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _described(
    name: str,
    text: str,
    answers: Json,
    body: Json | None = None,
    *,
    parameters: Iterable[Json] = (),
    security: list[Json] | None = None,
) -> Json:
    found: Json = {"operationId": name, "summary": text, "parameters": list(parameters)}
    if body is not None:
        found["requestBody"] = {"required": True, "content": {"application/json": {"schema": body}}}
    if security is not None:
        found["security"] = security
    problem = {"application/problem+json": {"schema": {"$ref": f"{_PLACE}Problem"}}}
    problems = {str(status): {"description": "A problem.", "content": problem} for status in STATUSES}
    return found | {"responses": answers | problems}


def _json(schema: Json) -> Json:
    return {"200": {"description": "Done.", "content": {"application/json": {"schema": schema}}}}


def _lines(operation: Operation, answers: Schemas) -> Json:
    """The answers of an operation that streams: lines, each of one of these kinds."""
    missed = {"missed": {"type": "integer", "description": "Items that were dropped before it."}}
    lines = {
        "began": {"began": answers.of(operation.result)},
        "item": {"item": answers.of(operation.item), **missed},
        "end": {"end": answers.of(operation.end or NoneType), **missed},
        "problem": {"problem": {"$ref": f"{_PLACE}Problem"}},
    }
    kinds = [
        {"type": "object", "properties": line, "required": list(line), "additionalProperties": False}
        for line in lines.values()
    ]
    content = {"application/x-ndjson": {"schema": {"description": "Of each line.", "oneOf": kinds}}}
    return {"200": {"description": "Lines, as they come.", "content": content}}


def page(described: Mapping[str, Any]) -> str:
    """The description as a page for people."""
    schemas = described["components"]["schemas"]
    parts = [f"<p>{escape(part)}</p>" for part in described["info"]["description"].split("\n\n")]
    for path, methods in described["paths"].items():
        for method, one in methods.items():
            right = f" ({one['x-right']})" if "x-right" in one else ""
            parts.append(f"<h2>{method.upper()} {escape(path)}</h2><p>{escape(one['summary'])}{right}</p>")
            if "requestBody" in one:
                parts.append(_shown("Takes", one["requestBody"]["content"]["application/json"]["schema"]))
            for kind, content in one["responses"].get("200", {}).get("content", {}).items():
                parts.append(_shown(f"Answers ({kind})", content["schema"]))
    parts.append("<h1>Schemas</h1>")
    for name, schema in schemas.items():
        parts.append(f'<h2 id="{escape(name)}">{escape(name)}</h2>{_shown("", schema)}')
    return document_of("aiorts studio: the API", "".join(parts))


def document_of(title: str, body: str) -> str:
    """A page with our style and no script."""
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><link rel="stylesheet" href="/docs.css">'
    return f'<!doctype html><html lang="en"><head>{head}</head><body><h1>{escape(title)}</h1>{body}</body></html>'


def _shown(title: str, schema: Json) -> str:
    return f"<p>{escape(title)}</p><pre>{escape(dumps(schema, indent=1, ensure_ascii=False))}</pre>"
