"""New codes for the same user, and the way of a browser to the server: by files that only this user can open."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import time
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from html import escape
from pathlib import Path
from typing import Final, NamedTuple

from anyio import to_thread

from aiorts.errors import AbsentError
from aiorts.sessions import private_folder
from aiorts_studio.codes import CODE_SECONDS, Codes

_PRIVATE: Final = 0o600
_SECONDS: Final = 5.0
"""Seconds within which a server gives a code."""
_LONGEST: Final = 4_096


class Invitation(NamedTuple):
    """The address of a server, and a code for it."""

    url: str
    code: str


def folder() -> Path:
    """The folder of the servers of this user; ControlError: it is not safe."""
    found = private_folder() / "studio"
    found.mkdir(mode=0o700, exist_ok=True)
    return found


class Entrance:
    """Gives codes for one server."""

    def __init__(self, url: str, codes: Codes) -> None:
        self._url, self._codes = url, codes
        self._redirect: Path | None = None
        self._removal: asyncio.TimerHandle | None = None

    def invite(self) -> Invitation:
        """A new code; the code before is no longer good."""
        self.remove_redirect()
        return Invitation(self._url, self._codes.issue(time.monotonic()))

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """While the block runs, give login codes to this user's commands."""
        path = folder() / f"{os.getpid()}.sock"
        path.unlink(missing_ok=True)  # left by a process that was killed
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listening:
            listening.bind(str(path))
            try:
                path.chmod(_PRIVATE)  # its folder is private
                async with await asyncio.start_unix_server(self._give, sock=listening):
                    yield
            finally:
                self.remove_redirect()
                path.unlink(missing_ok=True)

    async def _give(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(json.dumps(self.invite()).encode())
        with suppress(OSError):
            writer.close()
            await writer.wait_closed()

    async def show(self, invitation: Invitation) -> None:
        """Open the server in the user's browser; no argument of a process has the code in it."""
        self._redirect = path = _redirect(invitation)
        self._removal = asyncio.get_running_loop().call_later(CODE_SECONDS, self.remove_redirect)
        await to_thread.run_sync(webbrowser.open, path.as_uri())

    def remove_redirect(self) -> None:
        """Remove the file that leads a browser here, if there is one: its code was used, or is no longer good."""
        if self._removal is not None:
            self._removal.cancel()
        if self._redirect is not None:
            self._redirect.unlink(missing_ok=True)
        self._redirect = self._removal = None


def _redirect(invitation: Invitation) -> Path:
    """A page that leads a browser to a server; the part behind # is known to the browser and the page alone."""
    path = folder() / f"{secrets.token_hex(8)}.html"
    target = escape(f"{invitation.url}/#{invitation.code}")
    page = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={target}">'
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _PRIVATE), "w", encoding="utf-8") as file:
        file.write(page)
    return path


def invitations() -> list[Invitation]:
    """A new code of each server of this user that answers.

    Raises:
        AbsentError: no server runs.
    """
    found = [one for path in sorted(folder().glob("*.sock")) if (one := _invitation(path)) is not None]
    if not found:
        raise AbsentError("no studio of yours runs; `aiorts studio --api` starts one")
    return found


def _invitation(path: Path) -> Invitation | None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(_SECONDS)
        try:
            asking.connect(str(path))
            data = b""
            while len(data) < _LONGEST and (part := asking.recv(_LONGEST)):
                data += part
            url, code = json.loads(data)
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)  # its process was killed
            return None
        except (OSError, ValueError):
            return None
    return Invitation(str(url), str(code))
