"""A kernel of another host's, and the process of it ends in one of many ways.

`python ending_program.py ADDRESS CERTIFICATES LOOP WAY` says "ready" when it is linked, or for a way of which that is
not wanted soon, and "ending" when it ends; `python ending_program.py ADDRESS CERTIFICATES LOOP listen` is what it is
linked with, until its standard input ends, or has a line: then it ends at once and without a word.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import aclosing, suppress
from typing import Any, Protocol

from aiorts import Component, EventContext, InPort, Kernel, OutPort, Provided, Required, run
from aiorts.errors import AiortsError
from aiorts.types import TimedLong
from aiorts_zenoh import Network


class Stop(Protocol):
    async def stop(self, number: int) -> int: ...


class Source(Component):
    out = OutPort(TimedLong)


class Asks(Component):
    service = Required[Stop](timeout=2.0)


class Ends(Component):
    """Closes its kernel in a hook or in a call, if told to."""

    inp = InPort(TimedLong)
    service = Provided[Stop]()
    closes: Kernel
    way = ""
    came: Callable[[], None]

    async def on_execute(self) -> None:
        self.inp.drain()
        self.came()
        if self.way == "in a hook":
            ending()
            await self.closes.aclose()

    async def stop(self, number: int) -> int:
        if self.way == "in a call":
            ending()
            await self.closes.aclose()
        return number


def ending() -> None:
    print("ending", flush=True)


def services(end: str, address: str, certificates: str) -> dict[str, Any]:
    return {"zenoh": {end: address, "host": "far" if end == "listen" else "near", "certificates": certificates}}


async def listen(address: str, certificates: str) -> None:
    """Write to the other one, and call it, for as long as it is there, and whenever it is there again."""
    async with Kernel("reader", services=services("listen", address, certificates)) as kernel:
        await kernel.service(Network).opened()
        source, asks = await kernel.add(Source("source")), await kernel.add(Asks("asks"))
        await kernel.connect(source.out, "near/writer/ends.inp", length=10)
        await kernel.connect(asks.service, "near/writer/ends.service")

        async def call() -> None:
            while True:
                with suppress(AiortsError):
                    await asks.service.proxy.stop(1)
                await asyncio.sleep(0.02)

        def read() -> None:
            if sys.stdin.readline():
                os._exit(3)

        calling = asyncio.ensure_future(call())
        reading = asyncio.ensure_future(asyncio.to_thread(read))
        print("listens", flush=True)
        while not reading.done():
            source.out.write_nowait(TimedLong(0, 0))
            await asyncio.sleep(0.01)
        calling.cancel()


async def end(address: str, certificates: str, way: str, linked: bool) -> None:
    kernel = await Kernel("writer", services=services("connect", address, certificates)).open()
    came = asyncio.Event()
    ends = Ends("ends")
    ends.closes, ends.came = kernel, came.set
    await kernel.start(EventContext(), await kernel.add(ends), activate=True)
    await (came.wait() if linked else asyncio.sleep(0.3))
    print("ready", flush=True)
    ends.way = way
    await WAYS[way](kernel)


# -- ways ----------------------------------------------------------------------------------------------------------


async def unclosed(kernel: Kernel) -> None:
    ending()


async def exits_in_a_task(kernel: Kernel) -> None:
    async def leave() -> None:
        ending()
        sys.exit(7)

    async with aclosing(kernel):
        task = asyncio.create_task(leave())
        await asyncio.sleep(60.0)
        await task


async def fails(kernel: Kernel) -> None:
    async with aclosing(kernel):
        ending()
        raise RuntimeError("on purpose")


async def waits(kernel: Kernel) -> None:
    """Until a signal comes."""
    async with aclosing(kernel):
        ending()
        await asyncio.sleep(60.0)


async def exits_in_a_handler(kernel: Kernel) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    await waits(kernel)


async def until_closed(kernel: Kernel) -> None:
    """Until one of its callbacks has closed it."""
    await kernel.wait_stop_requested()
    await kernel.aclose()


async def in_a_listener(kernel: Kernel) -> None:
    closing: list[asyncio.Task[None]] = []

    def heard(_: object) -> None:
        if not closing:
            ending()
            closing.append(asyncio.create_task(kernel.aclose()))

    kernel.listen(next(iter(kernel.connectors.values())), heard)
    await until_closed(kernel)


async def peer_gone(kernel: Kernel) -> None:
    """While the other one ends without a word."""
    ending()
    await kernel.aclose()


async def with_threads(kernel: Kernel) -> None:
    """Threads live, some of which call into the loop until there is none."""
    loop = asyncio.get_running_loop()

    def call() -> None:
        with suppress(RuntimeError):  # the loop has ended
            while True:
                loop.call_soon_threadsafe(int)
                kernel.request_stop()
                time.sleep(0.001)

    threading.Thread(target=call, daemon=True).start()
    threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
    left = asyncio.ensure_future(asyncio.to_thread(time.sleep, 0.5))  # the interpreter waits for it
    await asyncio.sleep(0.05)
    ending()
    await kernel.aclose()
    left.cancel()


async def closed_twice(kernel: Kernel) -> None:
    ending()
    await asyncio.gather(kernel.aclose(), kernel.aclose())
    await kernel.aclose()


def interrupt(times: int) -> None:
    """Send this process SIGINT, soon and then again."""

    def send() -> None:
        for number in range(times):
            time.sleep(0.01 if number else 0.001 * (os.getpid() % 20))
            os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=send, daemon=True).start()


async def interrupted_in_close(kernel: Kernel, times: int = 1) -> None:
    ending()
    interrupt(times)
    await kernel.aclose()
    await asyncio.sleep(60.0)  # where it was closed sooner


async def interrupted_twice(kernel: Kernel) -> None:
    await interrupted_in_close(kernel, 2)


WAYS: dict[str, Callable[[Kernel], Any]] = {
    "unclosed": unclosed,
    "exit": exits_in_a_task,
    "exception": fails,
    "SIGINT": waits,
    "SIGTERM": waits,
    "exit at SIGTERM": exits_in_a_handler,
    "in a hook": until_closed,
    "in a call": until_closed,
    "in a listener": in_a_listener,
    "peer gone": peer_gone,
    "threads": with_threads,
    "twice": closed_twice,
    "SIGINT in close": interrupted_in_close,
    "two SIGINT in close": interrupted_twice,
}


if __name__ == "__main__":
    where, files, chosen, what, *rest = sys.argv[1:]
    run(listen(where, files) if what == "listen" else end(where, files, what, rest == ["linked"]), loop=chosen)
