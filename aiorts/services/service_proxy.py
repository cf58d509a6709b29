"""The proxy that a caller holds, and the end of each call: its refusal, the report of its failure, its counts.

A provider's plain method runs here, within the caller's own step, when no other activity is in the way; all other calls
wait, as `service_call.py` says.
"""

from __future__ import annotations

import asyncio
from types import CoroutineType
from typing import TYPE_CHECKING, Any, TypeAlias

from aiorts.errors import (
    InterfaceMismatch,
    ServiceCycle,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
    ThreadError,
)
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.member import Visit
from aiorts.kernel.loop.bus import CallFailed, ServiceCalled
from aiorts.kernel.loop.origins import located
from aiorts.kernel.loop.tasks import current_task
from aiorts.model.interface import misfit
from aiorts.model.values import shown
from aiorts.services.activities import holder_of
from aiorts.services.goal_keeper import answer_offer
from aiorts.services.service_arguments import goal_types
from aiorts.services.tallies import count_in

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.services.service_ends import Required
    from aiorts.services.service_wiring import Answer, Link

Outcome: TypeAlias = tuple[Any, BaseException | None]


class Relayed(Exception):
    """Raised by the stand-in of a provider elsewhere: the caller gets the contained error, not ServiceFailed."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(error)
        self.error = error


class _Proxy:
    """Stands for the provider; its attributes are the methods of the interface."""

    def __init__(self, path: str) -> None:
        self._path = path

    def __repr__(self) -> str:
        return f"<proxy of {self._path}>"


def make_proxy(required: Required[Any], only: Link | None, seconds: float) -> Any:
    """The proxy of the provider that `required` is bound to at the time of a call, or of the provider of one link."""
    proxy = _Proxy(required.path)
    for name, method in required.spec.methods.items():
        call = _plain(required, only, name, seconds) if method.plain else _awaited(required, only, name, seconds)
        call.__name__ = name
        call.__doc__ = method.doc
        setattr(proxy, name, call)
    return proxy


def _awaited(required: Required[Any], only: Link | None, name: str, seconds: float) -> Any:
    async def call(*args: Any, **kwargs: Any) -> Any:
        link = only or required._sole
        if link is None or link.closed:
            raise not_bound(required, name)
        kernel = link.kernel
        if not kernel.on_loop_thread():
            raise ThreadError(
                f"{link.named(name)}: awaited outside of the kernel's loop; in the thread of a ThreadContext use "
                "call_blocking, a real-time hook must not wait"
            )
        answer = link.answers[name]
        if answer.plain and not link.threaded:
            provided = link.provided
            if provided.concurrent or link.entry_lock.open:
                return run_plain(link, answer, args, kwargs)
        from aiorts.services.service_call import ServiceCall

        return await ServiceCall(link, answer, args, kwargs, seconds).result()

    return call


def _plain(required: Required[Any], only: Link | None, name: str, seconds: float) -> Any:
    def call(*args: Any, **kwargs: Any) -> Any:
        link = only or required._sole
        if link is None or link.closed:
            raise not_bound(required, name)
        if not link.kernel.on_loop_thread():
            from aiorts.services.service_thread import call_plain

            return call_plain(link, name, args, kwargs, seconds)
        answer = link.answers[name]
        if link.threaded or not (link.provided.concurrent or link.entry_lock.open):
            busy = ServiceUnavailable(
                f"{link.named(name)}: {link.provided.path.partition('.')[0]} is busy"
                f"{inside(link.component)}; a plain method does not wait: write `async def` in {required.spec.name}, "
                "or concurrent=True at the provider"
            )
            settle(link, answer, link.kernel.clock.monotonic_ns(), None, busy)
        return run_plain(link, answer, args, kwargs)

    return call


def not_bound(required: Required[Any], name: str) -> ServiceUnavailable:
    """The error of a call that has no provider."""
    required._tally.add(0, "refused")
    if goal_types(required.spec.methods[name].returns) is not None:
        count_in((required._tally,), "offered")
    return ServiceUnavailable(f"{required.path}.{name}: is not connected; connect it, or await wait_bound()")


def inside(component: Component) -> str:
    holder = holder_of(component)
    return "" if holder is None else f" in {holder.where}"


# -- the answer ----------------------------------------------------------------------------------------------------


def run_plain(link: Link, answer: Answer, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Call a provider's plain method, in the caller's own step."""
    now_ns = link.now_ns
    begun_ns = now_ns()
    reason = link.provided._refusal
    if reason:
        unavailable = ServiceUnavailable(f"{link.named(answer.name)}: {reason}")
        settle(link, answer, begun_ns, None, unavailable)
    look = answer.look
    if look is not None and (wrong := look(args, kwargs)):
        settle(link, answer, begun_ns, None, wrong_argument(link, answer, wrong, args, kwargs))
    lock = None if link.provided.concurrent else link.entry_lock
    if lock is not None:
        lock.inside = answer.visit
    value, error = run_in_step(answer, answer.visit, args, kwargs)
    if lock is not None:
        lock.inside = None
        if lock.waiting:
            lock.pass_on()
    return settle(link, answer, begun_ns, value, None if error is None else failed(link, answer, args, kwargs, error))


def run_in_step(answer: Answer, visit: Visit, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Outcome:
    """Run a plain method in the task of the caller; tasks that it starts belong to its own component."""
    task: Any = current_task()
    value = error = None
    before: tuple[Any, Any] = (None, None)
    if task is not None:
        before = getattr(task, "_aiorts_component", None), getattr(task, "_aiorts_visit", None)
        task._aiorts_component, task._aiorts_visit = visit.component, visit
    try:
        value = answer.function(*args, **kwargs)
    except BaseException as raised:  # noqa: BLE001 - the border round a provider's method
        error = raised
    if task is not None:
        task._aiorts_component, task._aiorts_visit = before
    return value, error


def failed(
    link: Link, answer: Answer, args: tuple[Any, ...], kwargs: dict[str, Any], error: BaseException | None
) -> BaseException | None:
    """The caller's error for an error of a provider's method."""
    if error is None:
        return None
    if issubclass(type(error), Relayed):  # the `__class__` of a hostile error may lie
        relayed: BaseException = error.error  # type: ignore[attr-defined]
        return relayed
    if issubclass(type(error), GeneratorExit) and asyncio._get_running_loop() is None:
        raise error  # the loop is gone, and this call with it
    if issubclass(type(error), TypeError):
        try:
            answer.signature.bind(*args, **kwargs)
        except TypeError as wrong:
            return TypeError(f"{link.named(answer.name)}{answer.signature}: {wrong}")
    if issubclass(type(error), KeyboardInterrupt):
        link.kernel.pass_on_interrupt(error)
    failure = ServiceFailed(f"{link.named(answer.name)}: raised {located(error)}")
    failure.__cause__ = error
    if link.provided.failure == "error":
        for member in tuple(cell(link.component).members):
            member.context.runner.life.task_failed(member, error)
    return failure


def settle(link: Link, answer: Answer, begun_ns: int, value: Any, error: BaseException | None) -> Any:
    """End a call: check its result, count it, notify observers; returns the result, or raises the error."""
    if error is None:
        check = answer.check
        if (check is not None and not check(value)) or value.__class__ is CoroutineType:
            error = _mismatch(link, answer, value)
    if answer.goal is not None:
        error = answer_offer(link, answer.name, answer.goal, value, error)
    elapsed_ns = link.now_ns() - begun_ns
    bus = link.kernel.bus
    if error is None:
        link.tally.add(elapsed_ns)
        if link.closed:
            _count_late(link, elapsed_ns)
        if bus.calls_wanted:
            bus.publish(ServiceCalled(link.required.path, link.provided.path, answer.name, elapsed_ns, None))
        return value
    outcome = _OUTCOMES.get(type(error), "failures")
    link.tally.add(elapsed_ns, outcome)
    if link.closed:
        _count_late(link, elapsed_ns, outcome)
    if bus.calls_wanted:
        bus.publish(ServiceCalled(link.required.path, link.provided.path, answer.name, elapsed_ns, error))
    if outcome in ("failures", "timeouts"):
        bus.publish(CallFailed(link.required.path, link.provided.path, answer.name, error))
    try:
        raise error
    finally:
        del error  # its traceback refers to this frame, and the frame to it


def _count_late(link: Link, elapsed_ns: int, outcome: str = "") -> None:
    """Count a late call at the ends, which took over the counts of their link when it ended."""
    link.required._tally.add(elapsed_ns, outcome)
    link.provided._tally.add(elapsed_ns, outcome)


_OUTCOMES = {
    ServiceTimeout: "timeouts",
    ServiceUnavailable: "refused",
    ServiceCycle: "refused",
    asyncio.CancelledError: "cancelled",
    TypeError: "refused",
}


def wrong_argument(
    link: Link, answer: Answer, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]
) -> InterfaceMismatch:
    """The error of a call in which this argument has another type than the interface says."""
    parameters = answer.signature.parameters
    given = kwargs[name] if name in kwargs else args[list(parameters).index(name)]
    place, value = misfit(parameters[name].annotation, given)
    return InterfaceMismatch(
        f"{link.named(answer.name)}: {link.required.path} gave {name}{place} = {type(value).__name__} {shown(value)}, "
        f"the interface takes {answer.takes(name)}"
    )


def _mismatch(link: Link, answer: Answer, value: object) -> InterfaceMismatch:
    if isinstance(value, CoroutineType):
        value.close()
        return InterfaceMismatch(
            f"{link.named(answer.name)}: {link.provided.path} answered with a coroutine; write `async def`"
        )
    place, what = misfit(answer.hint, value)
    inside = f", in which {place} is {type(what).__name__} {shown(what)}" if place else ""
    return InterfaceMismatch(
        f"{link.named(answer.name)}: {link.provided.path} answered with {type(value).__name__} {shown(value)}{inside}, "
        f"{link.required.path} takes {answer.returns}"
    )
