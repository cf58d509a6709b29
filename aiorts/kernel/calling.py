"""A component of a function: when it is called, with what, and how its results leave.

A sample is taken from its port immediately before the call it takes part in, so what is not worked on yet stays in the
connector, in its ledger. What the function says of itself is read in `signature.py`; `function.py` makes the class.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import PortTypeError, RecordError
from aiorts.kernel.component import Component
from aiorts.kernel.hooks import HookKind
from aiorts.kernel.port import NOTHING
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.signature import Outlet, Plan

__all__ = ("FunctionComponent", "FunctionType", "hooks_of")

_FEW: Final = 64
"""Calls in one cycle where the connectors do not say how much is unread: pull, and those of a real-time thread."""
_PAUSE: Final = 0.001
"""Seconds that one with several in-ports lets its thread rest when there is nothing to do and no rate says when."""
_EMPTY: Final = inspect.Parameter.empty


class FunctionType(type):
    """The class of these classes: it says what the function is, and is pickled as function and options."""

    def __repr__(cls) -> str:
        plan: Plan | None = getattr(cls, "_rt_plan", None)
        if plan is None:
            return super().__repr__()
        ends = ", ".join(one.name for one in plan.inlets), ", ".join(one.name for one in plan.outlets)
        return f"<component type {cls.__module__}.{cls.__qualname__}({ends[0]}) -> {ends[1] or None}>"


class FunctionComponent(Component, metaclass=FunctionType):
    """What `component(function)` makes types of. Its ports and parameters are attributes: `adder0.a`, `adder0.output`.

    A plain function runs in any context; one that blocks belongs into a `ThreadContext`. An `async def` runs in every
    context but that.
    """

    function: ClassVar[Callable[..., Any]]
    """The function itself: `Adder.function(1.0, 2.0)` calls it as if there were no component."""
    _rt_plan: ClassVar[Plan]
    _rt_original: ClassVar[Callable[..., Any]]
    _rt_when: ClassVar[str] = "any"
    _rt_latest: ClassVar[bool] = False
    _rt_options: ClassVar[Mapping[str, Any]] = {}

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A port or a parameter."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        plan = self._rt_plan
        ports: Mapping[str, Any] = self.ports
        self._rt_ins: tuple[InPort[Any], ...] = tuple(ports[one.name] for one in plan.inlets)
        self._rt_outs: tuple[OutPort[Any], ...] = tuple(ports[one.name] for one in plan.outlets)
        self._rt_parts = tuple(zip(self._rt_ins, plan.inlets, range(len(self._rt_ins)), strict=True))
        sole = len(plan.outlets) == 1 and not plan.several
        self._rt_sole: tuple[Any, Any] = (self._rt_outs[0], plan.outlets[0]) if sole else (None, None)
        self._rt_last: list[Any] = [NOTHING] * len(plan.inlets)
        self._rt_stream: Any = None

    def on_activated(self) -> None:
        """Begin anew: no sample is known; a source, which was closed, starts from its beginning."""
        self._rt_last = [NOTHING] * len(self._rt_plan.inlets)
        if self._rt_plan.streams and not self._rt_ins:
            # In an event context nobody gives a source its cause to run; the first comes once it is active.
            self._rt_go_on()

    # -- when, and with what ---------------------------------------------------------------------------------------

    def _rt_settings(self) -> dict[str, Any]:
        """The parameters in force, which change between cycles only."""
        return {name: getattr(self, name) for name in self._rt_plan.params}

    def _rt_unread(self) -> int:
        """The calls that a cycle has room for: what arrives meanwhile is for the next, so that every cycle ends."""
        return sum(sum(connector.unread for connector in port.connectors) for port in self._rt_ins) or _FEW

    def _rt_calls(self) -> Iterator[tuple[list[Any], Any]]:
        """The calls of this cycle: arguments, and the time stamp of their newest sample.

        First it is asked whether there is a call, then its samples are taken: what has no partner stays unread.
        """
        parts, last = self._rt_parts, self._rt_last
        cycle, pairs = self._rt_when == "cycle" or not parts, self._rt_when == "all"
        latest = self._rt_latest or cycle
        if not latest and not pairs and len(parts) > 1:
            yield from self._rt_each()
            return
        for _ in range(1 if latest else self._rt_unread()):
            due = cycle
            for port, one, number in parts:
                if port.is_new:
                    due = True
                elif (pairs or last[number] is NOTHING) and one.default is _EMPTY:
                    return
            if not due:
                return
            for port, _, number in parts:
                if port.is_new:
                    last[number] = port.latest if latest else port.read_nowait()
            yield self._rt_arguments()

    def _rt_each(self) -> Iterator[tuple[list[Any], Any]]:
        """A call for each sample that was unread as the cycle began; the first one takes what it needs of each port."""
        parts, last = self._rt_parts, self._rt_last
        # Counted for each port, so that one whose samples are always the older ones does not keep the others waiting.
        left = [sum(c.unread for c in port.connectors) or (_FEW if port.is_new else 0) for port in self._rt_ins]
        ordered = all(one.stamped for one in self._rt_plan.inlets)
        while True:
            ready = [number for port, _, number in parts if left[number] and port.is_new]
            missing = {number for _, one, number in parts if last[number] is NOTHING and one.default is _EMPTY}
            if not ready or not missing.issubset(ready):
                return
            if not missing:
                ready = [min(ready, key=self._rt_oldest) if ordered and len(ready) > 1 else ready[0]]
            for number in ready:
                left[number] -= 1
                last[number] = self._rt_ins[number].read_nowait()
            yield self._rt_arguments()

    def _rt_oldest(self, number: int) -> int:
        """The time stamp of the next sample of a port that has one."""
        sample: Any = self._rt_ins[number].peek()
        return int(sample.tm)

    def _rt_arguments(self) -> tuple[list[Any], Any]:
        """The samples known last as arguments, and the time stamp of the newest."""
        arguments: list[Any] = []
        newest = None
        for _, one, number in self._rt_parts:
            sample = self._rt_last[number]
            if sample is NOTHING:
                arguments.append(one.default)
                continue
            arguments.append(sample.data if one.plain else sample if one.unwrap is None else one.unwrap(sample))
            if one.stamped and (newest is None or int(sample.tm) > newest):
                newest = int(sample.tm)
        return arguments, self.clock.time_ns() if newest is None else newest

    def _rt_samples(self, result: Any, tm: Any) -> Iterator[tuple[Any, Any]]:
        """Out-port and sample for each thing that the function gave; None is nothing."""
        if result is None:
            return
        outlets = self._rt_plan.outlets
        items = (result,)
        if self._rt_plan.several or not outlets:
            items = result if isinstance(result, tuple) and outlets else (result,)
            if len(items) != len(outlets):
                expected = f"{len(outlets)} results in a tuple" if outlets else "None"
                raise PortTypeError(f"{self.name}: {self._rt_plan.label} returned {result!r:.60}; expected {expected}")
        for port, one, item in zip(self._rt_outs, outlets, items, strict=True):
            if item is not None:
                yield port, self._rt_record(one, tm, item)

    def _rt_record(self, one: Outlet, tm: Any, item: Any) -> Any:
        """The sample for one result."""
        try:
            return item if one.record is None else one.record(tm, item)
        except RecordError as error:
            raise PortTypeError(
                f"{self.name}.{one.name}: {self._rt_plan.label} returned {item!r:.60}: {error}; nothing was sent"
            ) from error

    def _rt_go_on(self) -> None:
        """A source in an event context is its own cause: as fast as its readers take what it sends."""
        trigger = getattr(self.context, "trigger", None)
        if trigger is not None:
            self._rt_host.loop.call_soon(self._rt_trigger, trigger)

    def _rt_trigger(self, trigger: Callable[[Component], None]) -> None:
        if any(getattr(member.context, "trigger", None) == trigger for member in self._rt_members):
            trigger(self)

    # -- in a thread -----------------------------------------------------------------------------------------------

    def _rt_move(self, threaded: bool) -> None:
        if self._rt_plan.awaits:
            return
        own: dict[str, Any] = vars(self)
        if threaded:
            own["on_execute"] = self._rt_execute_in_thread
            own["_rt_hook_kinds"] = self._rt_hook_kinds | {"on_execute": HookKind.PLAIN}
        else:
            own.pop("on_execute", None)
            own.pop("_rt_hook_kinds", None)

    def _rt_execute_in_thread(self) -> None:
        """As the others, where waiting is blocking."""
        function, settings = self._rt_plan.function, self._rt_settings()
        if self._rt_plan.streams and not self._rt_ins:
            if self._rt_stream is None:
                self._rt_stream = iter(function(**settings))
            item = next(self._rt_stream, NOTHING)
            if item is NOTHING:
                self.finish()
            else:
                self._rt_send_blocking(item, self.clock.time_ns())
            return
        idle = bool(self._rt_ins)
        for arguments, tm in self._rt_calls():
            idle = False
            result = function(*arguments, **settings)
            for item in result if self._rt_plan.streams else (result,):
                self._rt_send_blocking(item, tm)
            if self._rt_host.stopping:
                break
        if idle and getattr(self.context, "rate", None) is None:
            self._rt_rest()

    def _rt_send_blocking(self, item: Any, tm: Any) -> None:
        for port, sample in self._rt_samples(item, tm):
            port.write_blocking(sample)

    def _rt_rest(self) -> None:
        """Nothing to do, and the thread would ask again at once: wait for data.

        A moment only with several in-ports, or where others share the thread; not while somebody wants a transition.
        """
        port, sole = self._rt_ins[0], len(self._rt_ins) == 1
        host, lock, context = self._rt_host, port._lock, self.context
        if lock is not None:
            until = None if sole and len(context._members) == 1 else host.deadline_ns(_PAUSE)
            with lock:
                host.wait_in_thread(
                    lock, lambda: (sole and port._unread()) or port._gone() or bool(context._actions), until
                )


# -- on a loop: the hook that a class has ------------------------------------------------------------------------------


async def _execute(self: FunctionComponent) -> None:
    """Call the function for what has arrived."""
    plan, settings = self._rt_plan, self._rt_settings()
    sole, outlet = self._rt_sole
    for arguments, tm in self._rt_calls():
        result = plan.function(*arguments, **settings)
        if plan.awaits:
            result = await result
        if sole is None:
            for port, sample in self._rt_samples(result, tm):
                await port.write(sample)
        elif result is not None:
            await sole.write(self._rt_record(outlet, tm, result))


async def _execute_one(self: FunctionComponent) -> None:
    """One in-port, at most one out-port, every sample: the common case, written out."""
    plan, settings = self._rt_plan, self._rt_settings()
    (port,), (inlet,), (out,), (outlet,) = self._rt_ins, plan.inlets, self._rt_outs, plan.outlets
    function, unwrap, record, stamped = plan.function, inlet.unwrap, outlet.record, inlet.stamped
    left, plain = self._rt_unread(), inlet.plain
    while left and port.is_new:
        left -= 1
        sample = port.read_nowait()
        argument = sample.data if plain else sample if unwrap is None else unwrap(sample)
        result = function(argument, **settings)
        if plan.awaits:
            result = await result
        if result is None:
            continue
        if record is not None:
            tm = sample.tm if stamped else self.clock.time_ns()
            try:
                result = record(tm, result)
            except RecordError:
                result = self._rt_record(outlet, tm, result)
        await out.write(result)


async def _execute_stream(self: FunctionComponent) -> None:
    """All results of each call, one after the other."""
    plan, settings = self._rt_plan, self._rt_settings()
    for arguments, tm in self._rt_calls():
        results = plan.function(*arguments, **settings)
        if plan.awaits:
            async for result in results:
                for port, sample in self._rt_samples(result, tm):
                    await port.write(sample)
        else:
            for result in results:
                for port, sample in self._rt_samples(result, tm):
                    await port.write(sample)


async def _execute_source(self: FunctionComponent) -> None:
    """The next result; after the last one it finishes."""
    plan = self._rt_plan
    if self._rt_stream is None:
        results = plan.function(**self._rt_settings())
        self._rt_stream = aiter(results) if plan.awaits else iter(results)
    result = await anext(self._rt_stream, NOTHING) if plan.awaits else next(self._rt_stream, NOTHING)
    if result is NOTHING:
        self.finish()
        return
    for port, sample in self._rt_samples(result, self.clock.time_ns()):
        await port.write(sample)
    self._rt_go_on()


async def _close(self: FunctionComponent) -> None:
    """A source that was not at its end is closed: its `finally` runs."""
    stream, self._rt_stream = self._rt_stream, None
    close = getattr(stream, "aclose", None)
    if close is not None:
        await close()
    elif (close := getattr(stream, "close", None)) is not None:
        close()


def _close_in_any(self: FunctionComponent) -> None:
    stream, self._rt_stream = self._rt_stream, None
    close = getattr(stream, "close", None)
    if close is not None:
        close()


def hooks_of(plan: Plan, when: str, latest: bool) -> dict[str, Callable[..., Any]]:
    """The hooks that fit a function."""
    if plan.streams and not plan.inlets:
        return {"on_execute": _execute_source, "on_deactivated": _close if plan.awaits else _close_in_any}
    if plan.streams:
        return {"on_execute": _execute_stream}
    simple = len(plan.inlets) == len(plan.outlets) == 1 and plan.inlets[0].default is _EMPTY and not plan.several
    return {"on_execute": _execute_one if simple and when != "cycle" and not latest else _execute}
