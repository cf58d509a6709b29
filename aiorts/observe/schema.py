"""The published JSON Schema of a system's profile; made from the very classes that are written."""

from __future__ import annotations

from typing import Any

from aiorts.model.plain import Schemas
from aiorts.observe.profiles import PROFILE_VERSION, SystemProfile


def profile_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of `Kernel.profile().to_json()`."""
    schemas = Schemas()
    reference, definitions = schemas.of(SystemProfile), schemas.definitions
    definitions["SystemProfile"]["properties"]["schema"] = {"const": PROFILE_VERSION}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:aiorts:profile:{PROFILE_VERSION}",
        "title": "Profile of an aiorts kernel",
        **reference,
        "$defs": dict(sorted(definitions.items())),
    }
