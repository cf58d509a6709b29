"""Calls of this kernel's service ports by other kernels: an `OutsideCaller` makes each of them here.

A call is accepted, run and ended as any other. The task that serves a call with a goal stays the goal's client, and
tells the other kernel what becomes of the goal.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import (
    AiortsError,
    GoalCancelled,
    GoalFailed,
    InterfaceMismatch,
    LinkError,
    ServiceFailed,
    ServiceUnavailable,
    WiringError,
)
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports.port import check_room, is_removed
from aiorts.links.answering import refusal, sent
from aiorts.links.call_values import (
    DONE,
    ERRORS,
    GOAL,
    LONGEST_CALL,
    UNBOUND,
    frame_of,
    interface_difference,
    plain,
    restored,
    values_of,
)
from aiorts.links.kernels import told
from aiorts.links.messages import Answer
from aiorts.model.links import CALL
from aiorts.model.names import MAX_NAME_LENGTH, Path
from aiorts.services import Goal, OutsideCaller, Provided, ServicePort, goal_types

if TYPE_CHECKING:
    from aiorts.links.kernels import Kernels
    from aiorts.links.transport import Caller, Peer
    from aiorts.model.interface import Method
    from aiorts.services import GoalTypes

_LOG: Final = KernelLog()
_WITHIN: Final = 2.0
"""Seconds in which the client's kernel takes a message about a goal."""
_BY_ONE: Final = 5_000
"""The most interfaces that one other kernel may have bound at the same time."""
_BY_ALL: Final = 10_000
"""The most interfaces that all other kernels together may have bound at the same time."""


_Names: TypeAlias = "tuple[Peer | None, str, str, str]"
"""The kernel that has bound an interface, its required port and the name of the instance, and the provided port."""


class Serving:
    """The provided interfaces of one kernel to which required interfaces of other kernels are bound."""

    def __init__(self, links: Kernels) -> None:
        self._links = links
        self._bound: dict[Peer, dict[int, _Bound]] = {}
        """The bound interfaces, by the kernel that has bound them and their number."""
        self._numbers: dict[_Names, int] = {}
        """The number of each binding, by its names: a repeated request replaces the former binding."""
        self._at: Counter[ServicePort] = Counter()
        """The number of bindings at each port."""
        self._number = 0
        self._served: dict[tuple[Peer, int], asyncio.Task[Any]] = {}
        self._offered: dict[tuple[Peer, int], Goal[Any, Any]] = {}
        """Goals that clients in other kernels follow."""

    def handlers(self) -> Mapping[str, Callable[[bytes, Caller], Awaitable[bytes]]]:
        """The questions that other kernels may ask, and their handlers."""
        return {
            "bind": self._bind,
            "unbind": self._unbind,
            "call": self._call,
            "cancel": self._cancel,
            "cancel goal": self._cancel_goal,
        }

    def gone(self, peer: Peer) -> None:
        """End the bindings and calls of a kernel that has gone."""
        for number in tuple(self._bound.get(peer, ())):
            self._end(peer, number)
        for key, task in tuple(self._served.items()):
            if key[0] == peer:
                task.cancel()

    def stopped(self) -> None:
        """Close all bindings: the kernel ends."""
        for peer in tuple(self._bound):
            for bound in self._bound[peer].values():
                bound.close()

    async def _bind(self, body: bytes, caller: Caller) -> bytes:
        """Bind an interface of this kernel for another one."""
        required, instance, provided, text = values_of(body, (str, str, str, list))
        try:
            if len(instance) > MAX_NAME_LENGTH:
                raise WiringError(f"the name of an instance has {len(instance):,} letters")  # the name is kept
            found = self._links.there(Path.parse(provided), caller, CALL)
            if isinstance(found, Answer):
                return sent(found)
            end = self._fitting(found, text, instance, provided)
            names = (caller.peer, required, instance, provided)
            self._end(caller.peer, self._numbers.get(names, 0))
            if caller.peer is None or caller.peer.kernel not in self._links.reach.carried:
                # The binding of a carried kernel has a connector here, which is counted already.
                check_room(end.port, 1, end.port.max_connectors, self._at[end.port])
            peer = self._checked(caller)
            bound = _Bound(end, Path.parse(required), names)
        except WiringError as error:
            return refusal("to bind a service port", caller, error)
        self._number = self._numbers[names] = self._number % 0xFFFFFFFF + 1
        self._bound.setdefault(peer, {})[self._number] = bound
        self._at[end.port] += 1
        return sent(Answer(number=self._number))

    def _checked(self, caller: Caller) -> Peer:
        """The asking kernel, if it may bind one more. WiringError: no kernel asks, or it has bound too many."""
        if caller.peer is None:
            raise WiringError("who asks is no kernel")
        by = Counter[str]()
        for peer, those in self._bound.items():
            by[peer.kernel] += len(those)
        if by[caller.peer.kernel] >= _BY_ONE or by.total() >= _BY_ALL:
            raise WiringError(f"other kernels have bound {by.total():,} interfaces; no more are bound")
        return caller.peer

    def _fitting(self, port: Any, text: list[Any], instance: str, path: str) -> Provided[Any]:
        if not isinstance(port, ServicePort):
            raise WiringError(f"{path}: is no service port")
        ends = [end for end in port.interfaces if isinstance(end, Provided)]
        if not ends:
            raise WiringError(f"{path}: provides nothing")
        wrong = {end: interface_difference(text, end.spec) for end in ends}
        fitting = [end for end in ends if not wrong[end]]
        if not fitting:
            raise WiringError("; ".join(f"{end.path} provides {end.spec.name}: {wrong[end]}" for end in ends))
        if len(fitting) == 1:
            return fitting[0]
        same = [end for end in fitting if end.instance == instance]
        if len(same) == 1:
            return same[0]
        raise WiringError(f"{', '.join(end.path for end in fitting)} all provide that; give one the name {instance!r}")

    async def _unbind(self, body: bytes, caller: Caller) -> bytes:
        try:
            (number,) = values_of(body, (int,))
        except LinkError:  # the answer with its number was lost
            _, required, instance, provided = values_of(body, (int, str, str, str))
            number = self._numbers.get((caller.peer, required, instance, provided), 0)
        self._end(caller.peer, number)
        return b""

    def _end(self, peer: Peer | None, number: int) -> None:
        """End a binding, if it is there."""
        those = {} if peer is None else self._bound.get(peer, {})
        if peer is None or (bound := those.pop(number, None)) is None:
            return
        del self._numbers[bound.names]
        if not those:
            del self._bound[peer]
        self._at[bound.end.port] -= 1
        if not self._at[bound.end.port]:
            del self._at[bound.end.port]
        bound.close()

    async def _call(self, body: bytes, caller: Caller) -> bytes:
        number, call, method, args, kwargs, seconds = values_of(body, (int, int, str, list, dict, float))
        bound = None if caller.peer is None else self._bound.get(caller.peer, {}).get(number)
        if caller.peer is None or bound is None or is_removed(bound.end.port):
            return frame_of([UNBOUND, []])
        if not 0 < seconds <= LONGEST_CALL or method not in bound.end.spec.methods:
            raise LinkError(f"no call: {method[:60]!r} within {seconds} s")
        key = caller.peer, call
        if key in self._served:
            raise LinkError(f"the call {call} is being served already")
        answer: asyncio.Future[bytes] = self._links.kernel.loop.create_future()
        task = self._links.run(self._serve(key, bound, method, args, kwargs, seconds, answer), f"aiorts call {method}")
        self._served[key] = task
        task.add_done_callback(partial(self._served_done, key, answer))
        return await answer

    def _served_done(self, key: tuple[Peer, int], answer: asyncio.Future[bytes], _task: object) -> None:
        self._served.pop(key, None)
        self._offered.pop(key, None)
        if not answer.done():
            answer.set_result(frame_of([ServiceUnavailable.__name__, ["the call was cancelled"]]))

    async def _serve(
        self,
        key: tuple[Peer, int],
        bound: _Bound,
        name: str,
        args: list[Any],
        kwargs: dict[str, Any],
        seconds: float,
        answer: asyncio.Future[bytes],
    ) -> None:
        """Make the call; if the answer is a goal, the task stays the goal's client."""
        method = bound.end.spec.methods[name]
        types = goal_types(method.returns)
        try:
            value = await bound.call(method, args, kwargs, seconds)
            found = [GOAL, []] if types is not None else [DONE, [plain(method.returns, value)]]
            frame = frame_of(found)
        except AiortsError as error:
            if isinstance(error, ServiceUnavailable) and (is_removed(bound.end.port) or self._links.kernel.closed):
                answer.set_result(frame_of([UNBOUND, []]))
                return
            other = InterfaceMismatch if isinstance(error, LinkError) else ServiceFailed
            kind = next((one for one in ERRORS if isinstance(error, ERRORS[one])), other.__name__)
            answer.set_result(frame_of([kind, [str(error)[:2_000]]]))
            return
        answer.set_result(frame)
        if types is not None:
            self._offered[key] = value
            await self._follow(key, value, types)

    async def _follow(self, key: tuple[Peer, int], goal: Goal[Any, Any], types: GoalTypes) -> None:
        peer, call = key
        try:
            async for feedback in goal:
                said = frame_of([call, "feedback", [plain(types.feedback, feedback)]])
                await self._links.ask(peer, "goal", said, _WITHIN)
            try:
                last = frame_of([call, "succeeded", [plain(types.result, await goal.result())]])
            except GoalCancelled:
                last = frame_of([call, "cancelled", [None]])
            except GoalFailed as error:
                last = frame_of([call, "failed", [str(error)[:2_000]]])
        except (LinkError, InterfaceMismatch) as error:
            _LOG.warning("W-LINK: a goal of %s cannot be followed: %s", peer.kernel, error)
            goal.cancel()
            last = frame_of([call, "failed", [str(error)[:2_000]]])
        await told(self._links, peer, "goal", last)

    async def _cancel(self, body: bytes, caller: Caller) -> bytes:
        (call,) = values_of(body, (int,))
        if caller.peer is not None and (task := self._served.get((caller.peer, call))) is not None:
            task.cancel()
        return b""

    async def _cancel_goal(self, body: bytes, caller: Caller) -> bytes:
        (call,) = values_of(body, (int,))
        if caller.peer is not None and (goal := self._offered.get((caller.peer, call))) is not None:
            goal.cancel()
        return b""


class _Bound:
    """A provided interface of this kernel, bound to a required interface of another kernel."""

    def __init__(self, end: Provided[Any], required: Path, names: _Names) -> None:
        self.end, self.names = end, names
        component = f"{required.kernel}/{required.component}" if required.kernel else required.component
        self._caller = OutsideCaller(end, component, required.port or "call")

    async def call(self, method: Method, args: list[Any], kwargs: dict[str, Any], seconds: float) -> Any:
        """The result of the method. ServiceError: the call failed."""
        hints = {one.name: one.annotation for one in method.parameters}
        in_order = [one.annotation for one in method.parameters if one.kind is not one.KEYWORD_ONLY]
        if len(args) > len(in_order) or not kwargs.keys() <= hints.keys():
            raise InterfaceMismatch(f"{self.end.path}.{method.name}: takes no such arguments")
        given = [restored(hint, value) for hint, value in zip(in_order, args, strict=False)]
        named = {name: restored(hints[name], value) for name, value in kwargs.items()}
        return await self._caller.call(method.name, given, named, seconds)

    def close(self) -> None:
        """End the calls that still run over this binding."""
        self._caller.close()
