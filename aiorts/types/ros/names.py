"""The names of all records of ROS, for lookups of a type by name."""

from __future__ import annotations

from typing import Any

import aiorts.types.ros as ros
from aiorts.types.registry import full_name

_NAMES = tuple(full_name(cls) for name in ros.__all__ if hasattr(cls := getattr(ros, name), "__dataclass_fields__"))


def names(_: Any) -> tuple[str, ...]:
    """All names, as `package/Name`, whatever name is looked up."""
    return _NAMES
