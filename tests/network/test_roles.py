"""What each role may declare, read, write, call and create at a kernel: a matrix, with real engines and certificates.

Who tries goes by no table of its own: its engine sends everything, and its kernel takes itself for a component. So what
is refused is refused by the kernel that is asked. It is tried in two ways: as another kernel, over links, and as a
client, in a session.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import shutil
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Provided, Required
from aiorts.errors import AiortsError
from aiorts.links import Links
from aiorts.sessions import Client, Entry
from aiorts.types import TimedLong

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from aiorts_zenoh.security.access import Access
from aiorts_zenoh.security.folder import Folder
from aiorts_zenoh.security.tls import Secured
from network.certificate_parts import folder
from network.engine_parts import unchecked
from network.network_parts import by_network_alone, free_port

ROLES: Final = ("component", "coordinator", "operator", "viewer", "router", "revoked")
KERNELS: Final = {"component", "coordinator"}
OPERATORS: Final = {"operator", "coordinator"}
LOOKERS: Final = OPERATORS | {"viewer"}
MAY: Final[Mapping[tuple[str, str], set[str]]] = {
    ("link", "declare"): KERNELS,
    ("link", "read"): KERNELS,
    ("link", "write"): KERNELS,
    ("link", "call"): KERNELS,
    ("link", "create"): set(),
    ("session", "declare"): LOOKERS,
    ("session", "read"): LOOKERS,
    ("session", "write"): OPERATORS,
    ("session", "call"): OPERATORS,
    ("session", "create"): OPERATORS,
}
"""The roles that may, by the way and what is done. A link creates nothing: there is no question for it."""
NOTHING: Final[Mapping[str, Any]] = {"read": {"*": []}, "write": {"*": []}, "call": {"*": []}}
TRIED: Final = 1.5
"""Seconds that what is refused without a word is waited for."""


class Echo(Protocol):
    async def echo(self, number: int) -> int: ...


class Robot(Component):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong, length=10_000)
    service = Provided[Echo]()

    async def echo(self, number: int) -> int:
        return number


class Tries(Component):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong, length=10_000)
    asks = Required[Echo](timeout=TRIED)


class Target(NamedTuple):
    """The kernel at which it is tried."""

    kernel: Kernel
    robot: Robot
    address: str
    certificates: Folder


@asynccontextmanager
async def target(path: Path, **more: Any) -> AsyncIterator[Target]:
    made = folder(
        path, robot="component", arm="component", **{f"a-{role}": role for role in ROLES if role != "revoked"}
    )
    made.issue("a-revoked", "coordinator")
    made.revoke("a-revoked")
    address = f"127.0.0.1:{free_port()}"
    zenoh = {"listen": address, "host": "far", "certificates": path, "allow_control": True, **more}
    async with Kernel("robot", services={"zenoh": zenoh, "control": {"name": "robot"}}) as kernel:
        await kernel.service(Network).opened()
        by_network_alone(kernel)
        robot = await kernel.add(Robot("robot"))
        async with asyncio.timeout(10.0):
            while kernel.service(Network).report()["name"] != "owns":  # clients see those alone
                await asyncio.sleep(0.02)

        async def writes() -> None:
            for number in itertools.count():
                robot.out.write_nowait(TimedLong(number, number))
                await asyncio.sleep(0.02)

        writing = asyncio.ensure_future(writes())
        try:
            yield Target(kernel, robot, address, made)
        finally:
            writing.cancel()


async def works(tried: Awaitable[Any]) -> bool:
    """Whether it is done, and neither refused nor without an answer."""
    try:
        async with asyncio.timeout(TRIED + 0.5):
            return (await tried) is not False
    except (AiortsError, TimeoutError):
        return False


# -- as a kernel -------------------------------------------------------------------------------------------------------


async def as_kernel(at: Target, role: str, path: Path) -> dict[str, bool]:
    """What a kernel with the certificate of a role can do, which takes itself and the other one for components."""
    name = f"a-{role}"
    shutil.copytree(at.certificates.path, path)
    index = json.loads(at.certificates.index.read_bytes())
    Folder(path).index.write_text(json.dumps({**index, "revoked": []}))
    access = {"component": ["robot", name]}
    zenoh = {"connect": at.address, "host": "near", "certificates": path, "access": access}
    async with Kernel(name, services={"zenoh": zenoh}) as kernel:
        by_network_alone(kernel)
        tries = await kernel.add(Tries("tries"))
        links, own = kernel.service(Links), at.kernel.service(Links)
        until = time.monotonic() + TRIED
        while not (seen := name in {peer.kernel for peer in own.peers}) or not links.peers:
            if time.monotonic() > until:
                break
            await asyncio.sleep(0.02)

        async def read() -> None:
            await kernel.connect("far/robot/robot.out", tries.inp)
            await tries.inp.read()

        async def write() -> None:
            at.robot.inp.drain()
            await kernel.connect(tries.out, "far/robot/robot.inp", full="block", timeout=None)
            await tries.out.write(TimedLong(0, 7))
            await at.robot.inp.read()

        async def call() -> None:
            await kernel.connect(tries.asks, "far/robot/robot.service")
            assert await tries.asks.proxy.echo(7) == 7

        done = await asyncio.gather(*(works(one()) for one in (read, write, call)))
        return dict(zip(("declare", "read", "write", "call", "create"), (seen, *done, False), strict=True))


# -- as a client -------------------------------------------------------------------------------------------------------


async def as_client(at: Target, role: str, path: Path) -> dict[str, bool]:
    """What a client with the certificate of a role can do, whose engine goes by no table."""
    name = f"a-{role}"
    identity = unchecked(at.certificates, name)
    settings = dict(
        engine_settings(
            NetworkSettings(connect=at.address, certificates=at.certificates.path),
            Secured(identity, Access.of_names({name: "operator", "robot": "component"})),
        )
    )
    del settings["access_control"]
    path.mkdir(exist_ok=True)
    async with AsyncExitStack() as stack:
        gateway = Gateway(path, ClientKeys("default", name), {**settings, "connect/timeout_ms": 3_000})
        stack.push_async_callback(gateway.close)
        with suppress(AiortsError):
            await gateway.open()
        (epoch,) = {peer.epoch for peer in gateway.peers} or {at.kernel.epoch}
        socket = next(path.glob("*.sock"), path / "none.sock")
        entry = Entry("far/robot", 1, f"{epoch:016x}", str(socket), carried=True)

        def inject(client: Client) -> bool:
            at.kernel.loop.call_soon_threadsafe(at.robot.inp.drain)
            return bool(client.call("inject", port="robot.inp", lines=['{"data": 7}'])["written"])

        tries: dict[str, Callable[[Client], object]] = {
            "declare": lambda client: client.call("names")["components"],
            "read": lambda client: next(iter(client.stream("tap", port="robot.out"))),
            "write": inject,
            "call": lambda client: client.call("call", path="robot.service.echo", args=[7])["value"] == 7,
            "create": lambda client: client.call(
                "create", type="FlexiDump", name=f"of-{role}", params={"inputs": "TimedLong"}
            ),
        }

        def attempt() -> dict[str, bool]:
            done = dict.fromkeys(tries, False)
            with suppress(AiortsError), Client.open(entry, timeout=TRIED) as client:
                for what, one in tries.items():
                    with suppress(AiortsError):
                        done[what] = bool(one(client))
            return done

        return await asyncio.to_thread(attempt)


WAYS: Final = {"link": as_kernel, "session": as_client}


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], dict[str, bool]]:
    """What a role can do in one way; each is tried once, those that are to be refused at the same time: they wait."""

    @cache
    def together(way: str, *roles: str) -> dict[str, dict[str, bool]]:
        path = tmp_path_factory.mktemp("roles")

        async def main() -> list[dict[str, bool]]:
            async with target(path / "certificates") as at:
                return await asyncio.gather(*(WAYS[way](at, role, path / role) for role in roles))

        return dict(zip(roles, asyncio.run(main()), strict=True))

    def found(way: str, role: str) -> dict[str, bool]:
        let_in = MAY[way, "declare"]
        return together(way, *((role,) if role in let_in else (one for one in ROLES if one not in let_in)))[role]

    return found


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(97)
@pytest.mark.fault("E20")
@pytest.mark.parametrize("what", ["declare", "read", "write", "call", "create"])
@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("way", WAYS)
def test_a_role_may_what_the_table_says_and_nothing_else(
    tried: Callable[[str, str], dict[str, bool]], way: str, role: str, what: str
) -> None:
    assert tried(way, role)[what] is (role in MAY[way, what])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "role", "may"),
    [
        ("link", "component", {"declare"}),
        ("link", "coordinator", {"declare"}),
        ("session", "operator", {"declare", "read", "write", "call", "create"}),
        ("session", "viewer", {"declare", "read"}),
    ],
)
def test_where_the_rights_allow_nothing_no_kernel_has_a_link_and_clients_are_as_before(
    tmp_path: Path, way: str, role: str, may: set[str]
) -> None:
    async def main() -> dict[str, bool]:
        async with target(tmp_path / "certificates", allow=NOTHING) as at:
            return await WAYS[way](at, role, tmp_path / "own")

    assert {what for what, done in asyncio.run(main()).items() if done} == may
