"""Finds the kernel of a component elsewhere, opens a session with it, and makes the class of the stand-in here.

A kernel of this host is found by its control socket; one of another host by a transport that carries sessions.
"""

from __future__ import annotations

import asyncio
import errno
import platform
import socket
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from anyio import to_thread

from aiorts.errors import AbsentError, ClosedError, DeniedError, LinkError, NoAnswerError, StateError
from aiorts.kernel.execution.file_access import acting
from aiorts.kernel.parameters import Param
from aiorts.links import Links
from aiorts.model.configuration.sets import DEFAULT
from aiorts.model.names import Path
from aiorts.model.values import convert_value, parse_type
from aiorts.remote.component import FarComponent
from aiorts.remote.session import KernelSession
from aiorts.sessions import Entry, entries
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel

_APPEARS: Final = 3.0
"""Seconds in which an absent kernel or component may come: both may be started at the same time."""
_LOOK: Final = 0.1


async def stand_in(kernel: Microkernel, path: str, holder: str = "") -> Component:
    """See `Kernel.stand_in`."""
    where = Path.parse(path)
    if where.port or not kernel.registry.is_elsewhere(path):
        raise StateError(f"{path}: expected kernel/component, of another kernel than {kernel.name}")
    if where.component in kernel.components:
        raise StateError(
            f"{path}: there is a component {where.component!r} here already, whose name what stands for it would have"
        )
    session = await opened(kernel, where, path, _APPEARS)
    try:
        configuration = await session.call("configuration", component=where.component)
        made = _class_of(where.component, configuration)(where.component)
        made.bind(where, holder, session)
        with acting(None):  # the values of the far component are no files that the client has named
            await kernel.add(made)
    except (AbsentError, StateError) as error:
        session.close()
        raise StateError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
    except BaseException:
        session.close()
        raise
    return made


async def opened(kernel: Microkernel, where: Path, path: str, patience: float = 0.0) -> KernelSession:
    """A session with the kernel of a path, which lets this one operate.

    Args:
        patience: seconds in which kernel and component may come.

    Raises:
        LinkError: the kernel is not there, or cannot be reached.
        DeniedError: the kernel lets others look only.
    """
    until = kernel.loop.time() + patience
    connected, address = await _connected(kernel, where, path, until)
    try:
        session = await KernelSession.over(connected, address, f"kernel {kernel.service(Links).reached_as}")
    except (ClosedError, NoAnswerError) as error:
        why = "is lost" if isinstance(error, ClosedError) else "does not answer"
        raise LinkError(f"{path}: its kernel {where.kernel} {why}") from None
    if session.hello.get("right") not in ("operate", "code"):
        session.close()
        raise DeniedError(
            f"{path}: {address} lets this kernel look only; on this host it runs with --control on, "
            "on another one with --allow-control"
        )
    try:
        while where.component not in (await session.call("names"))["components"]:
            if kernel.loop.time() >= until:
                break  # the call that asks for it there is told that there is none
            await asyncio.sleep(_LOOK)
    except BaseException:
        session.close()
        raise
    return session


async def _connected(kernel: Microkernel, where: Path, path: str, until: float) -> tuple[socket.socket, str]:
    reach, loop = kernel.service(Links).reach, kernel.loop
    while True:
        there = await to_thread.run_sync(entries)
        for entry in there:
            if _is(entry, where) and (connected := _connect(entry)) is not None:
                return connected, entry.address
        if (carried := await reach.session(where)) is not None:
            return carried
        if loop.time() >= until:
            own = where.kernel, kernel.address.rpartition("/")[2]
            names = [entry.name for entry in there if entry.name not in own]
            names += [peer.kernel for peer in reach.peers if peer.kernel not in names]
            others = f"; {suggestion(where.kernel, names)}" if names else ", nor does any other one; start it first"
            raise LinkError(f"{path}: no kernel {where.kernel!r} runs{others}")
        await asyncio.sleep(_LOOK)


def _is(entry: Entry, where: Path) -> bool:
    return entry.name == where.kernel and where.host.lower() in ("", "localhost", platform.node().lower())


def _connect(entry: Entry) -> socket.socket | None:
    """A connection with a kernel of this host; None: it is gone, and left its entry behind."""
    connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connected.setblocking(False)
    try:
        connected.connect(entry.path)
    except OSError as error:
        connected.close()
        if error.errno in (errno.ECONNREFUSED, errno.ENOENT):
            return None
        raise LinkError(f"{entry.address}: cannot be reached: {error.strerror}") from None
    return connected


def _class_of(name: str, configuration: Mapping[str, Any]) -> type[FarComponent]:
    """A class of stand-ins with the parameters and sets that a component has."""
    body: dict[str, Any] = {one["name"]: _param(one) for one in configuration["parameters"]}
    sets: Mapping[str, Any] = configuration["sets"]
    body["configurations"] = {key: values for key, values in sets.items() if key != DEFAULT}
    body |= {"__module__": __name__, "__doc__": f"Stands for {name} of another kernel."}
    return type("FarComponent", (FarComponent,), body)


def _param(one: Mapping[str, Any]) -> Any:
    told = {"unit": one["unit"], "doc": one["doc"], "widget": one["widget"], "file": one.get("file", "")}
    try:
        kind = parse_type(one["type"])
    except ValueError:  # an Enum of the other kernel: its names
        return Param(str(one["default"]), choices=tuple(one["choices"] or ()) or None, **told)
    return Param(convert_value(one["default"], kind), type=kind, constraint=one["constraint"] or None, **told)
