"""Service ports that another kernel answers, and the stand-ins for their providers.

A required interface is bound to a provider that stands for the far one: each of its methods is a question to the other
kernel, with the seconds that are left. A goal is made at both ends; the client's goal follows the messages about the
provider's. The answering side is in `serving.py`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import (
    AiortsError,
    InterfaceMismatch,
    LinkError,
    LinkTimeout,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    StateError,
    WiringError,
)
from aiorts.kernel.component import Component
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import current_task
from aiorts.links.call_values import (
    DONE,
    ERRORS,
    GOAL,
    LONGEST_CALL,
    UNBOUND,
    frame_of,
    interface_text,
    plain,
    restored,
    values_of,
)
from aiorts.links.kernels import told
from aiorts.links.messages import Answer
from aiorts.model.links.negotiation import LINGER, PAUSES
from aiorts.model.names import Path
from aiorts.model.profile import ConnectorProfile
from aiorts.services import Goal, Provided, Relayed, Required, ServiceEnd, ServicePort, goal_types, seconds_left

if TYPE_CHECKING:
    from aiorts.kernel.loop.bus import Disconnected
    from aiorts.kernel.loop.timers import Cancellable
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller, Peer
    from aiorts.model.interface import Method
    from aiorts.services import GoalTypes

_LOG: Final = KernelLog()
_WITHIN: Final = 2.0
"""Seconds for an answer to a question that is no call."""
_AGAIN: Final = 1.0
"""Seconds until a kernel that did not answer is asked again."""
_LATER: Final = 1.0
"""Seconds after the deadline of a call in which a late answer is still awaited, and counted."""


class Calls:
    """The required interfaces of one kernel whose provider is in another one."""

    def __init__(self, links: Kernels) -> None:
        self._links = links
        self._new: list[FarProvider] = []
        """The providers whose connector is not made yet."""
        self._far: dict[FarProvider, None] = {}
        self._numbers = count(1)
        """The numbers of this kernel's calls, of all interfaces."""
        self.awaited: set[asyncio.Future[None]] = set()
        """Futures of other work on service ports: `connect` waits for them, too."""

    def handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """The questions that other kernels may ask, and their handlers."""
        return {"goal": self._goal_said}

    def report(self) -> dict[str, str]:
        """The state of each connector to a service of another kernel."""
        return {one.name: one.report() for one in self._far}

    def resolve(self, ports: Sequence[Any]) -> list[Any]:
        """The ports, with a stand-in provider in the place of each path.

        Raises:
            WiringError: the ports cannot be connected.
        """
        near = [one for one in ports if not isinstance(one, str)]
        where = " -> ".join(one if isinstance(one, str) else one.path for one in ports)
        ends = [end for one in near for end in (one.interfaces if isinstance(one, ServicePort) else (one,))]
        required = [end for end in ends if isinstance(end, Required)]
        if len(required) != len(ends):
            raise WiringError(f"{where}: connect from the kernel of the required port")
        for end in required:
            if plain_methods := [one.name for one in end.spec.methods.values() if one.plain]:
                raise WiringError(
                    f"{where}: {end.spec.name}.{plain_methods[0]} may not wait, and a call into another kernel does: "
                    "write `async def` in the interface"
                )
        found: list[Any] = []
        for one in ports:
            if not isinstance(one, str):
                found.append(one)
                continue
            path = Path.parse(one)
            if not path.port:
                raise WiringError(f"{one}: is a component; give one of its ports")
            far = [FarProvider(self._links, end, path, self._numbers) for end in required]
            found += [each.end for each in far]
            # The provider is bound when its connector is made: a connection refused earlier needs no binding.
            for each in far:
                self._new.append(each)
                self._links.kernel.loop.call_soon(self._begin, each)
        return found

    def relay(self, end: Provided[Any], path: Path) -> FarProvider:
        """A stand-in for an interface of another kernel, until `end_relay`; the caller binds the stand-in."""
        far = FarProvider(self._links, end, path, self._numbers)
        self._far[far] = None
        return far

    def end_relay(self, far: FarProvider) -> None:
        """Close a stand-in that `relay` made. Idempotent."""
        if self._far.pop(far, self) is None:
            far.close()

    def first_answers(self, connectors: Sequence[Any]) -> list[asyncio.Future[None]]:
        """Futures for the providers of these connectors: done when the other kernel has answered, or is not there."""
        found = []
        for far in tuple(self._new):
            self._begin(far)
            if any(one in connectors for one in far.end.connectors):
                found.append(far.first)
        return [*found, *self.awaited]

    def _begin(self, far: FarProvider) -> None:
        if far in self._new:
            self._new.remove(far)
            if far.end.connectors:
                self._far[far] = None
                self.look(far)

    def look(self, far: FarProvider) -> None:
        """Bind a provider, if its kernel is there."""
        if self._links.peer_of(far.path) is None:
            far.waits(self._links.reach.absent(far.path))
        else:
            self._links.run(far.bind(), f"aiorts bind {far.name}")

    def present(self, peer: Peer, up: bool) -> None:
        """Bind the providers of a kernel that has come, or unbind those of one that has gone."""
        for far in tuple(self._far):
            if up and self._links.peer_of(far.path) == peer:
                self.look(far)
            elif not up and far.peer == peer:
                far.lost(f"{peer.kernel} is gone")

    def come(self, component: str, peer: Peer | None) -> None:
        """Bind the providers of a component that has come to another kernel."""
        for far in self._far:
            if peer is not None and far.path.component == component and far.path.kernel == peer.kernel:
                self.look(far)

    def disconnected(self, event: Disconnected) -> None:
        """Close the providers that have no connector any more, after a connector has ended."""
        if isinstance(event.connector, ConnectorProfile):
            return  # a connector of data ports
        for far in [one for one in self._far if not one.in_use]:
            del self._far[far]
            far.close()

    def stopped(self) -> None:
        """Unbind all providers: the kernel ends."""
        for far in self._far:
            far.lost("this kernel ends")

    async def _goal_said(self, body: bytes, caller: Caller) -> bytes:
        number, what, value = values_of(body, (int, str, list))
        for far in tuple(self._far):
            if far.peer == caller.peer and far.advance(number, what, value):
                break
        return b""


class FarProvider:
    """Stands for a provided interface of another kernel, at the end of one service connector, or of many.

    Args:
        asking: the required interface that the stand-in answers; or a provided interface of this kernel, whose
            provider is `methods`, for any number of callers.
        numbers: the numbers of calls, shared by all providers of this kernel.
    """

    def __init__(self, links: Kernels, asking: ServiceEnd[Any], path: Path, numbers: Iterator[int]) -> None:
        self._links, self._asking, self.path, self._numbers = links, asking, path, numbers
        self.first: asyncio.Future[None] = links.kernel.loop.create_future()
        """Done with the first answer, or failed with its refusal."""
        self.peer: Peer | None = None
        """The kernel in which the provider is bound; None: there is none."""
        self._why = "not connected yet"
        self._over = False
        self._number = 0
        self._late = 0
        self._binding = self._again = False
        """Whether a question to bind the provider is under way, and whether another question must follow."""
        self._unheard: tuple[Peer, list[Any]] | None = None
        """The kernel that has not answered the question to bind the provider, and the names of the binding there."""
        self._timer: Cancellable | None = None
        self._changed: list[asyncio.Future[None]] = []
        self._goals: dict[int, tuple[Goal[Any, Any], GoalTypes]] = {}
        self.methods = SimpleNamespace(**{one.name: self._method(one) for one in asking.spec.methods.values()})
        """The methods that ask the other kernel, one for each of the interface."""
        self.end = asking if isinstance(asking, Provided) else self._provided()

    def _provided(self) -> Provided[Any]:
        """A provided interface that looks like the far one."""
        component = Component()
        cell(component).rename(str(replace(self.path, port="")))
        cell(component).kernel = self._links.kernel
        kind: Any = Provided[self._asking.interface]  # type: ignore[name-defined]
        declared = kind(self.methods, concurrent=True, always=True, cancel_timeout=LONGEST_CALL)
        end: Provided[Any] = component.add_port(self.path.port, declared)
        return end

    @property
    def _relays(self) -> bool:
        """Whether the provider answers many callers and needs no connector."""
        return self.end is self._asking

    @property
    def in_use(self) -> bool:
        """Whether the provider may be called."""
        return bool(self.end.connectors) if not self._relays else not self._over

    @property
    def name(self) -> str:
        """The name of the connector; for many callers, the path of the interface."""
        if self._relays:
            return self.end.path
        return next((one.name for one in self.end.connectors), f"{self._asking.path}-{self.end.path}")

    @property
    def _where(self) -> str:
        """The caller and the called port, for messages."""
        return self.end.path if self._relays else f"{self._asking.path} -> {self.end.path}"

    def report(self) -> str:
        """The provider's state, for tools."""
        late = f", {self._late} answers came too late" if self._late else ""
        return f"{'up' if self.peer is not None else f'down: {self._why}'}{late}"

    # -- being bound -----------------------------------------------------------------------------------------------

    async def bind(self) -> None:
        """Ask the other kernel to bind the provider; a refusal ends the connector."""
        peer = self._links.peer_of(self.path)
        if peer is None or self.peer == peer:
            return
        if self._binding:
            self._again = True  # the answer on its way may be older than the news that led here
            return
        self._binding, self._again = True, False
        self._stop_timer()
        required = str(self._links.path_of(self._asking.port, peer))
        names = [required, self._asking.instance, str(self.path)]
        body, self._unheard = frame_of([*names, interface_text(self._asking.spec)]), (peer, names)
        try:
            answer = Answer.from_bytes(await self._links.ask(peer, "bind", body, _WITHIN))
        except asyncio.CancelledError:
            self._answer(None)
            raise
        except LinkError as error:
            if self._over:
                self._unbind()
            return self._wait(_AGAIN, str(error))
        finally:
            self._binding = False
        self._unheard = None
        if answer.refused:
            return self._refused(answer.refused)
        if answer.absent:
            return self._wait(0.0 if self._again else LINGER, answer.absent)
        if self._over or self._links.peer_of(self.path) != peer:
            self._tell(peer, "unbind", [answer.number])
            return self._wait(0.0, f"{peer.kernel} is gone")
        if self.peer is not None:
            self.lost(f"{peer.kernel} was started anew")
        self.peer, self._number = peer, answer.number
        self._answer(None)
        self._wake()
        return None

    def _wait(self, seconds: float, why: str) -> None:
        """Note why the provider is not bound; try again after these seconds, or on news of its kernel or component."""
        if not self._over:
            self._stop_timer()
            self._timer = self._links.kernel.call_later(seconds, self._look_again)
            self.waits(why)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _look_again(self) -> None:
        self._timer = None
        if self.in_use and not self._links.kernel.closed:
            self._links.run(self.bind(), f"aiorts bind {self.name}")

    def waits(self, why: str) -> None:
        """Note why the provider cannot be bound yet; the first reason is logged."""
        self._why = why
        if not (self.first.done() or self._relays):
            _LOG.warning("W-LINK: %s: waits: %s", self.name, why)
        self._answer(None)

    def _refused(self, why: str) -> None:
        self._why = why
        _LOG.error("%s: refused by %s: %s", self.name, self.path.kernel, why)
        self._answer(WiringError(f"{self._where}: {why}"))
        for connector in self.end.connectors:
            self._links.kernel.connections.end(connector)

    def _answer(self, error: AiortsError | None) -> None:
        if not self.first.done():
            if error is None:
                self.first.set_result(None)
            else:
                self.first.set_exception(error)
                self.first.exception()  # a caller that did not wait has it in the log

    def lost(self, why: str) -> None:
        """Unbind the provider: its kernel is gone, or this kernel ends. Running goals fail."""
        self.peer, self._why = None, why
        goals, self._goals = self._goals, {}
        for goal, types in goals.values():
            _advance(goal, types, "failed", why)

    def close(self) -> None:
        """Close the provider for good: no call comes any more, and the other kernel unbinds it."""
        peer, self.peer, self._over = self.peer, None, True
        self._why = "was disconnected"
        self._stop_timer()
        self._wake()
        if self._links.kernel.closed:
            return
        if peer is not None:
            self._tell(peer, "unbind", [self._number])
        elif not self._binding:
            self._unbind()

    def _unbind(self) -> None:
        """Ask the other kernel to unbind the provider, which may be bound there although no answer came."""
        if self._unheard is not None:
            peer, names = self._unheard
            self._tell(peer, "unbind", [0, *names])

    def _wake(self) -> None:
        changed, self._changed = self._changed, []
        for one in changed:
            if not one.done():
                one.set_result(None)

    def _tell(self, peer: Peer, what: str, values: list[Any]) -> None:
        self._links.run(told(self._links, peer, what, frame_of(values)), f"aiorts {what}")

    # -- calls -----------------------------------------------------------------------------------------------------

    def _method(self, method: Method) -> Any:
        """The function for one method: it asks the other kernel."""
        types = goal_types(method.returns)

        async def call(*args: Any, **kwargs: Any) -> Any:
            return await self._call(method, types, args, kwargs)

        call.__name__ = method.name
        call.__signature__ = method.signature.replace(return_annotation=method.returns)  # type: ignore[attr-defined]
        call.__annotations__ = {
            one.name: one.annotation for one in method.parameters if one.annotation is not one.empty
        }
        if method.returns is not method.signature.empty:
            call.__annotations__["return"] = method.returns
        return call

    async def _call(
        self, method: Method, types: GoalTypes | None, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> Any:
        named = f"{self._where}.{method.name}"
        try:
            given = method.signature.bind(*args, **kwargs)
        except TypeError as error:
            raise Relayed(TypeError(f"{named}{method.signature}: {error}")) from None
        hints = {one.name: one.annotation for one in method.parameters}
        order = [one.name for one in method.parameters]
        try:
            in_order = [plain(hints[name], value) for name, value in zip(order, given.args, strict=False)]
            by_name = {name: plain(hints[name], value) for name, value in given.kwargs.items()}
        except InterfaceMismatch as error:
            raise Relayed(InterfaceMismatch(f"{named}: {error}")) from None
        pauses = iter(PAUSES)
        while True:
            asked = self.peer
            try:
                return await self._ask(method, types, named, in_order, by_name)
            except LinkTimeout as error:
                raise Relayed(ServiceTimeout(f"{named}: {error}")) from None
            except LinkError as error:
                # A kernel that is still there has no room for questions now, or refuses this one each time.
                pause = next(pauses, None) if asked is not None and self.peer == asked else 0.0
                if not method.idempotent or pause is None:
                    raise Relayed(ServiceUnavailable(f"{named}: {error}")) from None
                await asyncio.sleep(pause)
                await self._bound_again()

    async def _bound_again(self) -> None:
        """Wait until the provider is bound; the deadline of the call ends the wait."""
        if self.peer is None:
            changed: asyncio.Future[None] = self._links.kernel.loop.create_future()
            self._changed.append(changed)
            await changed
        if not self.in_use:
            raise Relayed(ServiceUnavailable(f"{self._where}: was disconnected"))

    async def _ask(
        self, method: Method, types: GoalTypes | None, named: str, args: list[Any], kwargs: dict[str, Any]
    ) -> Any:
        peer, seconds = self.peer, seconds_left(current_task())
        if peer is None:
            raise LinkError(self._why)
        number = next(self._numbers)
        try:
            body = frame_of([self._number, number, method.name, args, kwargs, float(max(seconds, 0.001))])
        except LinkError as error:
            raise Relayed(InterfaceMismatch(f"{named}: {error}")) from None
        asked = self._links.run(self._answer_of(peer, "call", body, seconds + _LATER), f"aiorts ask {method.name}")
        goal: Goal[Any, Any] | None = None
        if types is not None:
            goal = Goal()
            goal.on_cancel = partial(self._tell, peer, "cancel goal", [number])
            self._goals[number] = goal, types
        accepted = False
        try:
            answer = await asyncio.shield(asked)
            if isinstance(answer, LinkError):
                raise answer
            kind, values = values_of(answer, (str, list))
            if kind == GOAL and goal is not None:
                accepted = True
                return goal
        except asyncio.CancelledError:
            if not asked.done():
                asked.add_done_callback(self._answered_late)
                # The cancellation is sent once: if it is lost, the call ends by its deadline.
                self._links.run(self._answer_of(peer, "cancel", frame_of([number]), _WITHIN), "aiorts cancel")
            raise
        finally:
            if not accepted:
                self._goals.pop(number, None)
        value = values[0] if values else ""
        if kind == DONE and types is None:
            try:
                return restored(method.returns, value)
            except InterfaceMismatch as error:
                raise Relayed(InterfaceMismatch(f"{named}: {error}")) from None
        if kind == UNBOUND:
            self.lost("its component was removed")
            self._links.run(self.bind(), f"aiorts bind {self.name}")
            raise LinkError(self._why)
        raise Relayed(ERRORS.get(kind, ServiceFailed)(str(value)))

    async def _answer_of(self, peer: Peer, what: str, body: bytes, within: float) -> bytes | LinkError:
        try:
            return await self._links.ask(peer, what, body, within)
        except LinkError as error:
            return error

    def _answered_late(self, asked: asyncio.Task[bytes | LinkError]) -> None:
        if not asked.cancelled() and isinstance(asked.result(), bytes):
            self._late += 1

    def advance(self, number: int, what: str, value: list[Any]) -> bool:
        """Handle a message about a goal; False: this provider has no such goal."""
        if number not in self._goals or len(value) != 1:
            return False
        _advance(*self._goals[number], what, value[0])
        if what != "feedback":
            self._goals.pop(number, None)
        return True


def _advance(goal: Goal[Any, Any], types: GoalTypes, what: str, value: Any) -> None:
    """Repeat on the client's goal what happened to the provider's."""
    try:
        if what == "feedback":
            goal.feedback(restored(types.feedback, value))
        elif what == "succeeded":
            goal.succeed(restored(types.result, value))
        elif what == "cancelled" and goal.cancel_requested:
            goal.cancelled()
        else:
            goal.fail(str(value))
    except (StateError, InterfaceMismatch) as error:
        if goal.state in ("offered", "running"):
            goal.fail(error)
