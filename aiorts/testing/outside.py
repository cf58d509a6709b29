"""Activities outside of a simulated loop that stop its time: worker threads of anyio, connected sockets."""

from __future__ import annotations

import socket
import sys
from typing import TYPE_CHECKING, Any

from aiorts.kernel.loop.guarded import KernelLog

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Mapping

_log = KernelLog(__name__)


def listens(fd: int) -> bool:
    """Whether a socket listens: its clients come from outside, and may never come."""
    option = getattr(socket, "SO_ACCEPTCONN", None)
    if option is None:
        return False
    try:
        view = socket.socket(fileno=fd)
    except OSError:
        return False
    try:
        return bool(view.getsockopt(socket.SOL_SOCKET, option))
    finally:
        view.detach()


class AnyioThreads:
    """Whether a worker thread of anyio is busy; anyio starts them itself and offers no public way to ask."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._workers: Any = None
        self._idle: Any = None
        self._variables: Mapping[Any, Any] | None = None

    def busy(self) -> bool:
        variables = self._variables
        if variables is None:
            variables = self._find()
        return len(variables.get(self._workers, ())) > len(variables.get(self._idle, ()))

    def _find(self) -> Mapping[Any, Any]:
        backend = sys.modules.get("anyio._backends._asyncio")
        if backend is None:
            return {}
        try:
            self._workers, self._idle = backend._threadpool_workers, backend._threadpool_idle_workers
            self._variables = sys.modules["anyio.lowlevel"]._run_vars.get(self._loop)
        except AttributeError:
            self._variables = {}
            _log.warning("this version of anyio hides its threads: anyio.to_thread does not stop simulated time")
        return {} if self._variables is None else self._variables
