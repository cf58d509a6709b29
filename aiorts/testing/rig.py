"""A rig: components in a kernel of their own, on simulated time; feeds ports, steps time, keeps what was written.

async with Rig(Pid("pid0"), rate=100.0) as rig:
    rig.feed("measured", 1.0, 2.0)
    await rig.tick()
    assert rig.values("command") == [-2.0]
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from inspect import iscoroutine
from typing import TYPE_CHECKING, Any, Self, TypeVar, Unpack

from aiorts.assembly import Kernel
from aiorts.clock import SimulatedClock, current_clock, to_ns
from aiorts.contexts import ExternalContext
from aiorts.diagnostics import unawaited_told
from aiorts.errors import ClosedError, ComponentError, StateError, WiringError
from aiorts.kernel import Component, InPort, OutPort
from aiorts.kernel.loop.bus import HookFailed, PortAdded
from aiorts.services import ServicePort
from aiorts.testing.driving import is_ticked, one_cycle, while_time_passes
from aiorts.testing.instruments import Instruments, Tap, at_once
from aiorts.testing.samples import difference, sample_of, value_of
from aiorts.wire import MsgpackCodec

if TYPE_CHECKING:
    from collections.abc import Coroutine, Iterator, Mapping

    from aiorts.kernel import Connector, Context
    from aiorts.kernel.ports import Port
    from aiorts.model.connect_options import ConnectOptions
    from aiorts.services import ServiceEnd

T = TypeVar("T")


class Caught:
    """The failure that `Rig.expect_error` has caught; `error` is the exception that the hook raised."""

    error: BaseException


class Rig:
    """Components under test. `async with` opens it, on any asyncio loop and inside `simulate`.

    The test keeps each component itself, with its own type: `pid = Pid("pid0")`, then `Rig(pid, params={"gain": 2.0})`.
    While the rig is open, `await pid.configure(gain=3.0)` changes parameters as `--set` and tools do, and
    `await pid.configuration.activate("soft")` puts a configuration set in force; before it is opened, too.

    Args:
        components: in order of execution, all in one context.
        params: values of parameters of the only component, in force before its `on_initialize`, as in `Kernel.create`;
            opening raises ConfigurationError when one does not fit.
        rate: Hz of an external context: each tick is one period later than the last. None: ticks take no time.
        context: the context of the components; an ExternalContext by default.
        clock: simulated; by default that of the loop, or a new one at 0.
        strict: the next `tick`, `advance` or `activate` raises what a failed hook raised, or a ComponentError with hook
            and line where a hook made a coroutine and did not await it.
        debug: the kernel's debug mode: checks the thread of each port call and copies each sample.
        activate: whether the components are active from the start.
    """

    def __init__(
        self,
        *components: Component,
        params: Mapping[str, object] | None = None,
        rate: float | None = None,
        context: Context | None = None,
        clock: SimulatedClock | None = None,
        strict: bool = True,
        debug: bool = True,
        activate: bool = True,
    ) -> None:
        if params and len(components) != 1:
            raise ValueError(f"params: is for one component, there are {len(components)}; configure() each of them")
        self.components = components
        self._params = dict(params or {})
        self.context: Context = ExternalContext() if context is None else context
        """The context of the components."""
        if rate is not None and not is_ticked(self.context):
            raise ValueError(f"rate={rate!r}: is for contexts that are ticked; {self.context!r} has its own")
        self.strict = strict
        self._rate = rate
        self._clock = clock
        self._debug = debug
        self._activate = activate
        self._kernel: Kernel | None = None
        self._instruments: Instruments | None = None
        self._failures: list[HookFailed] = []
        self._reported = 0
        self._expecting = 0
        self._unawaited: list[str] = []
        self._until_closed = ExitStack()
        self._is_open = False
        self._start_ns = self._ticks = 0
        self._in_ports: dict[InPort[Any], list[Any]] = {}

    # -- opening and closing ---------------------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        if self._kernel is not None:
            raise StateError("Rig: was opened already; make another")
        self._clock = self._clock or current_clock() or SimulatedClock()
        self._kernel = Kernel("rig", clock=self._clock, debug=self._debug, contain_interrupts=True)
        await self._kernel.open()
        self._until_closed.enter_context(unawaited_told(self._take_unawaited))
        try:
            await self._set_up(self._kernel)
        except BaseException:
            await self._kernel.aclose()
            self._until_closed.close()
            raise
        self._is_open = True
        return self

    async def _set_up(self, kernel: Kernel) -> None:
        kernel.bus.subscribe(HookFailed, self._failures.append)
        instruments = self._instruments = await kernel.add(Instruments(None if self._debug else MsgpackCodec().encode))
        for component in self.components:
            await kernel.add(component, **self._params)
            for port in component.ports.values():
                if isinstance(port, OutPort):
                    instruments.tap(port)
        kernel.bus.subscribe(PortAdded, self._tap_new_port)
        await kernel.start(self.context, *self.components)
        # A context with a rate has its first cycle now; it is over before anything is active, so ticks begin at 1.
        await self.clock.advance(0)
        self._start_ns = self.clock.monotonic_ns()
        if self._activate:
            await self.activate()

    async def __aexit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._is_open = False
        kernel = self.kernel
        try:
            for context in reversed(tuple(kernel.contexts.values())):
                await while_time_passes(self.clock, context.stop())
        finally:
            await kernel.aclose()
            self._until_closed.close()
        if error is None:
            self._raise_failure()

    def _tap_new_port(self, event: PortAdded) -> None:
        port = self.kernel.components[event.component].ports.get(event.port.name)
        if isinstance(port, OutPort) and event.component != self._tools.name:
            self._tools.tap(port)

    # -- what there is ---------------------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """Whether the rig was opened and not closed."""
        return self._is_open

    @property
    def kernel(self) -> Kernel:
        """The rig's own kernel; ClosedError before it was opened."""
        return _opened(self._kernel)

    @property
    def clock(self) -> SimulatedClock:
        """The simulated clock of the rig; ClosedError before it was opened."""
        return _opened(self._clock)

    @property
    def _tools(self) -> Instruments:
        return _opened(self._instruments)

    @property
    def failures(self) -> tuple[HookFailed, ...]:
        """Every hook that has failed, expected or not."""
        return tuple(self._failures)

    def port(self, port: str | Port[Any]) -> Port[Any]:
        """The port of a path ("pid0.command"), or of a name that only one of the components has.

        Raises:
            WiringError: there is none, or there are several.
        """
        if not isinstance(port, str):
            return port
        if "." in port:
            found = self.kernel.find(port)
            if isinstance(found, Component):
                raise WiringError(f"{port}: is a component; expected a port such as {port}.out")
            return found
        known = [p for component in self.components for p in component.ports.values()]
        named = [p for p in known if p.name == port]
        if len(named) != 1:
            among = ", ".join(p.path for p in named or known) or "none"
            raise WiringError(f"{port}: {len(named) or 'no'} ports have this name; there are {among}")
        return named[0]

    # -- ports -----------------------------------------------------------------------------------------------------

    def connect(self, out: str | OutPort[Any], in_: str | InPort[Any], **options: Unpack[ConnectOptions]) -> Connector:
        """Connect two ports; options as in `Kernel.connect`, WiringError as there."""
        first, second = self.port(out), self.port(in_)
        for port in (first, second):
            if isinstance(port, OutPort):
                self._tools.make_room(port)
        made: Connector = at_once(self.kernel.connect(first, second, **options))
        return made

    def feed(self, port: str | Port[Any], *samples: Any) -> None:
        """Let an in-port receive these samples, or an out-port write them, now.

        A sample is a value of the port's type, or its data: the record is then made with the clock's time as `tm`.

        Raises:
            RecordError: a value does not fit.
            PortTypeError: a sample is not of the port's type or shape.
        """
        target = self.port(port)
        now_ns = self.clock.time_ns()
        out = target if isinstance(target, OutPort) else self._tools.feed(_in_port(target))
        for sample in samples:
            out.write_nowait(sample_of(target.type, sample, now_ns))

    def received(self, port: str | Port[Any]) -> list[Any]:
        """Every sample that an out-port has written since the start or `clear()`, the oldest first.

        For an in-port: the samples that its component left unread, which are taken out, and those taken out before.

        Raises:
            WiringError: the out-port takes no further connector (`max_connectors`), so that no tap could listen to it.
        """
        target = self.port(port)
        if isinstance(target, OutPort):
            return list(self._tap(target).samples)
        taken = self._in_ports.setdefault(_in_port(target), [])
        taken += _in_port(target).drain()
        return list(taken)

    def values(self, port: str | Port[Any]) -> list[Any]:
        """The data of the samples that `received` returns."""
        return [value_of(sample) for sample in self.received(port)]

    def times(self, port: str | Port[Any]) -> list[float]:
        """The time of each sample that an out-port wrote: seconds of virtual time since the clock's start.

        Raises:
            WiringError: the port is an in-port, or an out-port that takes no further connector.
        """
        target = self.port(port)
        if not isinstance(target, OutPort):
            raise WiringError(f"{target.path}: is an in-port; only what an out-port writes has a time")
        return [time_ns / 1e9 for time_ns in self._tap(target).times]

    def clear(self) -> None:
        """Forget what was received until now."""
        for tap in self._tools.taps.values():
            tap.clear()
        self._in_ports.clear()

    def find_aliasing(self) -> list[str]:
        """Samples that were changed after they were written, as "pid0.command: sample 3: TimedDoubleSeq.data[0]: ...".

        Raises:
            StateError: the rig is in debug mode, which copies each sample and so hides it; use Rig(..., debug=False).
        """
        if self._debug:
            raise StateError("find_aliasing: the rig's debug mode copies each sample; use Rig(..., debug=False)")
        codec, found = MsgpackCodec(), []
        for tap in self._tools.taps.values():
            for number, (sample, frame) in enumerate(zip(tap.samples, tap.notes, strict=True)):
                changed = difference(sample, codec.decode(frame))
                if changed is not None:
                    found.append(f"{tap.out.path}: sample {number}: {changed} as written")
        return found

    # -- services --------------------------------------------------------------------------------------------------

    def provide(self, end: str | ServicePort | ServiceEnd[Any], fake: object) -> None:
        """Connect `fake`, an object with the methods of the interface, to what a component requires.

        Raises:
            DeclarationError: `fake` does not have them.
            WiringError: no interface is required there, or it is connected already.
        """
        self._tools.provide(self._end(end, "required"), fake)

    async def call(self, end: str | ServicePort | ServiceEnd[Any], method: str, *args: Any, **kwargs: Any) -> Any:
        """Call a method that a component provides; time passes meanwhile, at most 60 s.

        Raises:
            WiringError: the component provides no such interface, or several.
            ServiceError: as any call.
        """
        answer = getattr(self._tools.ask(self._end(end, "provided")).proxy, method)(*args, **kwargs)
        return await while_time_passes(self.clock, answer) if iscoroutine(answer) else answer

    def _end(self, end: str | ServicePort | ServiceEnd[Any], polarity: str) -> ServiceEnd[Any]:
        if isinstance(end, str):
            path, _, name = end.rpartition(".") if end.count(".") > 1 else (end, "", "")
            port = self.port(path)
        else:
            port, name = (end, "") if isinstance(end, ServicePort) else (end.port, end.instance)
        ends = port.interfaces if isinstance(port, ServicePort) else ()
        found = [one for one in ends if one.polarity == polarity and name in ("", one.instance)]
        if len(found) != 1:
            among = ", ".join(f"{one.path} ({one.polarity})" for one in ends) or "none"
            raise WiringError(f"{port.path}: {len(found) or 'no'} {polarity} interfaces here; there are {among}")
        return found[0]

    def _tap(self, out: OutPort[Any]) -> Tap:
        tap = self._tools.taps.get(out)
        if tap is None:
            raise WiringError(
                f"{out.path}: all {out.max_connectors} connectors are used and none is left to listen; ask its readers"
            )
        return tap

    # -- time and lifecycle ---------------------------------------------------------------------------------------

    async def tick(self, count: int = 1) -> None:
        """Run `count` cycles, each with the time that it takes; an event context runs members that have a cause.

        Raises:
            BaseException: the exception that a hook raised, unless `strict` is False or the exception is expected.
        """
        for _ in range(count):
            if self._rate is not None:
                due_ns = self._due_ns(self._rate)
                self._ticks += 1
                if due_ns > self.clock.monotonic_ns():
                    await self.clock.advance_to(due_ns)
            await one_cycle(self.context, self.clock)
            self._raise_failure()

    async def advance(self, seconds: float) -> None:
        """Let virtual time pass, with all ticks that are due in it. Raises as `tick`; ValueError for less than 0."""
        step_ns = to_ns(seconds)
        if step_ns < 0:
            raise ValueError(f"seconds={seconds!r}: expected 0 or more, time does not go back")
        end_ns = self.clock.monotonic_ns() + step_ns
        while self._rate is not None and self._due_ns(self._rate) <= end_ns:
            await self.tick()
        await self.clock.advance_to(max(end_ns, self.clock.monotonic_ns()))
        self._raise_failure()

    async def activate(self, *components: Component) -> None:
        """Activate these components, or all. Raises what a hook raised."""
        await self._ask(self.context.activate(*components))

    async def deactivate(self, *components: Component) -> None:
        """Deactivate these components, or all. Raises what a hook raised."""
        await self._ask(self.context.deactivate(*components))

    async def reset(self, *components: Component) -> None:
        """Reset these components, or all that are in error. Raises what a hook raised."""
        await self._ask(self.context.reset(*components))

    async def _ask(self, request: Coroutine[Any, Any, None]) -> None:
        try:
            await while_time_passes(self.clock, request)
        except ComponentError:
            # The failure of the hook is raised below instead: a test wants to see that one.
            if self._reported == len(self._failures) and not self._expecting:
                raise
        await self.clock.advance(0)
        self._raise_failure()

    def _due_ns(self, rate: float) -> int:
        numerator, denominator = float(rate).as_integer_ratio()
        return self._start_ns - (-(self._ticks + 1) * denominator * 1_000_000_000 // numerator)

    # -- failures --------------------------------------------------------------------------------------------------

    @contextmanager
    def expect_error(self, kind: type[BaseException] = Exception) -> Iterator[Caught]:
        """A block in which a hook must fail with `kind`; its exception is then in `error` and nothing is raised.

        Raises:
            AssertionError: no hook failed. The exception of the hook: it is of another kind.
        """
        caught, before = Caught(), len(self._failures)
        self._expecting += 1
        try:
            yield caught
        finally:
            self._expecting -= 1
        new = self._failures[before:]
        if not new:
            raise AssertionError(f"expected a hook to fail with {kind.__name__}, none failed")
        for failure in new:
            if not isinstance(failure.error, kind):
                self._reported = len(self._failures)
                raise failure.error
        caught.error = new[0].error
        self._reported = len(self._failures)

    def _take_unawaited(self, line: str, owner: Component | None) -> bool:
        """Keep a line for the next `_raise_failure`; False: it is no component's, or not to be raised: a warning."""
        is_ours = self.strict and owner is not None and owner.name in self.kernel.components
        if is_ours:
            self._unawaited.append(line)
        return is_ours

    def _raise_failure(self) -> None:
        if not self.strict or self._expecting:
            return
        if self._unawaited:
            lines, self._unawaited = self._unawaited, []
            raise ComponentError("\n".join(dict.fromkeys(lines)))
        if self._reported == len(self._failures):
            return
        failure = self._failures[self._reported]
        self._reported = len(self._failures)
        where = f"{failure.component}.{failure.hook}"
        if not isinstance(failure.error, Exception):
            # A CancelledError or KeyboardInterrupt of a component must not be taken for the test's own.
            raise ComponentError(f"{where}: raised {failure.error!r}") from failure.error
        raise failure.error


def _in_port(port: Port[Any]) -> InPort[Any]:
    if not isinstance(port, InPort):
        raise WiringError(f"{port.path}: expected an in-port or an out-port, got {port!r}")
    return port


def _opened(part: T | None) -> T:
    if part is None:
        raise ClosedError("Rig: is not open; use `async with Rig(...) as rig`")
    return part
