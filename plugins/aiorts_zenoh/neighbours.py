"""Watches the connections of a kernel or router, and logs, once, why a connection is refused or does not come about.

The engine refuses without a word. So a place that is not reached gets a handshake from here (`security.probe`), which
finds out why. Of connected neighbours the engine gives the name in their certificate.

Names that are revoked while this runs are denied from then on: the folder of certificates is looked into once a second.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Final

from aiorts_zenoh.engine import Engine, in_thread
from aiorts_zenoh.keys import ClientKeys, Keys, denied, peer_of
from aiorts_zenoh.security.folder import Folder
from aiorts_zenoh.security.probe import probe
from aiorts_zenoh.security.revoking import EVERY, Revoking
from aiorts_zenoh.security.tls import Secured

_FIRST: Final = 1.5
"""Seconds for connections to come about, before it is found out why one has not."""
_AGAIN: Final = 10.0
_SHOWS: Final = 5.0
"""Seconds within which a kernel that is connected shows its token."""
_SAID: Final = 1_000
"""The most different lines in the log."""


class Neighbours:
    """Watches the connections of one kernel.

    Args:
        endpoints: host and port of each place that it connects to.
        secured: its certificate and the access table; None: there are no certificates.
        report: takes a text for the log.
        listens: the ports at which others connect to it.
    """

    def __init__(
        self,
        endpoints: Sequence[tuple[str, int]],
        secured: Secured | None,
        report: Callable[[str], None],
        listens: Collection[int] = (),
    ) -> None:
        self._endpoints, self._secured, self._report, self._listens = endpoints, secured, report, listens
        self._links: dict[tuple[str, str], str] = {}
        """The name in the certificate of each connected neighbour, by the addresses of both ends."""
        self._shown: set[str] = set()
        """Names of kernels whose token was seen."""
        self._said: set[str] = set()
        self._hold: Callable[[str], None] = lambda name: None
        """Tells a name that it was revoked; may wait for the network."""
        self._held: list[object] = []
        """The tokens that tell revoked names; a token ends when nothing refers to it."""
        self.denies: list[Callable[[str], None]] = []
        """Called with each name that is revoked while this runs."""
        self._timers: list[asyncio.TimerHandle] = []
        self._loop: asyncio.AbstractEventLoop
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the certificates of the connected neighbours."""
        return tuple(dict.fromkeys(self._links.values()))

    def admits(self, name: str) -> bool:
        """Whether a kernel of this name may be there; a kernel that the engine's table did not stop is reported."""
        if self._secured is None:
            return True
        if self._secured.access.is_kernel(name):
            self._shown.add(name)
            return True
        self._say(f"a kernel named {name!r} is not taken: {self._secured.access.fault(name) or 'it has another role'}")
        return False

    @property
    def is_bound(self) -> bool:
        """Whether a kernel's name is that of its certificate."""
        return self._secured is not None

    def heeds(self, name: str) -> bool:
        """Whether a kernel of this name may tell of tokens that this one does not see: if this one connects to it.

        A kernel that connects here by itself may tell nothing: it could take away the name of this kernel.
        """
        if self._secured is None:
            return True
        return any(
            name == there and _port_of(source) not in self._listens for (source, _), there in self._links.items()
        )

    def admits_client(self, name: str, operates: bool) -> bool:
        """Whether a client of this name may look, or operate."""
        return self._secured is None or self._secured.access.is_client(name, operates)

    def declare(self, engine: Engine, keys: Keys) -> None:
        """Watch from now on. The call may wait for the network."""
        self.watch(engine, keys.domain)

    def watch_all(self, engine: Engine, domain: str) -> None:
        """Watch from now on, where there is no kernel whose `Presence` looks at the tokens of others: in a router."""
        self.watch(engine, domain)
        engine.presence(ClientKeys(domain, "").tokens, self._token)

    def watch(self, engine: Engine, domain: str) -> None:
        """Watch from now on, in a domain."""
        engine.neighbours(self._linked)
        if self._secured is None:
            return
        own = self._secured.identity.name
        engine.presence(denied(domain, own, "*"), self._denied)
        self._hold = lambda name: self._held.append(engine.hold(denied(domain, name, own)))
        for name in self._secured.access.denied:
            self._hold(name)

    def start(self) -> None:
        """Look from now on why a place is not reached, and which names are revoked; called on the loop."""
        self._loop = asyncio.get_running_loop()
        if self._endpoints:
            self._tasks.append(self._loop.create_task(self._look(), name="aiorts zenoh neighbours"))
        if self._secured is not None:
            revoking = Revoking(
                Folder(self._secured.identity.certificate.parent), self._secured.access.denied, self._say
            )
            self._tasks.append(self._loop.create_task(self._watch_index(revoking), name="aiorts zenoh revoked"))
        for task in self._tasks:
            task.add_done_callback(self._ended)

    def close(self) -> None:
        """Watch nothing any more."""
        for timer in self._timers:
            timer.cancel()
        for task in self._tasks:
            task.cancel()

    def _ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self._report(f"zenoh: {task.get_name()} has ended: {error!r}")

    # -- connected neighbours --------------------------------------------------------------------------------------

    def _linked(self, name: str, source: str, target: str, up: bool) -> None:
        if not up:
            self._links.pop((source, target), None)
            return
        self._links[source, target] = name
        if self._secured is None:
            return
        if fault := self._secured.access.fault(name):
            self._say(f"{target.rpartition(':')[0]} is refused: {fault}")
        elif self._secured.access.is_kernel(name) and name not in self._shown:
            self._timers = [one for one in self._timers if one.when() > self._loop.time()]
            self._timers.append(self._loop.call_later(_SHOWS, self._shows_nothing, name, target))

    def _token(self, token: str, up: bool) -> None:
        if self._secured is None or not up or (peer := peer_of(token)) is None:
            return
        if self._secured.access.is_kernel(peer.kernel):  # a token may hold any name, and others are never looked for
            self._shown.add(peer.kernel)

    def _shows_nothing(self, name: str, target: str) -> None:
        if name not in self._shown and name in self._links.values():
            self._say(
                f"{target} is connected as {name!r}, and shows no kernel of that name: it has another name than its "
                "certificate, or this kernel has no role there"
            )

    def _denied(self, token: str, up: bool) -> None:
        """Report that another kernel or router refuses this name as revoked; this holds for that one alone."""
        if up:
            *_, own, teller = token.split("/")
            self._say(f"{teller!r} says that the name {own!r} was revoked: it takes nothing from this kernel")

    def _say_revoked(self, own: str) -> None:
        self._say(f"the name {own!r} was revoked: others take nothing from this kernel")

    async def _watch_index(self, revoking: Revoking) -> None:
        assert self._secured is not None  # noqa: S101 - there is no index without certificates
        while True:
            new = sorted(await in_thread(revoking.look))
            self._secured = self._secured._replace(access=self._secured.access.without(new))
            for name in new:
                await self._deny(name, self._secured.identity.name)
            await asyncio.sleep(EVERY)

    async def _deny(self, name: str, own: str) -> None:
        """Cut off a revoked name in every part. A failure in one part is logged, and the others go on."""
        if name == own:
            self._say_revoked(own)
        else:
            self._say(f"{name!r} was revoked: its links are cut, and nothing of it is taken any more")
        for deny in self.denies:
            try:
                deny(name)
            except Exception as error:  # noqa: BLE001 - whatever it is, the rest is cut off
                self._say(f"{name!r} was revoked, and is not cut off everywhere: {error!r}")
        try:
            await in_thread(partial(self._hold, name))
        except Exception as error:  # noqa: BLE001 - as above
            self._say(f"{name!r} was revoked, and cannot be notified: {error!r}")

    # -- places not reached ----------------------------------------------------------------------------------------

    async def _look(self) -> None:
        await asyncio.sleep(_FIRST)
        while True:
            for host, port in self._endpoints:
                if why := await in_thread(partial(self._probe, host, port)):
                    self._say(f"{host}:{port} {why}")
            await asyncio.sleep(_AGAIN)

    def _probe(self, host: str, port: int) -> str:
        """The reason why host:port is not reached; "" where it is, or where none is found."""
        reached = {target.partition("/")[2] for _, target in tuple(self._links)}
        try:
            addresses = {found[4][0] for found in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}
        except (OSError, UnicodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "is no name of a host"
            return f"is not reached: {why}"
        if any(f"[{one}]:{port}" in reached or f"{one}:{port}" in reached for one in addresses):
            return ""
        return probe(host, port, self._secured and self._secured.identity)

    def _say(self, text: str) -> None:
        if text not in self._said and len(self._said) < _SAID:
            self._said.add(text)
            self._report(f"zenoh: {text}")


def _port_of(source: str) -> int:
    """The port of an address as the engine gives it; -1: it has none. Metadata may follow it."""
    port = source.partition("?")[0].partition("#")[0].rpartition(":")[2]
    return int(port) if port.isdecimal() else -1
