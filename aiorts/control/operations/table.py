"""The table of all operations of a kernel, by name, for every carrier.

Each file of this folder has the rows of one subject. A new row is added to its file only, since carriers read the
table.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from aiorts.control.operation import Operation
from aiorts.control.operations import operations_of

OPERATIONS: Final[Mapping[str, Operation]] = MappingProxyType(
    operations_of(
        *("catalogue", "components", "configuration", "contexts", "events", "lifecycle", "logs", "look", "machines"),
        *("parts", "planning", "reloading", "samples", "services", "statistics", "wiring"),
    )
)
"""The operations that a kernel offers its clients, by name."""
