"""`aiorts foxglove`: serve what runs to Foxglove."""

from __future__ import annotations

import asyncio
from typing import Any, Final

import click

from aiorts import exits, import_types
from aiorts.errors import AbsentError, AmbiguousError, ClosedError, NoAnswerError
from aiorts.sessions import AsyncClient, entries
from aiorts_foxglove.admission import ORIGINS
from aiorts_foxglove.serving import Serving, goodbye

_POLL: Final = 0.25
"""Seconds between looks for a kernel while the command waits for one."""


def _kernels(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    return [one.name for one in entries() if one.name.startswith(incomplete)]


@click.command(short_help="Show what runs in Foxglove.")
@click.argument("kernel", default="", shell_complete=_kernels)
@click.option("--port", type=click.IntRange(0, 65_535), default=0, help="Listen there; 0 is any that is free.")
@click.option("--origin", "origins", multiple=True, metavar="URL", help="Let this page connect, too; repeatable.")
@click.option("--wait", is_flag=True, help="Wait for the kernel: at the start, and each time it has ended.")
@click.option(
    "--type-mod",
    "modules",
    multiple=True,
    metavar="MODULE",
    help="Import MODULE or FILE.py, which defines types: their samples then have a schema.",
)
def foxglove(kernel: str, port: int, origins: tuple[str, ...], wait: bool, modules: tuple[str, ...]) -> int:
    """Serve what runs over Foxglove's WebSocket protocol; without KERNEL it is the only one that runs.

    Open the address that is printed in Foxglove, as a connection of the kind Foxglove WebSocket. Each out-port is a
    topic; poses, transforms, scans and images are what its 3D and Image panels draw. Samples of a port are taken
    while a viewer shows it. What a viewer is too slow for is dropped and counted; the system is not slowed down, and
    nothing can be changed through it.

    It listens on 127.0.0.1. Pages of app.foxglove.dev and of this machine may connect, others with --origin. It ends
    with the kernel.
    """
    import_types(modules)
    return asyncio.run(_serve(kernel, port, frozenset({*ORIGINS, *origins}), wait=wait))


async def _serve(kernel: str, port: int, origins: frozenset[str], *, wait: bool) -> int:
    serving = Serving(origins, _say)
    async with await serving.listen(port) as listening:
        client = await _found(kernel, wait=wait)
        host, port = listening.sockets[0].getsockname()[:2]
        click.echo(f"{client.entry.name}: ws://{host}:{port}")
        while True:
            word = kernel or client.entry.name
            why = await serving.show(client)
            _say(why)
            serving.gone(f"{why}; waiting for it" if wait else why)
            if not wait:
                await goodbye(listening)
                return exits.DONE
            client = await _found(word, wait=True)
            _say(f"{client.entry.name}: is there again")


async def _found(word: str, *, wait: bool) -> AsyncClient:
    """A session with the kernel that a word names; AiortsError where there is none, unless it is waited for."""
    said = False
    while True:
        try:
            return await AsyncClient.open(word, right="view")
        except AmbiguousError:
            raise
        except (AbsentError, NoAnswerError, ClosedError) as error:
            if not wait:
                raise
            if not said:
                said = True
                _say(f"{error}; waiting for it")
        await asyncio.sleep(_POLL)


def _say(text: str) -> None:
    click.echo(f"aiorts foxglove: {text}", err=True)
