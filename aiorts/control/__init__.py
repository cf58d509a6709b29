"""Looks into and controls running kernels: what is said, in frames, and the client's end of it.

One table has all operations (`operations`); a kernel answers them over a local socket (`server`). What is here is
imported by short-lived commands: it knows neither asyncio nor the kernel.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.control.client import END, TIMEOUT, Client, CutOff, Silent, Stream, open_all
    from aiorts.control.folder import FURTHER, Carrier, Claim, Entry, entries, private_folder
    from aiorts.control.many import FEW
    from aiorts.control.operation import Right
    from aiorts.control.protocol import BYE, NEWEST, OLDEST, REQUESTS, answer_in, error_in, framed, frames
    from aiorts.control.server.service import Control
    from aiorts.control.session import Session
    from aiorts.control.target import (
        FILES,
        PATIENCE,
        Found,
        Kernels,
        Running,
        is_file,
        is_glob,
        kernels,
        likely,
        outlines,
        sharing,
        the_one,
    )
    from aiorts.control.together import Outcome, change_all

__all__ = (
    "BYE",
    "END",
    "FEW",
    "FILES",
    "FURTHER",
    "NEWEST",
    "OLDEST",
    "PATIENCE",
    "REQUESTS",
    "TIMEOUT",
    "Carrier",
    "Claim",
    "Client",
    "Control",
    "CutOff",
    "Entry",
    "Found",
    "Kernels",
    "Outcome",
    "Right",
    "Running",
    "Session",
    "Silent",
    "Stream",
    "answer_in",
    "change_all",
    "entries",
    "error_in",
    "framed",
    "frames",
    "is_file",
    "is_glob",
    "kernels",
    "likely",
    "open_all",
    "outlines",
    "private_folder",
    "sharing",
    "the_one",
)

_late(
    globals(),
    {
        "aiorts.control.client": "END TIMEOUT Client CutOff Silent Stream open_all",
        "aiorts.control.folder": "FURTHER Carrier Claim Entry entries private_folder",
        "aiorts.control.many": "FEW",
        "aiorts.control.operation": "Right",
        "aiorts.control.protocol": "BYE NEWEST OLDEST REQUESTS answer_in error_in framed frames",
        "aiorts.control.server.service": "Control",
        "aiorts.control.session": "Session",
        "aiorts.control.together": "Outcome change_all",
        "aiorts.control.target": (
            "FILES PATIENCE Found Kernels Running is_file is_glob kernels likely outlines sharing the_one"
        ),
    },
)
