"""The operations of a kernel that are offered over HTTP: those of its table that do not need the right `code`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Final

from aiorts.control import OPERATIONS, Operation, Right
from aiorts.errors import RecordError
from aiorts_studio.plain.problems import HttpError

LARGE: Final = frozenset(("apply", "change", "load_configuration", "plan"))
"""The operations whose arguments are the text of a file."""
_LOOK: Final = 10.0
"""Seconds that an operation which only looks may take."""
_CHANGE: Final = 60.0
"""Seconds that an operation which changes something may take; its `timeout`, where it has one, is added."""
_LONGEST: Final = 3_600.0
"""Seconds that any call is waited for."""


def offered(right: Right) -> Mapping[str, Operation]:
    """The operations that clients with this right may call, by name."""
    return {name: one for name, one in OPERATIONS.items() if one.right is not Right.CODE and right.allows(one.right)}


def operation_of(name: str, right: Right) -> Operation:
    """The operation of this name; HttpError: there is none, or it needs more than this right."""
    operation = OPERATIONS.get(name)
    if operation is None:
        raise HttpError(404, "E-ABSENT", f"{name:.80}: no such operation; /openapi.json has all of them")
    if operation.right is Right.CODE:
        raise HttpError(403, "E-DENIED", f"{name}: gives the kernel code, and is not offered over HTTP")
    if not right.allows(operation.right):
        text = f"{name}: needs the right {operation.right.value!r}, and this server gives {right.value!r}; see --edit"
        raise HttpError(403, "E-DENIED", text)
    return operation


def asked_in(said: Mapping[str, Any], what: str, right: Right) -> tuple[str, Operation, dict[str, Any]]:
    """The kernel, the operation and the arguments that a message asks for; AiortsError: these are not offered."""
    kernel, name, arguments = said.get("kernel"), said.get("operation"), said.get("arguments", {})
    if not (isinstance(kernel, str) and isinstance(name, str) and isinstance(arguments, dict)):
        raise RecordError(f"{what}: expected kernel and operation, and arguments as an object")
    operation = operation_of(name, right)
    check_names(operation, arguments)
    return kernel, operation, arguments


def check_names(operation: Operation, arguments: Mapping[str, Any]) -> None:
    """Raise RecordError where the operation has no argument of a given name, as its description says, too."""
    known = [one.name for one in fields(operation.arguments)]
    if unknown := sorted(arguments.keys() - set(known)):
        text = f"{operation.name}: no argument {unknown[0]:.60}; there are {', '.join(known) or 'none'}"
        raise RecordError(text)


def patience(operation: Operation, arguments: Mapping[str, Any]) -> float:
    """Seconds that the answer to a call is waited for."""
    usual = _LOOK if operation.right is Right.VIEW else _CHANGE
    default = {one.name: one.default for one in fields(operation.arguments)}.get("timeout", MISSING)
    asked = arguments.get("timeout", default)
    if asked is None:
        return _LONGEST
    asked = min(asked, _LONGEST) if type(asked) in (int, float) and asked > 0 else 0.0
    return float(min(usual + asked, _LONGEST))
