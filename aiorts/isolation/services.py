"""The service ports of a component that runs in a process of its own.

Its stand-in answers here for the interfaces that it provides: any number of components of this kernel are connected
with the stand-in as with any other component. An interface that it requires is bound in the process with the provider
that is connected here.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import DeclarationError, ProcessError, WiringError
from aiorts.links import Links
from aiorts.model.names import Path
from aiorts.services import Provided, Required, ServiceEnd, ServicePort

if TYPE_CHECKING:
    from aiorts.isolation.process import Process
    from aiorts.isolation.stand_in import RemoteComponent
    from aiorts.links import FarProvider

_ANSWERS: Final = "_answers_of_"
_LONGEST: Final = 86_400.0
"""Seconds that a goal has here to be cancelled: how long it may take is decided in the process."""


def remote_end(owner: str, attribute: str, end: ServiceEnd[Any]) -> ServiceEnd[Any]:
    """The interface that a stand-in declares for an interface of the original class.

    Raises:
        DeclarationError: a method of the interface may not wait, and a call into another process does.
    """
    for method in end.spec.methods.values():
        if method.plain:
            raise DeclarationError(
                f"{owner}.{attribute}: {end.spec.name}.{method.name} may not wait, and a call into another process "
                "does: write `async def` in the interface"
            )
    alike = copy.copy(end)
    if isinstance(alike, Provided):  # one call at a time, when, and what a failure does: that is decided in the process
        alike.provider, alike.concurrent, alike.always, alike.failure = _ANSWERS + attribute, True, True, "reply"
        alike.cancel_timeout = _LONGEST
    return alike


class RemoteServices:
    """The interfaces of one isolated component."""

    def __init__(self, component: RemoteComponent) -> None:
        self._component = component
        self._links = component.kernel.service(Links)
        ends = [end for port in component.ports.values() if isinstance(port, ServicePort) for end in port.interfaces]
        self._provided = [end for end in ends if isinstance(end, Provided)]
        self._required = [end for end in ends if isinstance(end, Required)]
        self._relays: list[FarProvider] = []
        self._bound: dict[tuple[str, str], str] = {}
        """The connectors in the process, by caller and provider."""
        self._turn = asyncio.Lock()

    async def begin(self, process: Process) -> None:
        """Handle the making of the component in this process, which may differ from the former one."""
        self._bound.clear()
        for end in () if self._relays else self._provided:
            far = self._links.calls.relay(end, replace(Path.parse(end.port.path), kernel=process.kernel))
            setattr(self._component, str(end.provider), far.methods)
            self._relays.append(far)
        for far in self._relays:
            await far.bind()
        await self.bind(process)

    def end(self) -> None:
        """Close the stand-ins of providers: the component is removed."""
        for far in self._relays:
            self._links.calls.end_relay(far)

    async def bind(self, process: Process) -> None:
        """Bind the required interfaces in the process with the providers that are connected here, and with no others.

        Raises:
            WiringError: a provider here cannot be reached from there.
        """
        async with self._turn:
            wanted = dict(self._wanted())
            try:
                for pair in self._bound.keys() - wanted.keys():
                    await process.ask("disconnect", names=[self._bound.pop(pair)])
                for pair in wanted.keys() - self._bound.keys():
                    required, provided = pair[0], wanted[pair]
                    self._bound[pair] = await process.ask("bind", required=required, provided=provided)
            except ProcessError:
                return  # it has ended: they are bound in the one that is started in its place

    def _wanted(self) -> Iterator[tuple[tuple[str, str], str]]:
        """The caller, the provider, and the path by which the process knows it."""
        for end in self._required:
            for link in [link for connector in end.connectors for link in connector.links if link.required is end]:
                path = link.provided.path
                if "/" in path:
                    raise WiringError(
                        f"{end.path} -> {path}: {self._component.name} runs in a process of its own, which reaches "
                        f"components of its own kernel alone; put one of those between, which calls {path}"
                    )
                yield (end.path, path), str(self._links.path_of(link.provided.port))
