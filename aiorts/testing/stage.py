"""The stage of conformance checks of contexts: recording members, and what they do inside a hook."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING

from aiorts.assembly import Kernel
from aiorts.kernel import Component
from aiorts.model.lifecycle import HOOKS
from aiorts.testing.driving import one_cycle

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.clock import SimulatedClock
    from aiorts.kernel import Context


def _recording(hook: str) -> Callable[..., None]:
    def run(self: Recorder, *error: BaseException) -> None:
        self._record(hook)

    return run


class Recorder(Component):
    """Writes down each hook that runs; `during` is called in every `on_execute`."""

    def __init__(self, name: str, calls: list[str], during: Callable[[], object] = lambda: None) -> None:
        super().__init__(name)
        self.calls = calls
        self.during = during

    def _record(self, hook: str) -> None:
        self.calls.append(f"{self.name}.{hook}")

    locals().update({hook: _recording(hook) for hook in HOOKS if hook not in ("on_initialize", "on_finalize")})

    def on_execute(self) -> None:
        self._record("on_execute")
        self.during()


class Stage:
    """One context of the kind under check with two recording members, running in virtual time."""

    def __init__(self, kernel: Kernel, context: Context, clock: SimulatedClock) -> None:
        self.kernel = kernel
        self.context = context
        self.clock = clock
        self.calls: list[str] = []
        self.a = Recorder("a", self.calls)
        self.b = Recorder("b", self.calls)

    async def start(self, *, activate: bool = True) -> None:
        """Start the context and let its first cycle pass; then activate both members."""
        await self.kernel.add(self.a)
        await self.kernel.add(self.b)
        await self.kernel.start(self.context, self.a, self.b)
        await self.clock.advance(0)
        if activate:
            await self.context.activate()
            await self.clock.advance(0)
            # An event context runs its members when they become active only if they have a cause; others wait.
            self.calls.clear()

    async def cycle(self) -> list[str]:
        """Drive one cycle and return the hooks that ran."""
        self.calls.clear()
        trigger = getattr(self.context, "trigger", None)
        if trigger is not None:
            trigger()
        await one_cycle(self.context, self.clock)
        return self.calls.copy()


class AskedInside:
    """A request from outside, made once, to deactivate b while a hook of a runs."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._loop = asyncio.get_running_loop()
        self._request: asyncio.Future[None] | None = None

    def ask(self) -> None:
        """Make the request, on the loop."""
        if self._request is None:
            self._request = self._loop.create_future()
            # Not in a task of the hook: what a hook asks for itself is queued and answered at once.
            self._loop.call_soon(self._begin, self._request)

    def _begin(self, answer: asyncio.Future[None]) -> None:
        asking = asyncio.ensure_future(self._stage.context.deactivate(self._stage.b))
        asking.add_done_callback(lambda done: answer.set_result(done.result()))

    def from_thread(self) -> None:
        """Make the request, in the thread of the context; return when it was submitted."""
        submitted = threading.Event()

        def submit() -> None:
            self.ask()
            self._loop.call_soon(submitted.set)

        self._loop.call_soon_threadsafe(submit)
        submitted.wait(5.0)

    async def answered(self) -> None:
        """Wait until the request has taken effect."""
        if self._request is not None:
            await self._request


class Inside:
    """Counts the hooks that run at once, now and at most."""

    def __init__(self) -> None:
        self.now = self.most = self.entered = 0

    def plain(self) -> None:
        """Enter and leave."""
        self.enter()
        self.leave()

    def leave(self) -> None:
        """Count a hook as ended."""
        self.now -= 1

    def enter(self) -> None:
        """Count a hook as begun."""
        self.now += 1
        self.entered += 1
        self.most = max(self.most, self.now)


class Waiting(Recorder):
    """A recorder whose on_execute waits for virtual time."""

    def __init__(self, name: str, calls: list[str], inside: Inside) -> None:
        super().__init__(name, calls)
        self._inside = inside

    async def on_execute(self) -> None:  # type: ignore[override] # a hook may be either
        self._inside.enter()
        await self.sleep(0.0035)
        self._inside.leave()


class Asking(Recorder):
    """A recorder whose on_execute has the request made, then waits a little."""

    def __init__(self, name: str, calls: list[str], asked: AskedInside) -> None:
        super().__init__(name, calls)
        self._asked = asked

    async def on_execute(self) -> None:  # type: ignore[override] # a hook may be either
        self._record("on_execute")
        self._asked.ask()
        await self.sleep(0.0005)
