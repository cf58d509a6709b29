"""`aiorts at`: run a command with the kernels of other hosts."""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import os
import platform
import re
import signal
import sys
import tempfile
from pathlib import Path
from typing import Final

import click

from aiorts.errors import LinkError
from aiorts.sessions import FEW, FURTHER, remove_left
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import NetworkSettings, endpoints_of, engine_settings, listed
from aiorts_zenoh.security.access import OPERATORS, VIEWER
from aiorts_zenoh.security.probe import probe
from aiorts_zenoh.security.tls import Secured, secured_by

_CONNECTS: Final = 3_000
"""Milliseconds within which the other host answers."""
_ENDPOINT: Final = re.compile(r".+:[0-9]{1,5}")
_FOLDER: Final = "aiorts-at-"
_UNNAMED: Final = re.compile(r"[^A-Za-z0-9_.-]+")


@click.command(
    short_help="Run a command with the kernels of other hosts.", context_settings={"allow_interspersed_args": False}
)
@click.argument("endpoints", metavar="HOST:PORT[,...]")
@click.argument("command", nargs=-1, metavar="[COMMAND]...", type=click.UNPROCESSED)
@click.option("--domain", default="default", show_default=True, help="Whose kernels are meant.")
@click.option("--as", "caller", default="", metavar="NAME", help="Your name there; by default that of user and host.")
@click.option(
    "--certs",
    "certificates",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of certificates; your name there picks yours.",
)
@click.option("--insecure-network", "insecure", is_flag=True, help="Plain TCP without certificates.")
def at(
    endpoints: str, command: tuple[str, ...], domain: str, caller: str, certificates: Path | None, insecure: bool
) -> int:
    """Run COMMAND, such as `ls` or `print imu.out`, with the kernels that are reached at HOST:PORT beside those here.

    A kernel or a router listens there (`aiorts run --listen`). Without COMMAND a shell begins in which all commands
    reach them, until it ends. What they let you do is theirs to say: look, or operate where they run with
    --allow-control.
    """
    if not listed(endpoints) or not all(map(_ENDPOINT.fullmatch, listed(endpoints))):
        raise click.UsageError(f"expected HOST:PORT, the place where the other host listens, got {endpoints!r:.80}")
    settings = NetworkSettings(connect=endpoints, domain=domain, certificates=certificates, insecure=insecure)
    name = _UNNAMED.sub("-", caller or f"{_user()}-{platform.node()}").strip("-.") or "client"
    return asyncio.run(_at(settings, name, command))


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in containers
        return f"user{os.getuid()}"


async def _at(settings: NetworkSettings, caller: str, command: tuple[str, ...]) -> int:
    secured = secured_by(settings.certificates, caller, (VIEWER, *OPERATORS)) if settings.certificates else None
    own = {"connect/timeout_ms": _CONNECTS, "connect/exit_on_failure": True}
    remove_left(_FOLDER)
    with tempfile.TemporaryDirectory(prefix=_FOLDER) as folder:
        gateway = Gateway(
            Path(folder), ClientKeys(settings.domain, caller), {**engine_settings(settings, secured), **own}
        )
        try:
            await _open(gateway, settings, secured)
            if command and len(gateway.peers) > FEW:
                gateway.ask_early("names")  # while the command begins
            return await _run(command, folder)
        finally:
            await gateway.close()


async def _open(gateway: Gateway, settings: NetworkSettings, secured: Secured | None) -> None:
    """Open the gateway. LinkError: no kernel is reached; the text has the reason that a probe of each place found."""
    try:
        await gateway.open()
    except LinkError as error:
        identity = None if secured is None else secured.identity
        places = [(f"{host}:{port}", probe(host, port, identity)) for host, port in endpoints_of(settings.connect)]
        said = [f"{place} {why}" for place, why in places if why]
        raise LinkError("; ".join(said) or str(error)) from None


async def _run(command: tuple[str, ...], folder: str) -> int:
    """Run the command; return its exit status."""
    before = os.environ.get(FURTHER)
    environment = os.environ | {FURTHER: f"{before}{os.pathsep}{folder}" if before else folder}
    words = (sys.executable, "-m", "aiorts", *command) if command else (os.environ.get("SHELL") or "/bin/sh",)
    child = await asyncio.create_subprocess_exec(*words, env=environment)
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGINT, lambda: None)  # the command has it, too, and ends as it likes
    for number in (signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, _pass_on, child, number)
    status = await child.wait()
    return status if status >= 0 else 128 - status


def _pass_on(child: asyncio.subprocess.Process, number: int) -> None:
    with contextlib.suppress(ProcessLookupError):  # it has ended
        child.send_signal(number)
