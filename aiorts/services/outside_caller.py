"""Calls from outside of all components: a tool's, which are let in, run and ended as any other.

The caller has a required interface of its own and no connector: it takes no place among those of the provider's port,
and is in no profile.
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
    """Calls the methods of one provided interface until `close`, which ends what still runs for it.

    Args:
        provided: live, of a component that a kernel has.
        name, port: of the caller, for messages and events; `name` may be the path of a component elsewhere.
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
        """What the method takes, with the types that are known."""
        return self._answer(method).signature

    def answers_with_goal(self, method: str) -> bool:
        """Whether what it returns is a goal."""
        return self._answer(method).goal is not None

    async def call(self, method: str, args: Sequence[Any], kwargs: Mapping[str, Any], timeout: float) -> Any:
        """The result of a call, which waits until it is let in; of a method with goals the goal.

        Raises:
            InterfaceMismatch: the arguments are not those of the method.
            ServiceError: it has no result; each reason has a class derived from this.
        """
        answer = self._answer(method)
        try:
            answer.signature.bind(*args, **kwargs)
        except TypeError as error:
            path = self._link.provided.path
            raise InterfaceMismatch(f"{path}.{method}{answer.signature}: {error}") from None
        return await ServiceCall(self._link, answer, tuple(args), dict(kwargs), timeout).result()

    def close(self) -> None:
        """End what still runs for it; idempotent."""
        if not self._connector.closed:
            self._connector._close()

    def _answer(self, method: str) -> Answer:
        return self._link.answers[method]
