"""The version of the format of system files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from aiorts.spelling import meant

SCHEMA: Final = 1


def version_fault(top: Mapping[str, Any]) -> tuple[str, bool]:
    """The fault of a file's version, "" for none; and whether it is another version, whose keys are not known."""
    version = top.get("schema")
    if type(version) is not int:
        got = f"got {version!r:.80}" if "schema" in top else "it is missing"
        near = meant("schema", top, "'schema' by {!r}".format) if "schema" not in top else ""
        return f"expected schema = {SCHEMA} in the first line, {got}{near}", False
    if version == SCHEMA:
        return "", False
    advice = "update aiorts" if version > SCHEMA else f"write the file for schema {SCHEMA}"
    return f"version {version}, and this aiorts reads schema = {SCHEMA} alone; {advice}", True
