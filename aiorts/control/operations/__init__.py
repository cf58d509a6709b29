"""The operations of a kernel, by name, for every carrier: a file for each subject, all joined in `table.py`.

The whole table is imported at its first use. A process that needs few operations imports their files alone.
"""

from __future__ import annotations

from importlib import import_module

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.control.operation import Operation
    from aiorts.control.operations.table import OPERATIONS

__all__ = ("OPERATIONS", "operations_of")

late()


def operations_of(*subjects: str) -> dict[str, Operation]:
    """The operations of these files alone, by name."""
    return {row.name: row for one in subjects for row in import_module(f"{__name__}.{one}").ROWS}
