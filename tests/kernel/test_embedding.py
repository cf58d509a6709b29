"""A kernel in somebody else's application: what it finds it leaves as it was."""

from __future__ import annotations

import asyncio
import logging
import signal
import subprocess
import sys
from typing import Any

import pytest

from aiorts import Component, ExternalContext, Kernel, PeriodicContext
from aiorts.errors import ClosedError, StateError, ThreadError
from kernel_parts import PlainDiary

pytestmark = pytest.mark.anyio
HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def state_of_the_process() -> tuple[Any, ...]:
    root = logging.getLogger()
    return (
        asyncio.get_event_loop_policy(),
        [signal.getsignal(number) for number in HANDLED],
        (root.level, list(root.handlers), logging.getLogger("aiorts").level, logging.getLogger("aiorts").handlers),
        sys.excepthook,
    )


def host_factory(loop: Any, coroutine: Any, **options: Any) -> Any:
    return asyncio.Task(coroutine, loop=loop, **options)


@pytest.mark.row(5)
async def test_loop_and_process_are_as_found_when_the_last_kernel_closes(anyio_backend: Any) -> None:
    loop, seen = asyncio.get_running_loop(), []
    found = (loop.get_task_factory(), loop.get_exception_handler())

    def handler(loop: Any, context: dict[str, Any]) -> None:
        seen.append(context["message"])

    loop.set_task_factory(host_factory)
    loop.set_exception_handler(handler)
    before = state_of_the_process()
    one, two = await Kernel("one").open(), await Kernel("two").open()
    await two.start(PeriodicContext(100.0), await two.add(PlainDiary("pid0")), activate=True)
    loop.call_exception_handler({"message": "the host's own"})
    assert seen == ["the host's own"]
    await one.aclose()
    await asyncio.sleep(0.02)
    assert loop.get_task_factory() is not host_factory
    await two.aclose()
    assert (loop.get_task_factory(), loop.get_exception_handler()) == (host_factory, handler)
    assert state_of_the_process() == before
    loop.set_task_factory(found[0])
    loop.set_exception_handler(found[1])


async def test_host_that_wraps_after_us_keeps_its_wrapper_and_everything_passes_through(anyio_backend: Any) -> None:
    loop, made = asyncio.get_running_loop(), []
    found = (loop.get_task_factory(), loop.get_exception_handler())
    kernel = await Kernel().open()
    ours: Any = loop.get_task_factory()

    def wrapper(loop: Any, coroutine: Any, **options: Any) -> Any:
        made.append(1)
        return ours(loop, coroutine, **options)

    loop.set_task_factory(wrapper)
    await kernel.aclose()
    assert loop.get_task_factory() is wrapper
    assert await asyncio.create_task(asyncio.sleep(0, "still works")) == "still works"
    async with Kernel() as later:
        await later.add(PlainDiary("pid0"))
    assert loop.get_task_factory() is wrapper
    assert made
    loop.set_task_factory(found[0])
    loop.set_exception_handler(found[1])


async def test_exception_of_the_hosts_own_task_goes_where_the_host_said(anyio_backend: Any) -> None:
    loop, seen = asyncio.get_running_loop(), []
    loop.set_exception_handler(lambda loop, context: seen.append(str(context.get("exception"))))
    async with Kernel() as kernel:
        await kernel.start(ExternalContext(), await kernel.add(PlainDiary("pid0")), activate=True)
        loop.call_soon(lambda: 1 / 0)
        await asyncio.sleep(0.01)
    loop.set_exception_handler(None)
    assert seen == ["division by zero"]


async def test_kernel_opens_once_and_says_what_it_is_when_used_before_or_after(anyio_backend: Any) -> None:
    kernel = Kernel()
    with pytest.raises(ClosedError, match="cannot add: is not open"):
        await kernel.add(PlainDiary("pid0"))
    await kernel.aclose()
    async with kernel:
        with pytest.raises(StateError, match="make another Kernel"):
            await kernel.open()
    await kernel.aclose()
    with pytest.raises(StateError, match="make another Kernel"):
        await kernel.open()
    with pytest.raises(ClosedError, match="cannot add: is closed"):
        await kernel.add(PlainDiary("pid0"))


async def test_kernel_is_closed_on_the_loop_it_was_opened_on(anyio_backend: Any) -> None:
    async with Kernel() as kernel:

        def elsewhere() -> str:
            loop = asyncio.new_event_loop()
            try:
                loop.run_until_complete(kernel.aclose())
            except ThreadError as error:
                return str(error)
            finally:
                loop.close()
            return ""

        assert "aclose called from thread" in await asyncio.to_thread(elsewhere)


@pytest.mark.slow(kept_by="time/test_foreign_loops.py::test_kernels_on_one_loop_share_its_time")
async def test_several_kernels_on_one_loop_run_and_fail_apart(anyio_backend: Any) -> None:
    class Failing(Component):
        async def on_execute(self) -> None:
            asyncio.get_running_loop().create_task(self._fail())

        async def _fail(self) -> None:
            raise ValueError("mine")

    async with Kernel("one") as one, Kernel("two") as two:
        first, second = await one.add(Failing("same")), await two.add(PlainDiary("same"))
        context = await one.start(ExternalContext(name="loop"), first, activate=True)
        other = await two.start(PeriodicContext(100.0, name="loop"), second, activate=True)
        await context.tick()
        await asyncio.sleep(0.7)
        assert str(first.last_error) == "mine"
        assert second.last_error is None
        assert other.ticks >= 50


async def test_component_belongs_to_one_kernel(anyio_backend: Any) -> None:
    async with Kernel("one") as one, Kernel("two") as two:
        diary = await one.add(PlainDiary("pid0"))
        with pytest.raises(StateError, match="belongs to one already"):
            await two.add(diary)
        with pytest.raises(StateError, match="does not belong to two"):
            await two.start(ExternalContext(), diary)


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(5)
def test_importing_and_running_installs_nothing_in_the_process() -> None:
    code = (
        "import asyncio, logging, signal, sys\n"
        "def state(): return (asyncio.get_event_loop_policy(), signal.getsignal(2), signal.getsignal(15),"
        " list(logging.root.handlers), logging.root.level, sys.excepthook)\n"
        "before = state()\n"
        "import aiorts\n"
        "async def main():\n"
        "    async with aiorts.Kernel() as kernel: await kernel.add(aiorts.Component('pid0'))\n"
        "aiorts.run(main)\n"
        "assert state() == before, (before, state())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")
