"""`aiorts router`: the place where the kernels of many hosts meet."""

from __future__ import annotations

import asyncio
import signal

import click

from aiorts import exits
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.network import NetworkSettings, engine_settings


@click.command(short_help="Let the kernels of many hosts meet in one place.")
@click.option("--listen", required=True, metavar="HOST:PORT[,...]", help="Where kernels and commands connect to.")
@click.option("--connect", default="", metavar="HOST:PORT[,...]", help="Other routers.")
@click.option("--insecure-network", "insecure", is_flag=True, help="Plain TCP without certificates.")
def router(listen: str, connect: str, insecure: bool) -> int:
    """Carry what kernels say to each other, until a signal ends it.

    Kernels connect to it (`aiorts run --connect`), and need no port of their own. It has no kernel itself, and keeps
    nothing: when it is started anew, kernels find it and each other again.
    """
    return asyncio.run(_route(NetworkSettings(listen=listen, connect=connect, insecure=insecure)))


async def _route(settings: NetworkSettings) -> int:
    loop, ended, engine = asyncio.get_running_loop(), asyncio.Event(), Engine()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, ended.set)
    await in_thread(lambda: engine.open({**engine_settings(settings), "mode": "router"}, Inbox(loop)))
    try:
        click.echo(f"aiorts router: listens at {settings.listen}", err=True)
        await ended.wait()
    finally:
        await in_thread(engine.close)
    return exits.DONE
