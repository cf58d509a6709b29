"""Calls from outside of all components, such as a tool's; they wait, run and end as all other calls do.

The caller has a required interface of its own and no connector of a kernel: it counts for no limit of the provider's
port, and is in no profile.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts.errors import InterfaceMismatch
from aiorts.kernel.component import Component
from aiorts.kernel.execution.cell import cell
from aiorts.model.service_profile import ServiceConnectorProfile
from aiorts.services.service_call import ServiceCall
from aiorts.services.service_ends import Provided, Required
from aiorts.services.service_port import ServiceConnector
from aiorts.services.service_wiring import Link

if TYPE_CHECKING:
    import inspect
    from collections.abc import Mapping, Sequence

    from aiorts.services.service_wiring import Answer


class OutsideCaller:
    """Calls the methods of one provided interface until `close`, which ends the calls that still run.

    Args:
        provided: a live interface of a component in a kernel.
        name, port: the caller's names, for messages and events; `name` may be the path of a component elsewhere.
    """

    def __init__(self, provided: Provided[Any], name: str = "tool", port: str = "call") -> None:
        caller = Component()
        cell(caller).rename(name)
        required: Required[Any] = caller.add_port(port, Required[provided.interface]())  # type: ignore[name-defined]
        profile = ServiceConnectorProfile(f"{required.path}-{provided.path}", (required.path, provided.path))
        self._connector = ServiceConnector(profile, (required.port, provided.port))
        self._link = Link(required, provided, self._connector)
        self._connector.links = (self._link,)
        required._links += (self._link,)
        provided._links += (self._link,)

    def signature(self, method: str) -> inspect.Signature:
        """The signature of the method, with the types that are known."""
        return self._answer(method).signature

    def answers_with_goal(self, method: str) -> bool:
        """Whether the method returns a goal."""
        return self._answer(method).goal is not None

    async def call(self, method: str, args: Sequence[Any], kwargs: Mapping[str, Any], timeout: float) -> Any:
        """Call a method; returns its result, or the goal of a method with goals.

        Raises:
            InterfaceMismatch: the arguments are not those of the method.
            ServiceError: the call has no result; each reason has a derived class.
        """
        answer = self._answer(method)
        try:
            answer.signature.bind(*args, **kwargs)
        except TypeError as error:
            path = self._link.provided.path
            raise InterfaceMismatch(f"{path}.{method}{answer.signature}: {error}") from None
        return await ServiceCall(self._link, answer, tuple(args), dict(kwargs), timeout).result()

    def close(self) -> None:
        """End the calls that still run; idempotent."""
        if not self._connector.closed:
            self._connector._close()

    def _answer(self, method: str) -> Answer:
        return self._link.answers[method]
