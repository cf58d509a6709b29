"""`aiorts studio`: serve what runs to pages and programs."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from aiorts import exits
from aiorts.control import Right
from aiorts.errors import ConfigurationError, MissingExtra
from aiorts.late import dataclass
from aiorts_studio.codes import GOOD_ONCE
from aiorts_studio.entrance import Entrance, Invitation, invitations

if TYPE_CHECKING:
    from ssl import SSLContext

    from aiorts_studio.api import Api
    from aiorts_studio.watching.studio import Studio

_NO_FILES: Final = "start it with --files FOLDER, where recordings are to go"
_NO_FILES_BEYOND: Final = "pages beyond the machine record nothing"
_UNSEEN: Final = 600.0
"""Seconds for which the page of a run that has ended stays without being open."""
_CLOSED: Final = 10.0
"""Seconds for which the server stays after the last page was closed: a page that is reloaded is back by then."""
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@click.command(short_help="Show what runs in a browser.")
@click.argument("kernels", metavar="[KERNEL]...", nargs=-1)
@click.option("--api", is_flag=True, help="For programs: print no more than the address and the code.")
@click.option("--url", is_flag=True, help="Print a new address of the server that runs; with --api address and code.")
@click.option("--port", type=click.IntRange(0, 65_535), default=0, help="Listen there; 0 is any that is free.")
@click.option("--edit", is_flag=True, help="Clients may change what runs; else they only look.")
@click.option("--open", "opens", is_flag=True, help="Open the browser.")
@click.option(
    "--pages",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="FOLDER",
    help="Serve pages of yours at /pages/NAME: the files that are in FOLDER now.",
)
@click.option(
    "--files",
    type=click.Path(path_type=Path, exists=True, file_okay=False, writable=True),
    metavar="FOLDER",
    help="Where recordings go that are begun on the page.",
)
@click.option("--beside", is_flag=True, hidden=True, help="Begun by a run, whose end standard input says.")
@click.option("--layout", type=click.Path(path_type=Path), hidden=True, help="The file for places that a user chose.")
@click.option("--bind", metavar="ADDRESS", help="Listen at this address, for other machines; needs --certs.")
@click.option(
    "--certs",
    "certificates",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of certificates, for TLS; --name picks the server's.",
)
@click.option("--name", default="studio", show_default=True, help="Of the server, in its certificate.")
def studio(
    kernels: tuple[str, ...],
    api: bool,
    url: bool,
    port: int,
    edit: bool,
    opens: bool,
    pages: Path | None,
    files: Path | None,
    beside: bool,
    layout: Path | None,
    bind: str | None,
    certificates: Path | None,
    name: str,
) -> int:
    """Show what runs in a browser, and serve it to programs over HTTP.

    Without KERNEL it shows all systems of this user, also those that start later. It prints an address, which is good
    once and for 60 s: it ends with a code, which the page asks for where it was left out. --url prints a new one. It
    ends with Ctrl-C. /docs has the HTTP API.
    """
    if url:
        for one in invitations():
            _print(one, bare=api)
        return exits.DONE
    for word in kernels:
        if word.endswith((".toml", ".xml")) or Path(word).is_file():
            raise click.UsageError(f"{word} names a file; `aiorts run {word} --studio` runs it and shows it")
    if (bind is None) != (certificates is None):
        raise ConfigurationError("--bind and --certs: beyond this machine there is TLS only; give both or neither")
    if bind is not None and edit:
        raise ConfigurationError("--edit: what runs is changed from this machine alone, and never with --bind")
    if files is not None and bind is not None:
        raise ConfigurationError("--files: recordings are begun from this machine alone, and never with --bind")
    for needed in ("starlette", "uvicorn", "websockets"):
        if find_spec(needed) is None:
            raise MissingExtra("aiorts studio", needed, "studio")
    from aiorts_studio.api import PAGES
    from aiorts_studio.serving import HOST, secured
    from aiorts_studio.watching.places import PlaceFiles, state_folder
    from aiorts_studio.watching.studio import Studio

    tls, names = (None, (HOST, "localhost")) if certificates is None else secured(certificates, name, bind or HOST)
    right = Right.OPERATE if edit else Right.VIEW
    own = () if pages is None else sorted(pages.iterdir())
    shown = {one.name: one for one in own if one.suffix in PAGES and one.is_file()}
    # Pages on other machines write nothing.
    places = PlaceFiles(state_folder(), layout, _say) if bind is None else None
    watched = Studio(kernels, files, _NO_FILES if bind is None else _NO_FILES_BEYOND, places)
    serving = _Serving(names, port, tls, right, shown, watched, opens=opens, bare=api, beside=beside)
    return asyncio.run(serving.run())


@dataclass(frozen=True, slots=True)
class _Serving:
    """A server: its settings, its begin and its end."""

    names: Sequence[str]
    port: int
    tls: SSLContext | None
    right: Right
    pages: Mapping[str, Path]
    studio: Studio
    opens: bool
    bare: bool
    """Whether only the address and the code are printed, for programs."""
    beside: bool
    """Whether it serves a run, which writes its status to the server's standard input, and closes that to end it."""

    async def run(self) -> int:
        """Serve until a signal comes."""
        from aiorts_studio.api import Api
        from aiorts_studio.guard import hosts_of
        from aiorts_studio.serving import bound, served

        try:
            listening = bound(self.names[0], self.port)
        except ConfigurationError:
            if not self.beside:
                raise
            listening = bound(self.names[0], 0)  # another run of the same has it
        loop, over = asyncio.get_running_loop(), asyncio.Event()
        for number in _SIGNALS:
            loop.add_signal_handler(number, over.set)
        scheme = "http" if self.tls is None else "https"
        ours = hosts_of(scheme, self.names, listening.getsockname()[1])
        api = Api(scheme, ours, self.right, _say, self.pages, self.studio)
        entrance = Entrance(f"{scheme}://{ours[0]}", api.codes)
        api.exchanged = entrance.remove_redirect
        async with entrance.open(), served(listening, api.app, self.tls):
            invitation = entrance.invite()
            _print(invitation, bare=self.bare)
            if not self.bare and not self.beside:
                _say(f"{GOOD_ONCE}; Ctrl-C ends it")
            if self.opens:
                await entrance.show(invitation)
            if self.beside:
                outlasting = asyncio.create_task(self._outlast(api, entrance, over), name="studio of a run")
                outlasting.add_done_callback(lambda _: over.set())
            await over.wait()
            await api.close("the run has ended" if self.beside else "aiorts studio was ended")
        return exits.DONE

    async def _outlast(self, api: Api, entrance: Entrance, over: asyncio.Event) -> None:
        """Show the run from its beginning, and its last state after its end while a page is open or may yet be."""
        loop, said = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(0, said.set)
        async with self.studio.watching():
            await said.wait()
            loop.remove_reader(0)
            if word := os.read(0, 16).decode().strip():
                self.studio.say_ended(f"has ended with status {word}")
                if self.studio.pages or not api.codes.count:
                    where = "" if self.studio.pages else f" at {_address(entrance.invite())}"
                    _say(f"the run has ended with status {word}; its page stays{where}; Ctrl-C ends it")
                    loop.add_reader(0, over.set)
                    await self.studio.unattended(_UNSEEN, _CLOSED)


def _print(invitation: Invitation, *, bare: bool) -> None:
    for line in invitation if bare else (_address(invitation),):
        click.echo(line)


def _address(invitation: Invitation) -> str:
    """The address that signs a browser in."""
    return f"{invitation.url}/#{invitation.code}"


def _say(text: str) -> None:
    click.echo(f"aiorts studio: {text}", err=True)
