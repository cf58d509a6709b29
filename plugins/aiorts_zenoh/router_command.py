"""`aiorts router`: the place where the kernels of many hosts meet."""

from __future__ import annotations

import asyncio
import logging
import signal
from pathlib import Path
from typing import Final

import click

from aiorts import exits
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.neighbours import Neighbours
from aiorts_zenoh.network import PATIENCE, NetworkSettings, check_free, endpoints_of, engine_settings, listed
from aiorts_zenoh.security.access import ROUTER
from aiorts_zenoh.security.tls import secured_by

_OWN: Final = {
    "mode": "router",
    "transport/unicast/max_sessions": 10_000,  # a fleet meets here
    # A router that waits for a blocked neighbour carries nothing. Kernels wait longer: else they would give it up.
    PATIENCE: 250_000,
}


@click.command(short_help="Let the kernels of many hosts meet in one place.")
@click.option("--listen", required=True, metavar="HOST:PORT[,...]", help="Where kernels and commands connect to.")
@click.option("--connect", default="", metavar="HOST:PORT[,...]", help="Other routers.")
@click.option(
    "--certs",
    "certificates",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of certificates; --name picks the router's.",
)
@click.option("--name", default="router", show_default=True, help="Of the router, in its certificate.")
@click.option("--domain", default="default", show_default=True, help="Whose kernels it carries, with certificates.")
@click.option("--insecure-network", "insecure", is_flag=True, help="Plain TCP without certificates.")
def router(listen: str, connect: str, certificates: Path | None, name: str, domain: str, insecure: bool) -> int:
    """Carry what kernels say to each other, until a signal ends it.

    Kernels connect to it (`aiorts run --connect`), and need no port of their own. It has no kernel itself, and keeps
    nothing: when it is started anew, kernels find it and each other again. With certificates it passes on only what the
    role of each name allows.
    """
    settings = NetworkSettings(
        listen=listen, connect=connect, domain=domain, certificates=certificates, insecure=insecure
    )
    return asyncio.run(_route(settings, name))


async def _route(settings: NetworkSettings, name: str) -> int:
    for endpoint in listed(settings.listen):
        check_free(endpoint)
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, ended.set)
    first = True
    while not ended.is_set():
        await _route_until(ended, settings, name, say=first)
        first = False
    return exits.DONE


async def _route_until(ended: asyncio.Event, settings: NetworkSettings, name: str, *, say: bool) -> None:
    """Carry until a signal comes, or a name is revoked: the engine takes a new table of names only when it starts."""
    secured = secured_by(settings.certificates, name, (ROUTER,)) if settings.certificates else None
    neighbours = Neighbours(endpoints_of(settings.connect), secured, logging.getLogger("aiorts.zenoh").warning)
    engine, loop, due = Engine(), asyncio.get_running_loop(), asyncio.Event()
    neighbours.denies.append(lambda _: due.set())
    own = {**engine_settings(settings, secured), **_OWN}
    await in_thread(lambda: engine.open(own, Inbox(loop)))
    waits = [loop.create_task(one.wait()) for one in (ended, due)]
    try:
        neighbours.start()
        await in_thread(lambda: neighbours.watch_all(engine, settings.domain))
        if say:
            click.echo(f"aiorts router: listens at {settings.listen}", err=True)
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
        neighbours.close()
        await in_thread(engine.close)
