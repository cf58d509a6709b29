"""Starts the processes of kernels, says how each of them ended, and leaves nothing of them.

They are started below one small helper process, which is no kernel and runs no user's code. It keeps the children's
limits and output within bounds and kills processes that have lost their parent. A child begins with `prepare`.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.processes.child import DESCRIPTOR, limit_memory, prepare
    from aiorts.processes.launcher import Child, Launcher
    from aiorts.processes.values import Ending, Limits

late()
