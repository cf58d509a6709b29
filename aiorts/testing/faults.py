"""Components that misbehave in one way each, to test their surroundings. The first argument is the misbehaving hook.

    await kernel.add(Failing("on_execute", ValueError("no camera"), name="camera0"))

All but `Hanging` and `Slow` have plain `def` hooks and run in every context.
"""

from __future__ import annotations

import asyncio
import threading
import time
from typing import TYPE_CHECKING, Any

from aiorts.errors import DeclarationError
from aiorts.kernel import Component, OutPort
from aiorts.model.lifecycle import HOOKS
from aiorts.types import TimedDoubleSeq, TimedLong

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    import numpy.typing as npt


def _plain(hook: str) -> Callable[..., Any]:
    def run(self: _Faulty, *error: BaseException) -> Any:
        return self._fault() if self._due(hook) else None

    return run


def _awaiting(hook: str) -> Callable[..., Any]:
    async def run(self: _Awaiting, *error: BaseException) -> None:
        if self._due(hook):
            await self._wait()

    return run


class _Faulty(Component):
    """Misbehaves in one hook, from call `after` on (0 is the first), `times` times (None: always)."""

    def __init__(self, hook: str, *, name: str, after: int, times: int | None) -> None:
        super().__init__(name)
        if hook not in HOOKS:
            raise DeclarationError(f"{self.name}: {hook!r} is no hook; there are {', '.join(HOOKS)}")
        self.hook = hook
        self.calls = 0
        """How often the hook was called."""
        self.cycles = 0
        """How often on_execute was called."""
        self._first = after
        self._last = None if times is None else after + times

    def _due(self, hook: str) -> bool:
        self.cycles += hook == "on_execute"
        if hook != self.hook:
            return False
        self.calls += 1
        return self.calls > self._first and (self._last is None or self.calls <= self._last)

    def _fault(self) -> Any:
        """Misbehave; the result becomes that of the hook."""
        raise NotImplementedError

    locals().update({hook: _plain(hook) for hook in HOOKS})


class _Awaiting(_Faulty):
    """Misbehaves by waiting."""

    async def _wait(self) -> None:
        raise NotImplementedError

    locals().update({hook: _awaiting(hook) for hook in HOOKS})


class Failing(_Faulty):
    """Raises `error` in a hook: any BaseException, a CancelledError or KeyboardInterrupt as well."""

    def __init__(
        self, hook: str, error: BaseException | None = None, *, name: str = "", after: int = 0, times: int | None = None
    ) -> None:
        super().__init__(hook, name=name, after=after, times=times)
        self.error = RuntimeError(f"{hook} fails as instructed") if error is None else error

    def _fault(self) -> None:
        raise self.error


class Returning(_Faulty):
    """Returns a value from a hook, which must return None."""

    def __init__(self, hook: str, value: object, *, name: str = "", after: int = 0, times: int | None = None) -> None:
        super().__init__(hook, name=name, after=after, times=times)
        self.value = value

    def _fault(self) -> object:
        return self.value


class Blocking(_Faulty):
    """Blocks its thread for `seconds` of real time: that of the event loop, unless it has one of its own."""

    def __init__(self, hook: str, seconds: float, *, name: str = "", after: int = 0, times: int | None = None) -> None:
        super().__init__(hook, name=name, after=after, times=times)
        self.seconds = seconds

    def _fault(self) -> None:
        time.sleep(self.seconds)


class Slow(_Awaiting):
    """Waits `seconds` of the kernel's clock in a hook, and leaves the loop free meanwhile."""

    def __init__(self, hook: str, seconds: float, *, name: str = "", after: int = 0, times: int | None = None) -> None:
        super().__init__(hook, name=name, after=after, times=times)
        self.seconds = seconds

    async def _wait(self) -> None:
        await self.sleep(self.seconds)


class Hanging(_Awaiting):
    """Waits in a hook until `release()`; it swallows every cancellation unless `cancellable`."""

    def __init__(
        self, hook: str, *, cancellable: bool = False, name: str = "", after: int = 0, times: int | None = None
    ) -> None:
        super().__init__(hook, name=name, after=after, times=times)
        self.cancellable = cancellable
        self.cancelled = 0
        """How often it was cancelled."""
        self._released = asyncio.Event()

    def release(self) -> None:
        """Let the hook return."""
        self._released.set()

    async def _wait(self) -> None:
        while not self._released.is_set():
            try:
                await self._released.wait()
            except asyncio.CancelledError:
                self.cancelled += 1
                if self.cancellable:
                    raise


class Leaking(_Faulty):
    """Starts a task ("task") or a thread ("thread") in a hook and never ends it; `release()` does."""

    def __init__(self, hook: str, what: str = "task", *, name: str = "") -> None:
        super().__init__(hook, name=name, after=0, times=1)
        if what not in ("task", "thread"):
            raise ValueError(f'what = {what!r}: expected "task" or "thread"')
        self.what = what
        self.task: asyncio.Task[Any] | None = None
        self.thread: threading.Thread | None = None
        self._released = threading.Event()

    def release(self) -> None:
        """End what was leaked."""
        self._released.set()
        if self.task is not None:
            self.task.cancel()
        if self.thread is not None:
            self.thread.join()

    def _fault(self) -> None:
        if self.what == "task":
            self.task = asyncio.get_running_loop().create_task(asyncio.Event().wait())
        else:
            self.thread = threading.Thread(target=self._released.wait, name=f"leaked by {self.name}", daemon=True)
            self.thread.start()


class Flooding(_Faulty):
    """Writes `count` numbered samples to `out` in every on_execute."""

    out = OutPort(TimedLong)

    def __init__(self, count: int = 1000, *, name: str = "") -> None:
        super().__init__("on_execute", name=name, after=0, times=None)
        self.count = count
        self.written = 0

    def _fault(self) -> None:
        for _ in range(self.count):
            self.written += 1
            self.out.write_nowait(TimedLong(0, self.written))


class Aliasing(_Faulty):
    """Writes an array to `out` and goes on changing it through a view that it kept."""

    out = OutPort(TimedDoubleSeq)

    def __init__(self, *, name: str = "") -> None:
        super().__init__("on_execute", name=name, after=0, times=None)
        self._kept: npt.NDArray[np.float64] | None = None

    def _fault(self) -> None:
        import numpy as np

        array = np.zeros(3)
        self._kept = array[:]
        self.out.write_nowait(TimedDoubleSeq(0, array))
        self._kept[0] = self.cycles
