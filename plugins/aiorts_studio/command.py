"""`aiorts studio`: serve what runs to pages and programs."""

from __future__ import annotations

import asyncio
import signal
import time
from typing import Final

import click

from aiorts import exits
from aiorts.control import Right
from aiorts.errors import MissingExtra

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command(short_help="Serve what runs over HTTP.")
@click.option("--api", is_flag=True, help="Serve the HTTP API.")
@click.option("--port", type=click.IntRange(0, 65_535), default=0, help="Listen there; 0 is any that is free.")
@click.option("--edit", is_flag=True, help="Clients may change what runs; else they only look.")
def studio(api: bool, port: int, edit: bool) -> int:
    """Serve what runs over HTTP, to pages and programs of this machine.

    It prints its address, and on a second line a code. A client exchanges the code for a token; the code is good once
    and for 60 s.
    """
    return asyncio.run(_serve(port, Right.OPERATE if edit else Right.VIEW))


async def _serve(port: int, right: Right) -> int:
    _check_installed()
    from aiorts_studio.api import Api
    from aiorts_studio.serving import HOST, bound, served

    loop, over = asyncio.get_running_loop(), asyncio.Event()
    for number in _SIGNALS:
        loop.add_signal_handler(number, over.set)
    listening = bound(HOST, port)
    port = listening.getsockname()[1]
    api = Api("http", (f"{HOST}:{port}", f"localhost:{port}"), right, _say, lambda: None)
    async with served(listening, api.app):
        click.echo(f"http://{HOST}:{port}")
        click.echo(api.codes.issue(time.monotonic()))
        await over.wait()
        await api.close()
    return exits.DONE


def _check_installed() -> None:
    for name in ("starlette", "uvicorn", "websockets"):
        try:
            __import__(name)
        except ImportError:
            raise MissingExtra("aiorts studio", name, "studio") from None


def _say(text: str) -> None:
    click.echo(f"aiorts studio: {text}", err=True)
