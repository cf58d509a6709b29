"""The component of a function: decides when the function is called, with which samples, and sends its results.

A sample is read from its port immediately before its call, so that waiting samples stay in the connector and its
ledger. `signature.py` reads the function's declaration; `function.py` makes the class.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import PortTypeError, RecordError
from aiorts.functions.signature import Outlet, Plan
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import Kind, declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.connector import unread_at
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.port import NOTHING

_FEW: Final = 64
"""Calls in one cycle when the connectors do not count unread samples: pull, and those of a real-time thread."""
_PAUSE: Final = 0.001
"""Seconds that a component with several in-ports lets its thread rest when idle and without a rate."""
_EMPTY: Final = inspect.Parameter.empty


class FunctionKind(Kind):
    """Describes a function as a component, and runs it in a thread."""

    def __init__(self, plan: Plan, original: Callable[..., Any], options: Mapping[str, Any]) -> None:
        self.plan = plan
        self.original = original
        """The function that `component(...)` was given."""
        self.options = options
        """The options of `component(...)`: `when`, `latest`, `output`, `hints`, `name`."""

    def moved(self, component: FunctionComponent, *, threaded: bool) -> None:
        if self.plan.awaits:
            return
        here, own = cell(component), vars(component)
        here.hook_kinds = declarations(type(component)).hook_kinds
        if threaded:
            own["on_execute"] = partial(_execute_in_thread, component)
            here.hook_kinds = here.hook_kinds | {"on_execute": HookKind.PLAIN}
        else:
            own.pop("on_execute", None)


def kind_of(cls: type[Any]) -> FunctionKind | None:
    """The description of the function of a component class; None if the class is not made of a function."""
    return next((kind for kind in declarations(cls).kinds if isinstance(kind, FunctionKind)), None)


class FunctionType(type):
    """The metaclass of function components: describes the function, and pickles a class as function and options."""

    def __repr__(cls) -> str:
        kind = kind_of(cls)
        if kind is None:
            return super().__repr__()
        ends = ", ".join(one.name for one in kind.plan.inlets), ", ".join(one.name for one in kind.plan.outlets)
        return f"<component type {cls.__module__}.{cls.__qualname__}({ends[0]}) -> {ends[1] or None}>"


class FunctionComponent(Component, metaclass=FunctionType):
    """The base of the types that `component(function)` makes. Ports and parameters are attributes: `adder0.a`.

    A plain function runs in any context; one that blocks belongs into a `ThreadContext`. An `async def` runs in every
    context but that.
    """

    function: ClassVar[Callable[..., Any]]
    """The function itself: `Adder.function(1.0, 2.0)` calls it without a component."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A port or a parameter by its name."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        if (kind := kind_of(type(self))) is not None:
            cell(self).own = {**cell(self).own, Calls: Calls(kind, self.ports)}

    def on_activated(self) -> None:
        """Forget all samples, and restart a source from its beginning."""
        calls: Calls = cell(self).own[Calls]
        calls.last = [NOTHING] * len(calls.ins)
        if calls.plan.streams and not calls.ins:
            # In an event context a source has no cause to run; its activation gives it the first.
            _go_on(self)


class Calls:
    """The function of one component, its ports, and the samples that it knows."""

    __slots__ = ("ins", "last", "latest", "outs", "parts", "plan", "sole", "stream", "when")

    def __init__(self, kind: FunctionKind, ports: Mapping[str, Any]) -> None:
        self.plan = plan = kind.plan
        self.when: str = kind.options["when"]
        self.latest: bool = kind.options["latest"]
        self.ins: tuple[InPort[Any], ...] = tuple(ports[one.name] for one in plan.inlets)
        self.outs: tuple[OutPort[Any], ...] = tuple(ports[one.name] for one in plan.outlets)
        self.parts = tuple(zip(self.ins, plan.inlets, range(len(self.ins)), strict=True))
        sole = len(plan.outlets) == 1 and not plan.several
        self.sole: tuple[Any, Any] = (self.outs[0], plan.outlets[0]) if sole else (None, None)
        self.last: list[Any] = [NOTHING] * len(plan.inlets)
        """The newest sample of each in-port that took part in a call."""
        self.stream: Any = None
        """The iterator of a source while the source runs."""

    def unread(self) -> int:
        """The number of calls in this cycle: later samples wait for the next cycle, so that every cycle ends."""
        return sum(unread_at(port) for port in self.ins) or _FEW

    def due(self, component: FunctionComponent) -> Iterator[tuple[list[Any], Any]]:
        """The calls of this cycle: arguments, and the time stamp of their newest sample.

        It decides whether there is a call before it reads the samples, so that a sample without a partner stays unread.
        """
        parts, last = self.parts, self.last
        cycle, pairs = self.when == "cycle" or not parts, self.when == "all"
        latest = self.latest or cycle
        if not latest and not pairs and len(parts) > 1:
            yield from self._each(component)
            return
        for _ in range(1 if latest else self.unread()):
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
            yield self._arguments(component)

    def _each(self, component: FunctionComponent) -> Iterator[tuple[list[Any], Any]]:
        """A call for each sample unread when the cycle began; the first call reads a sample of each required port."""
        parts, last = self.parts, self.last
        # Calls are counted for each port, so that a port whose samples are always older does not hold up the others.
        left = [unread_at(port) or (_FEW if port.is_new else 0) for port in self.ins]
        ordered = all(one.stamped for one in self.plan.inlets)
        while True:
            ready = [number for port, _, number in parts if left[number] and port.is_new]
            missing = {number for _, one, number in parts if last[number] is NOTHING and one.default is _EMPTY}
            if not ready or not missing.issubset(ready):
                return
            if not missing:
                ready = [min(ready, key=self._oldest) if ordered and len(ready) > 1 else ready[0]]
            for number in ready:
                left[number] -= 1
                last[number] = self.ins[number].read_nowait()
            yield self._arguments(component)

    def _oldest(self, number: int) -> int:
        """The time stamp of the next unread sample of a port; the port has one."""
        sample: Any = self.ins[number].peek()
        return int(sample.tm)

    def _arguments(self, component: FunctionComponent) -> tuple[list[Any], Any]:
        """The arguments from the last known samples, and the time stamp of the newest of them."""
        arguments: list[Any] = []
        newest = None
        for _, one, number in self.parts:
            sample = self.last[number]
            if sample is NOTHING:
                arguments.append(one.default)
                continue
            arguments.append(sample.data if one.plain else sample if one.unwrap is None else one.unwrap(sample))
            if one.stamped and (newest is None or int(sample.tm) > newest):
                newest = int(sample.tm)
        return arguments, component.clock.time_ns() if newest is None else newest

    def samples(self, name: str, result: Any, tm: Any) -> Iterator[tuple[Any, Any]]:
        """Out-port and sample for each result of the function of the component `name`; None counts as no result."""
        if result is None:
            return
        outlets = self.plan.outlets
        items = (result,)
        if self.plan.several or not outlets:
            items = result if isinstance(result, tuple) and outlets else (result,)
            if len(items) != len(outlets):
                expected = f"{len(outlets)} results in a tuple" if outlets else "None"
                raise PortTypeError(f"{name}: {self.plan.label} returned {result!r:.60}; expected {expected}")
        for port, one, item in zip(self.outs, outlets, items, strict=True):
            if item is not None:
                yield port, self.record(port, one, tm, item)

    def record(self, port: OutPort[Any], one: Outlet, tm: Any, item: Any) -> Any:
        """The sample for one result."""
        try:
            return item if one.record is None else one.record(tm, item)
        except RecordError as error:
            raise PortTypeError(
                f"{port.path}: {self.plan.label} returned {item!r:.60}: {error}; nothing was sent"
            ) from error


def _settings(component: FunctionComponent, plan: Plan) -> dict[str, Any]:
    """The parameters in force, which change between cycles only."""
    return {name: getattr(component, name) for name in plan.params}


def _go_on(component: FunctionComponent) -> None:
    """Trigger a source in an event context again, so that it sends as fast as its readers read."""
    trigger = getattr(component.context, "trigger", None)
    if trigger is not None:
        cell(component).loop.call_soon(_trigger, component, trigger)


def _trigger(component: FunctionComponent, trigger: Callable[[Component], None]) -> None:
    if any(getattr(member.context, "trigger", None) == trigger for member in cell(component).members):
        trigger(component)


# -- in a thread -------------------------------------------------------------------------------------------------------


def _execute_in_thread(self: FunctionComponent) -> None:
    """Execute in a thread, where waiting is blocking."""
    calls: Calls = cell(self).own[Calls]
    plan, settings = calls.plan, _settings(self, calls.plan)
    if plan.streams and not calls.ins:
        if calls.stream is None:
            calls.stream = iter(plan.function(**settings))
        item = next(calls.stream, NOTHING)
        if item is NOTHING:
            self.finish()
        else:
            _send_blocking(self, calls, item, self.clock.time_ns())
        return
    idle = bool(calls.ins)
    for arguments, tm in calls.due(self):
        idle = False
        result = plan.function(*arguments, **settings)
        for item in result if plan.streams else (result,):
            _send_blocking(self, calls, item, tm)
        if cell(self).stopping:
            break
    if idle and getattr(self.context, "rate", None) is None:
        _rest(self, calls)


def _send_blocking(self: FunctionComponent, calls: Calls, item: Any, tm: Any) -> None:
    for port, sample in calls.samples(self.name, item, tm):
        port.write_blocking(sample)


def _rest(self: FunctionComponent, calls: Calls) -> None:
    """Wait for data in a thread that has nothing to do, since it would begin the next cycle at once.

    The wait is short if there are several in-ports or other members in the thread; with a request there is none.
    """
    port, sole = calls.ins[0], len(calls.ins) == 1
    context = self.context
    until = None if sole and len(context.runner.members) == 1 else cell(self).deadline_ns(_PAUSE)
    receiver_of(port).rest(lambda: context.runner.pending, until, for_data=sole)


# -- on a loop: the hook that a class has ------------------------------------------------------------------------------


async def _execute(self: FunctionComponent) -> None:
    """Call the function for the samples that have arrived."""
    calls: Calls = cell(self).own[Calls]
    plan, settings = calls.plan, _settings(self, calls.plan)
    sole, outlet = calls.sole
    for arguments, tm in calls.due(self):
        result = plan.function(*arguments, **settings)
        if plan.awaits:
            result = await result
        if sole is None:
            for port, sample in calls.samples(self.name, result, tm):
                await port.write(sample)
        elif result is not None:
            await sole.write(calls.record(sole, outlet, tm, result))


async def _execute_one(self: FunctionComponent) -> None:
    """The common case, written out: one in-port, at most one out-port, every sample."""
    calls: Calls = cell(self).own[Calls]
    plan, settings = calls.plan, _settings(self, calls.plan)
    (port,), (inlet,), (out,), (outlet,) = calls.ins, plan.inlets, calls.outs, plan.outlets
    function, unwrap, record, stamped = plan.function, inlet.unwrap, outlet.record, inlet.stamped
    left, plain = calls.unread(), inlet.plain
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
                result = calls.record(out, outlet, tm, result)
        await out.write(result)


async def _execute_stream(self: FunctionComponent) -> None:
    """Send all results of each call, one after the other."""
    calls: Calls = cell(self).own[Calls]
    plan, settings = calls.plan, _settings(self, calls.plan)
    for arguments, tm in calls.due(self):
        results = plan.function(*arguments, **settings)
        if plan.awaits:
            async for result in results:
                for port, sample in calls.samples(self.name, result, tm):
                    await port.write(sample)
        else:
            for result in results:
                for port, sample in calls.samples(self.name, result, tm):
                    await port.write(sample)


async def _execute_source(self: FunctionComponent) -> None:
    """Send the next result; finish after the last one."""
    calls: Calls = cell(self).own[Calls]
    plan = calls.plan
    if calls.stream is None:
        results = plan.function(**_settings(self, plan))
        calls.stream = aiter(results) if plan.awaits else iter(results)
    result = await anext(calls.stream, NOTHING) if plan.awaits else next(calls.stream, NOTHING)
    if result is NOTHING:
        self.finish()
        return
    for port, sample in calls.samples(self.name, result, self.clock.time_ns()):
        await port.write(sample)
    _go_on(self)


async def _close(self: FunctionComponent) -> None:
    """Close a source that has not ended, so that its `finally` runs."""
    calls: Calls = cell(self).own[Calls]
    stream, calls.stream = calls.stream, None
    close = getattr(stream, "aclose", None)
    if close is not None:
        await close()
    elif (close := getattr(stream, "close", None)) is not None:
        close()


def _close_in_any(self: FunctionComponent) -> None:
    calls: Calls = cell(self).own[Calls]
    stream, calls.stream = calls.stream, None
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
