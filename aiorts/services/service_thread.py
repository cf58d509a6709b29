"""Calls with a thread at one end: a provider that runs in a thread, or a caller whose thread blocks for the answer.

A provider in a thread answers between two of its cycles, in that thread, as it carries out transitions; a real-time
thread does, too. A caller's thread blocks as it does at a port; its request is carried out on the kernel's loop.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from aiorts.errors import ClosedError, ServiceUnavailable, StateError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call, Steps
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.loop.blocking import PortLock
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.services.service_ends import Required
from aiorts.services.service_port import ServiceEnd, ServicePort

if TYPE_CHECKING:
    from aiorts.kernel.execution.member import Member
    from aiorts.services.service_call import ServiceCall
    from aiorts.services.service_wiring import Link


# -- a provider in a thread --------------------------------------------------------------------------------------------


def serve_in_thread(call: ServiceCall) -> None:
    """Serve the call between two cycles of the provider's thread; if that is impossible, the reply says so."""
    link, name = call.link, call.link.named(call.answer.name)
    if not call.answer.plain:
        call.conclude(
            None,
            ServiceUnavailable(
                f"{name}: is `async def`, and {call.component.name} runs in a thread; write `def` there, or declare it "
                "concurrent=True: it then runs on the loop"
            ),
        )
        return
    member = cell(call.component).members[0]

    def stopped(error: BaseException | None) -> None:
        failure = ServiceUnavailable(f"{name}: {member.context.name} has stopped") if error is not None else None
        link.kernel.call_on_loop(lambda: call.conclude(None, failure))

    member.context.runner.submit(Action(lambda: _steps(call, member), stopped))


def _steps(call: ServiceCall, member: Member) -> Steps:
    """Serve the call in the thread, as one of its hooks."""
    if call.reply_done:
        return
    reason = call.link.provided._refusal
    outcome: list[tuple[Any, BaseException | None]] = []
    if not reason:
        member.hooks[call.hook] = HookKind.PLAIN, _serve
        call.runs = True
        yield Call(member, call.hook, (call, outcome))
        call.runs = False
    if not outcome:
        why = reason or "its thread was abandoned"
        failure = ServiceUnavailable(f"{call.link.named(call.answer.name)}: {why}")
        call.link.kernel.call_on_loop(lambda: call.conclude(None, failure))
    else:
        call.link.kernel.call_on_loop(lambda: call._ended(*outcome[0]))


def _serve(call: ServiceCall, outcome: list[tuple[Any, BaseException | None]]) -> None:
    """Run the method itself; its failure goes to the caller, and is no failure of the hook."""
    value = error = None
    try:
        value = call.answer.function(*call.args, **call.kwargs)
    except BaseException as raised:  # noqa: BLE001 - the border round a provider's method
        error = raised
    outcome.append((value, error))


# -- a caller in a thread ----------------------------------------------------------------------------------------------


def call_blocking(required: Required[Any], ask: Callable[[Any], Awaitable[Any]], seconds: float) -> Any:
    """See `Required.call_blocking`."""

    async def on_loop() -> Any:
        return await ask(required.within(seconds))

    return _blocked(required, on_loop)


def call_plain(link: Link, name: str, args: tuple[Any, ...], kwargs: dict[str, Any], seconds: float) -> Any:
    """Call a plain method of the interface from a thread, which may block for the answer."""
    from aiorts.services.service_call import ServiceCall

    async def on_loop() -> Any:
        return await ServiceCall(link, link.answers[name], args, kwargs, seconds).result()

    return _blocked(link.required, on_loop)


class _Blocked:
    """The answer that one thread waits for. Its state changes with the lock held."""

    def __init__(self) -> None:
        self.lock = PortLock()
        self.done = False
        self.value: Any = None
        self.error: BaseException | None = None
        self.task: asyncio.Task[None] | None = None

    def wake(self, value: Any, error: BaseException | None) -> None:
        """Wake the thread with an outcome, or because the thread has to stop waiting: the first call counts."""
        with self.lock:
            if not self.done:
                self.value, self.error, self.done = value, error, True
                self.lock.notify_all()


def _blocked(required: Required[Any], ask: Callable[[], Awaitable[Any]]) -> Any:
    """Run `ask` on the loop and block this thread until it is done."""
    component = required.port._component
    host = cell(component)
    member: Any = cell(component).entry_lock.inside
    if host.realtime or host.blocking is None or host.thread_id != threading.get_ident() or member is None:
        raise StateError(f"{required.path}: only a hook of a ThreadContext may block for an answer, in its own thread")
    kernel = component.kernel
    blocked = _Blocked()

    async def run() -> None:
        value = None
        error: BaseException | None = None
        try:
            value = await ask()
        except BaseException as raised:  # noqa: BLE001 - it goes on to the thread that waits for it
            error = raised
        # A CancelledError of the loop means nothing to a thread.
        cancelled = issubclass(type(error), asyncio.CancelledError)
        blocked.wake(value, _given_up(required) if cancelled else error)

    def begin() -> None:
        if blocked.done:
            return
        task: Any = kernel_task(kernel.loop, run(), f"aiorts {component.name} calls {required.path}")
        blocked.task = task
        task._aiorts_component = component
        task._aiorts_visit = member
        kernel.registry.adopt(component, task)

    required._blocked.add(blocked)
    kernel.loop.call_soon_threadsafe(begin)
    if host.stopping:
        blocked.wake(None, _given_up(required))
    try:
        host.wait_in_thread(blocked.lock, lambda: blocked.done, None)
    finally:
        required._blocked.discard(blocked)
    if blocked.error is not None:
        raise blocked.error
    return blocked.value


def give_up_waiting(port: ServicePort) -> None:
    """End the waiting of a thread that is to stop: calls of its hooks through this port end with ClosedError."""
    for end in port.interfaces:
        for blocked in tuple(end._blocked):
            blocked.wake(None, _given_up(end))
            if blocked.task is not None:
                blocked.task.cancel()


def _given_up(end: ServiceEnd[Any]) -> ClosedError:
    return ClosedError(f"{end.path}: its context or kernel stops; the call was given up")
