"""Sessions with running kernels: the protocol, the folder of their sockets, and the client's end.

Links are built on this package. Short-lived commands import it, so it does not import the kernel, and only
`AsyncClient`, which is imported late, uses asyncio. The kernel's end is `aiorts.control`.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.sessions.async_client import AsyncClient, AsyncStream
    from aiorts.sessions.base_client import END, TIMEOUT, CutOff
    from aiorts.sessions.client import Client, Silent, Stream, open_all
    from aiorts.sessions.folder import (
        FURTHER,
        Carrier,
        Claim,
        Entry,
        TakenError,
        entries,
        is_supported,
        private_folder,
        remove_left,
    )
    from aiorts.sessions.many import FEW
    from aiorts.sessions.protocol import (
        BYE,
        REQUESTS,
        STALL_SECONDS,
        WAITING,
        Made,
        RightName,
        agreed,
        answer_in,
        framed,
        frames,
        has_frame,
        packed,
        request_in,
    )
    from aiorts.sessions.session import Call, ClientSession
    from aiorts.sessions.target import (
        FILES,
        PATIENCE,
        Found,
        Kernels,
        Running,
        fitting,
        is_file,
        is_glob,
        kernels,
        likely,
        offered,
        outlines,
        sharing,
        the_one,
    )
    from aiorts.sessions.together import Outcome, change_all

__all__ = (
    "BYE",
    "END",
    "FEW",
    "FILES",
    "FURTHER",
    "PATIENCE",
    "REQUESTS",
    "STALL_SECONDS",
    "TIMEOUT",
    "WAITING",
    "AsyncClient",
    "AsyncStream",
    "Call",
    "Carrier",
    "Claim",
    "Client",
    "ClientSession",
    "CutOff",
    "Entry",
    "Found",
    "Kernels",
    "Made",
    "Outcome",
    "RightName",
    "Running",
    "Silent",
    "Stream",
    "TakenError",
    "agreed",
    "answer_in",
    "change_all",
    "entries",
    "fitting",
    "framed",
    "frames",
    "has_frame",
    "is_file",
    "is_glob",
    "is_supported",
    "kernels",
    "likely",
    "offered",
    "open_all",
    "outlines",
    "packed",
    "private_folder",
    "remove_left",
    "request_in",
    "sharing",
    "the_one",
)

late()
