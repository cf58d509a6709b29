"""The service `zenoh`: other hosts are reached with a Zenoh session, where the user has asked for it."""

from __future__ import annotations

import asyncio
import logging
import platform
import re
import socket
from collections.abc import Mapping
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aiorts import KernelService, setting
from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.links import RIGHTS, Allowed
from aiorts_zenoh.keys import base_of
from aiorts_zenoh.security.access import COORDINATOR, KERNELS, OPERATORS, Access
from aiorts_zenoh.security.tls import Secured, secured_by, tls_settings

if TYPE_CHECKING:
    from aiorts import Microkernel
    from aiorts_zenoh.neighbours import Neighbours
    from aiorts_zenoh.serving import Serving
    from aiorts_zenoh.transport import ZenohTransport

_LOG: Final = logging.getLogger("aiorts.zenoh")
_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,252}")
"""A valid part of a key; the user has to name a host whose own name is not valid."""
LEASE: Final = 2.5
"""Seconds without a word after which a connection is over."""
PATIENCE: Final = "transport/link/tx/queue/congestion_control/block/wait_before_close"
_HARDENED: Final[Mapping[str, Any]] = {
    "transport/link/tx/lease": int(LEASE * 1_000),
    # A lost link is noticed a lease after the last message came: with so many messages in a lease, within 3 s.
    "transport/link/tx/keep_alive": 8,
    # A silent connection keeps its place for a second. There are enough places for other connections meanwhile.
    "transport/unicast/accept_timeout": 1_000,
    "transport/unicast/accept_pending": 2_000,
    # The microseconds that a message waits for room at a neighbour that stands still.
    PATIENCE: 500_000,
    "transport/unicast/max_sessions": 256,  # more machines meet in a router
    # By default the engine would put together, in memory, messages that say that they have 1 GiB.
    "transport/link/rx/max_message_size": 16 << 20,
    "transport/shared_memory/enabled": False,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "adminspace": {"enabled": False, "permissions": {"read": False, "write": False}},
    "plugins_loading/enabled": False,
    # Questions of aiorts have time-outs of their own; this one is for others' questions that pass through here.
    "queries_default_timeout": 2_000,
}
"""Settings by which the engine offers a peer nothing that is not needed, and no peer holds the engine up for long."""


_PORTS: Final = {
    "type": "object",
    "additionalProperties": {"type": "array", "items": {"type": "string"}},
}
"""The schema of a right in `allow`: patterns by name."""


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """How kernels of other hosts are reached. Nothing is looked for by itself, and nothing listens without `listen`."""

    listen: str = setting(
        "", "host:port that kernels of other hosts connect to; several with commas between them.", option="--listen"
    )
    connect: str = setting(
        "", "host:port of kernels or routers of other hosts; several with commas between them.", option="--connect"
    )
    host: str = setting("", "The name by which others know this machine; by default its own.", option="--host")
    domain: str = setting("default", "Kernels of different domains do not see each other.")
    certificates: Path | None = setting(
        None, "Folder of certificates, made with aiorts certs: who reaches the port shows one.", option="--certs"
    )
    access: Any = setting(
        None,
        "Names by what they may do: viewer, operator, component, coordinator, router; by default as the index of the "
        "folder says.",
        schema={"type": "object", "additionalProperties": {"type": "array", "items": {"type": "string"}}},
    )
    allow: Any = setting(
        None,
        "What the kernels of which names may read, write and call here: patterns of COMPONENT.PORT by name; those of "
        '"*" are for all other names. A right that is not there all have.',
        schema={"type": "object", "properties": dict.fromkeys(RIGHTS, _PORTS), "additionalProperties": False},
    )
    insecure: bool = setting(
        False,
        "Plain TCP without certificates: all that reach the port see and do everything.",
        option="--insecure-network",
    )
    rename: bool = setting(
        False,
        "Take name-2, or the next that is free, where another kernel of this machine has the name in the network.",
        option="--rename",
    )
    allow_control: bool = setting(
        False, "Let clients of other hosts change what runs, not only look at it.", option="--allow-control"
    )

    def __post_init__(self) -> None:
        for key in ("listen", "connect"):
            for endpoint in listed(getattr(self, key)):
                host, colon, port = endpoint.rpartition(":")
                if not (host and colon and port.isdecimal() and int(port) < 65_536):
                    raise ConfigurationError(f"{key}: expected host:port, got {endpoint!r:.80}")
        if self.insecure and self.certificates is not None:
            raise ConfigurationError("insecure: there are certificates as well; give one of them")
        if (self.listen or self.connect) and not self.insecure and self.certificates is None:
            raise ConfigurationError(
                "certificates: other hosts are reached with certificates alone; give their folder (--certs), which "
                "aiorts certs makes, or say insecure = true (--insecure-network) in a network that is yours alone"
            )
        if self.rename and self.certificates is not None:
            raise ConfigurationError("rename: with certificates a kernel has the name in its certificate, and no other")
        if self.access is not None:
            Access.of_table(self.access)
        if self.allow is not None:
            Allowed.of_table(self.allow)
            if self.certificates is None:
                raise ConfigurationError("allow: names are known by certificates alone; give their folder (--certs)")
        _check_name("domain", self.domain)
        if self.host:
            _check_name("host", self.host)


class Network(KernelService):
    """The kernels of other hosts. Its transport carries links in addition to that of this host."""

    name = "zenoh"
    settings = NetworkSettings
    last = True
    """Configured after the other services: these are given the kernel's name, which picks the certificate."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._opening: asyncio.Task[None] | None = None
        self._transport: ZenohTransport | None = None
        self._serving: Serving | None = None
        self._neighbours: Neighbours | None = None
        self._security, self._allow = "", None
        self._open_to_others: list[str] = []
        """Endpoints that other machines reach."""

    def configure(self, settings: NetworkSettings) -> None:
        from aiorts.links import Links  # late: `aiorts at` needs the settings alone, and waits for no kernel
        from aiorts_zenoh.neighbours import Neighbours
        from aiorts_zenoh.transport import ZenohTransport

        host = settings.host or platform.node()
        _check_name("host", host)
        for endpoint in listed(settings.listen):
            check_free(endpoint)
        links = self.kernel.service(Links)
        links.reach.host = host  # also for kernels of this host: a kernel that both transports find is one
        self._open_to_others = [one for one in listed(settings.listen) if not is_loopback(one)]
        name = links.reached_as
        secured = _secured(settings, name)
        self._allow = settings.allow
        allowed = _allowed(settings, secured, f"[zenoh.allow] of {host}/{name}:")
        self._security = "certificates" if secured else "insecure: plain TCP" if settings.insecure else ""
        own, clock = engine_settings(settings, secured), self.kernel.clock
        self._transport = ZenohTransport(host, settings.domain, own, now=clock.time_ns, rename=settings.rename)
        self._transport.allowed = allowed
        if secured is not None and (role := secured.access.roles[secured.identity.name]) not in OPERATORS:
            self._transport.sessions_denied = (
                f"{secured.identity.name} has the role {role}, which operates no other kernel; "
                f"certify it as {COORDINATOR}"
            )
        self._neighbours = Neighbours(
            endpoints_of(settings.connect), secured, _LOG.warning, {port for _, port in endpoints_of(settings.listen)}
        )
        self._transport.beside.append(self._neighbours.declare)
        self._transport.trust = self._neighbours
        self._neighbours.denies.append(self._transport.deny)
        self._neighbours.start()
        opening = self._open(self._transport, self._neighbours, operate=settings.allow_control)
        self._opening = asyncio.get_running_loop().create_task(opening, name="aiorts zenoh")
        self._opening.add_done_callback(_report)

    async def _open(self, transport: ZenohTransport, neighbours: Neighbours, *, operate: bool) -> None:
        from aiorts.control import Control
        from aiorts.links import Links
        from aiorts_zenoh.serving import Serving

        control = self.kernel.attached(Control)
        if control is not None and control.hello:
            admits = neighbours.admits_client
            self._serving = Serving(control, operate=operate, report=_LOG.warning, admits=admits)
            neighbours.denies.append(self._serving.deny)
            transport.beside.append(self._serving.declare)
            transport.anew.append(self._serving.declare_as)
            transport.last.append(self._serving.finish)
        await self.kernel.service(Links).reach.carry(transport)

    async def opened(self) -> None:
        """Wait until other hosts can be reached. LinkError: they cannot."""
        if self._opening is not None:
            await asyncio.shield(self._opening)

    def report(self) -> Mapping[str, Any]:
        """The host, the domain, the standing of this kernel with its name, the kernels that are seen there, messages
        that found no room here, peers that are cut off, and the rights of others to ports."""
        transport = self._transport
        if transport is None:
            return {}
        seen = [f"{peer.host}/{peer.kernel}" for peer in transport.peers]
        where = {"host": transport.host, "domain": transport.domain, "name": transport.standing}
        where |= {"known_as": transport.known_as} if transport.known_as else {}
        where |= {"security": self._security} if self._security else {}
        report = {**where, "kernels": seen, "left_out": transport.left_out, "cut_off": sorted(transport.cut_off)}
        return {**report, "allow": self._allow} if self._allow is not None else report

    @property
    def notice(self) -> str:
        return self._security if self._security.startswith("insecure") else ""

    @property
    def risk(self) -> str:
        if self._security != "certificates" or not self._open_to_others:
            return ""
        return (
            f"listens at {', '.join(self._open_to_others)}, where each connection that fails keeps newcomers out for "
            "0.1 s; aiorts help secure-network has a firewall that counts them by address"
        )

    def stopped(self) -> None:
        if self._neighbours is not None:
            self._neighbours.close()
        if self._opening is not None:
            self._opening.cancel()

    def closed(self) -> None:
        if self._serving is not None:
            self._serving.close()


def _secured(settings: NetworkSettings, kernel: str) -> Secured | None:
    """The certificate of the kernel, and the access table; None: there are no certificates.

    ConfigurationError: there is none for the kernel's name, or it is not to be used.
    """
    if settings.certificates is None:
        return None
    return secured_by(settings.certificates, kernel, KERNELS, settings.access)


def _allowed(settings: NetworkSettings, secured: Secured | None, where: str) -> Allowed:
    """Rights of other kernels to ports here. ConfigurationError: a name in `allow` is no kernel's."""
    allowed = Allowed.of_table(settings.allow or {}, where)
    if secured is not None and (other := sorted(name for name in allowed.names if not secured.access.is_kernel(name))):
        raise ConfigurationError(f"allow: {other[0]!r} is the name of no kernel; expected a {' or '.join(KERNELS)}")
    return allowed


def engine_settings(settings: NetworkSettings, secured: Secured | None = None) -> Mapping[str, Any]:
    """The settings of the engine: nothing but what was asked for listens, connects or looks around."""
    # A client hears all kernels behind its only neighbour, such as a router; a peer hears its neighbours alone.
    is_client = len(listed(settings.connect)) == 1 and not settings.listen
    protocol = "tls" if secured else "tcp"
    security = tls_settings(secured, base_of(settings.domain)) if secured else {"transport/link/protocols": ["tcp"]}
    return {
        **_HARDENED,
        **security,
        "mode": "client" if is_client else "peer",
        "listen/endpoints": [f"{protocol}/{endpoint}" for endpoint in listed(settings.listen)],
        "connect/endpoints": [f"{protocol}/{endpoint}" for endpoint in listed(settings.connect)],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 2},
        **{f"transport/link/tx/queue/size/{one}": 16 for one in ("interactive_high", "data", "data_low")},
    }


def _check_name(key: str, name: str) -> None:
    """ConfigurationError: the name cannot be a part of a key of the engine."""
    if not _NAME.fullmatch(name):
        raise ConfigurationError(f"{key}: expected letters, digits, '_', '-' and '.', got {name!r:.80}")


def endpoints_of(text: str) -> list[tuple[str, int]]:
    """Host and port of each listed endpoint."""
    parts = [endpoint.rpartition(":") for endpoint in listed(text)]
    return [(host.strip("[]"), int(port)) for host, _, port in parts]


def check_free(endpoint: str) -> None:
    """Check, before anything runs, that an endpoint is free. ConfigurationError: nothing can listen there."""
    host, _, port = endpoint.rpartition(":")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a former listener may have just ended
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "is no name of a host"
        raise ConfigurationError(f"listen: {endpoint}: {why}; choose another port or address") from None


def is_loopback(endpoint: str) -> bool:
    """Whether this machine alone reaches an endpoint that listens."""
    ((host, _),) = endpoints_of(endpoint)
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _report(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _LOG.error("zenoh: other hosts cannot be reached: %s", error)
