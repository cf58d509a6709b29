"""The kernel's end of the sessions in which clients look into a kernel and control it.

One table has all operations (`operations`); a kernel answers them over a local socket (`server`), and each client has
a `Session` on the kernel's loop. The protocol and the client's end are in `aiorts.sessions`.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.control.operation import Operation, Right, converters_read, is_code
    from aiorts.control.operations import OPERATIONS
    from aiorts.control.server.service import Control
    from aiorts.control.session import Session
    from aiorts.model.lifecycle import state_text
    from aiorts.model.plain import Schemas
    from aiorts.model.timing import ConnectorCounters

__all__ = (
    "OPERATIONS",
    "ConnectorCounters",
    "Control",
    "Operation",
    "Right",
    "Schemas",
    "Session",
    "converters_read",
    "is_code",
    "state_text",
)

late()
