"""A kernel inside a web application: it opens when the server starts and closes when the server stops.

`app` is a plain ASGI application; give it to any server: `uvicorn asgi_lifespan:app`. Started as a script it plays the
server itself.

Run: python examples/embedding/asgi_lifespan.py
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from aiorts import Component, Kernel, PeriodicContext

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]


class Counter(Component):
    """Counts its ticks."""

    count = 0

    def on_execute(self) -> None:
        self.count += 1


async def lifespan(scope: Message, receive: Receive, send: Send) -> None:
    """The kernel lives as long as the application; what fails at the start, the server reports."""
    await receive()
    async with Kernel() as kernel:
        counter = scope["state"]["counter"] = await kernel.create(Counter)
        await kernel.start(PeriodicContext(rate=100.0), counter, activate=True)
        await send({"type": "lifespan.startup.complete"})
        await receive()
    await send({"type": "lifespan.shutdown.complete"})


async def app(scope: Message, receive: Receive, send: Send) -> None:
    """Answers every request with the count."""
    if scope["type"] == "lifespan":
        await lifespan(scope, receive, send)
    elif scope["type"] == "http":
        body = f"{scope['state']['counter'].count} ticks\n".encode()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"text/plain")]})
        await send({"type": "http.response.body", "body": body})


async def play_server() -> None:
    """What a server does with an application: start it, ask it once, stop it."""
    events: asyncio.Queue[Message] = asyncio.Queue()
    answers: asyncio.Queue[Message] = asyncio.Queue()
    state: dict[str, Any] = {}
    running = asyncio.create_task(app({"type": "lifespan", "state": state}, events.get, answers.put))
    await events.put({"type": "lifespan.startup"})
    print((await answers.get())["type"])

    await asyncio.sleep(0.3)
    await app({"type": "http", "path": "/", "state": state}, events.get, answers.put)
    await answers.get()
    print((await answers.get())["body"].decode().strip())

    await events.put({"type": "lifespan.shutdown"})
    print((await answers.get())["type"])
    await running


if __name__ == "__main__":
    asyncio.run(play_server())
