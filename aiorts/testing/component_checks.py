"""The conformance suite of components: the promises on which neighbours, contexts and kernels rely.

Each check runs a new component in virtual time, fed every cycle; only the check for a blocked loop measures real time.
It comes first, and stops at the first cycle that is too long: with such hooks, the other checks would take very long.
"""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.clock import SystemClock
from aiorts.contexts import ExternalContext
from aiorts.errors import HookAbandoned, HookTimeout
from aiorts.kernel import Component, InPort, OutPort
from aiorts.kernel.execution.hooks import HookKind, hook_kinds
from aiorts.kernel.loop.bus import HookAfter, HookFailed
from aiorts.kernel.loop.tasks import owner_of
from aiorts.model.lifecycle import HOOKS, LifecycleState
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.rig import Rig
from aiorts.testing.samples import difference
from aiorts.testing.simulation import simulate

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from aiorts.clock import SimulatedClock
    from aiorts.kernel import Context

T = TypeVar("T")

_DEADLINE: Final = 0.001
"""Seconds of virtual time after which the check of cancellation cancels a hook."""
_ATTEMPTS: Final = 3
"""The number of measurements; a loop counts as blocked only if each shows it, since a busy machine may spoil one."""


def check_component(
    make: Callable[[], Component],
    feed: Mapping[str, Sequence[Any]] | None = None,
    *,
    make_context: Callable[[], Context] = ExternalContext,
    cycles: int = 20,
    deterministic: bool = False,
    may_block: float = 0.1,
    only: Iterable[str] | None = None,
    skip: Iterable[str] = (),
) -> None:
    """Hold a component to what its neighbours rely on; `COMPONENT_CHECKS` lists the promises.

    Args:
        make: a new component, in the state in which a kernel takes it.
        feed: in-port -> samples or their data, one for each cycle, from the start again when they are used up.
            By default each in-port gets a record as its type makes it without arguments.
        make_context: the kind of context that it is for; a ThreadContext needs a rate.
        cycles: how many a check runs. deterministic: the component claims that the same inputs give the same outputs.
        may_block: real seconds for which a hook may hold the event loop; one that may hold it long needs few `cycles`.
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, what was expected, what happened.
    """
    case = _Case(make, feed, make_context, cycles, deterministic, may_block)
    _SUITE.run(type(make()).__name__, case, only, skip)


@dataclass(frozen=True)
class _Case:
    """A component under check and how to run it."""

    make: Callable[[], Component]
    feed: Mapping[str, Sequence[Any]] | None
    make_context: Callable[[], Context]
    cycles: int
    deterministic: bool
    may_block: float

    def rig(self, component: Component, *, context: Context | None = None, debug: bool = True) -> Rig:
        return Rig(component, context=context or self.make_context(), strict=False, debug=debug)

    async def run(self, rig: Rig, on: Callable[[], bool] = lambda: True) -> None:
        """Feed the component and run cycles, as long as `on()` is true."""
        for cycle in range(self.cycles):
            if not on():
                return
            for name, samples in self._inputs(rig.components[0]):
                rig.feed(f"{rig.components[0].name}.{name}", samples[cycle % len(samples)])
            await rig.tick()

    def _inputs(self, component: Component) -> Iterator[tuple[str, Sequence[Any]]]:
        for name, port in component.ports.items():
            if not isinstance(port, InPort):
                continue
            if self.feed is None:
                yield name, (port.type(),)
            elif self.feed.get(name):
                yield name, self.feed[name]


_SUITE: Suite[_Case] = Suite()


@_SUITE.check
def does_not_block_the_loop(case: _Case) -> None:
    """No step of a hook holds the event loop for longer than `may_block` real seconds."""
    if _is_threaded(case):
        return
    found: list[tuple[float, str]] = []
    while len(found) < _ATTEMPTS and (not found or found[-1][0] > case.may_block):
        found.append(_longest_step(case))
    seconds, hook = min(found)
    expect(seconds <= case.may_block, f"steps of at most {case.may_block} s", f"{hook}: {seconds:.3f} s in one step")


def _longest_step(case: _Case) -> tuple[float, str]:
    """The real seconds of the longest step, and its hook; a cycle with a step that is too long is the last."""
    longest = [(0.0, "")]

    async def main(clock: SimulatedClock) -> None:
        component = case.make()
        with _measured(type(component), longest):
            async with case.rig(component) as rig:
                await case.run(rig, lambda: max(longest)[0] <= case.may_block)

    simulate(main)
    return max(longest)


@contextmanager
def _measured(cls: type[Component], steps: list[tuple[float, str]]) -> Iterator[None]:
    """Record how long each step of the hooks of this class takes, inside the `with`."""
    kinds = hook_kinds(cls, Component)
    own = {hook: vars(cls).get(hook) for hook in HOOKS if kinds[hook]}
    for hook in own:
        setattr(cls, hook, _measured_hook(getattr(cls, hook), kinds[hook], hook, steps))
    try:
        yield
    finally:
        for hook, function in own.items():
            if function is None:
                delattr(cls, hook)
            else:
                setattr(cls, hook, function)


def _measured_hook(
    function: Callable[..., Any], kind: int, hook: str, steps: list[tuple[float, str]]
) -> Callable[..., Any]:
    def note(seconds: float) -> None:
        steps.append((seconds, hook))

    @functools.wraps(function)
    def plain(*args: Any) -> Any:
        return _timed(note, function, *args)

    @functools.wraps(function)
    async def awaited(*args: Any) -> Any:
        return await _Steps(function(*args), note)

    return awaited if kind == HookKind.ASYNC else plain


def _timed(note: Callable[[float], None], function: Callable[..., T], *args: Any) -> T:
    started_ns = SystemClock().monotonic_ns()
    try:
        return function(*args)
    finally:
        note((SystemClock().monotonic_ns() - started_ns) / 1e9)


class _Steps:
    """A coroutine whose every step is timed."""

    def __init__(self, work: Awaitable[Any], note: Callable[[float], None]) -> None:
        self._steps: Any = work.__await__()
        self._note = note

    def __await__(self) -> _Steps:
        return self

    def __iter__(self) -> _Steps:
        return self

    def __next__(self) -> Any:
        return _timed(self._note, self._steps.send, None)

    def send(self, value: Any) -> Any:
        return _timed(self._note, self._steps.send, value)

    def throw(self, *error: Any) -> Any:
        return _timed(self._note, self._steps.throw, *error)

    def close(self) -> None:
        self._steps.close()


@_SUITE.check
def keeps_to_the_rules_of_hooks(case: _Case) -> None:
    """No hook raises, returns a value, or takes longer to stop than it may."""

    async def main(clock: SimulatedClock) -> tuple[HookFailed, ...]:
        async with case.rig(case.make()) as rig:
            await case.run(rig)
        return rig.failures

    expect_no_failure(simulate(main))


def expect_no_failure(failures: Sequence[HookFailed]) -> None:
    """End the check when a hook has failed."""
    for failure in failures:
        what = f"{failure.component}.{failure.hook}: {type(failure.error).__name__}: {failure.error}"
        expect(False, "no hook to fail", what)


@_SUITE.check
def can_be_activated_again(case: _Case) -> None:
    """After it was deactivated it can be activated and run again."""

    async def main(clock: SimulatedClock) -> tuple[HookFailed, ...]:
        component = case.make()
        async with case.rig(component) as rig:
            for _ in range(3):
                await case.run(rig)
                expect_no_failure(rig.failures)
                # A source that has called finish() is inactive by itself.
                if rig.context.state(component) is LifecycleState.ACTIVE:
                    await rig.context.deactivate(component)
                expect_no_failure(rig.failures)
                await rig.context.activate(component)
        return rig.failures

    expect_no_failure(simulate(main))


@_SUITE.check
def passes_on_cancellation(case: _Case) -> None:
    """A hook that is cancelled ends with CancelledError: it neither goes on nor returns as if nothing had happened."""
    component = case.make()

    async def main(clock: SimulatedClock) -> tuple[HookFailed, ...]:
        async with case.rig(component, context=ExternalContext(deadline=_DEADLINE), debug=False) as rig:
            await case.run(rig)
        return rig.failures

    for failure in () if _is_threaded(case) else simulate(main):
        error = failure.error
        expect(not isinstance(error, HookAbandoned), "the hook to end when it is cancelled", str(error))
        swallowed = isinstance(error, HookTimeout) and not isinstance(error.__cause__, asyncio.CancelledError)
        ended = f"{failure.component}.{failure.hook} was cancelled and ended with {error.__cause__!r}"
        expect(not swallowed, "CancelledError to leave the hook", ended)


def _is_threaded(case: _Case) -> bool:
    return not case.make_context().suspends


@_SUITE.check
def leaves_nothing_behind(case: _Case) -> None:
    """When its on_finalize is over, no task and no thread that it started is left."""
    threads = set(threading.enumerate())

    async def main(clock: SimulatedClock) -> list[str]:
        left: list[str] = []

        def look(event: HookAfter) -> None:
            if event.component == component.name and event.hook == "on_finalize":
                own = [task for task in asyncio.all_tasks() if owner_of(task) is component]
                tasks = [task for task in own if not task.done() and not task.cancelling()]
                left.extend(sorted(f"task {task.get_name()} ({task.get_coro()!r:.60})" for task in tasks))

        component = case.make()
        async with case.rig(component) as rig:
            await case.run(rig)
            rig.kernel.bus.subscribe(HookAfter, look)
            await rig.context.stop()
            await rig.kernel.remove(component)
        return left

    left = simulate(main)
    expect(not left, "no task of its own after on_finalize", ", ".join(left))
    for thread in set(threading.enumerate()) - threads:
        thread.join(1.0)
        expect(not thread.is_alive(), "no thread of its own after on_finalize", f"thread {thread.name}")


@_SUITE.check
def does_not_change_what_it_wrote(case: _Case) -> None:
    """A sample stays as it was when it was written: nothing in it is changed through a view that the writer kept."""

    async def main(clock: SimulatedClock) -> list[str]:
        async with case.rig(case.make(), debug=False) as rig:
            await case.run(rig)
            return rig.find_aliasing()

    found = simulate(main)
    expect(not found, "samples as they were written", "; ".join(found))


@_SUITE.check
def is_deterministic(case: _Case) -> None:
    """A component that claims to be deterministic writes the same samples at the same moments when it is run again."""

    async def main(clock: SimulatedClock) -> list[tuple[str, int, float, Any]]:
        component = case.make()
        async with case.rig(component) as rig:
            await case.run(rig)
            outs = [port for port in component.ports.values() if isinstance(port, OutPort)]
            return [
                (port.name, number, *both)
                for port in outs
                for number, both in enumerate(zip(rig.times(port), rig.received(port), strict=True))
            ]

    if case.deterministic:
        first, second = simulate(main), simulate(main)
        for one, other in zip(first, second, strict=False):
            found = difference(one, other, f"{one[0]}: sample {one[1]}")
            expect(found is None, "the same samples in a second run", str(found))
        expect(len(first) == len(second), f"{len(first)} samples again", len(second))


COMPONENT_CHECKS: Mapping[str, str] = _SUITE.promises
"""The promises that `check_component` demands: name of the check -> promise."""
