"""The service `zenoh`: nothing listens unless it is asked for, and kernels of two hosts are linked."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import ConfigurationError, MissingExtra, PluginError
from aiorts.links import Links
from aiorts.types import TimedLong, TimedOctetSeq

pytest.importorskip("zenoh")

from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.engine import HIGHEST, LOWEST, Engine, Inbox
from network.network_parts import free_port

EXAMPLE = Path(__file__).parents[2] / "examples" / "roomba"


class Source(Component):
    out = OutPort(TimedOctetSeq)


class Number(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedOctetSeq, length=10)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"listen": "127.0.0.1:7447"}, "certificates: other hosts are reached with certificates alone"),
        ({"insecure": True, "certificates": Path("certs")}, "insecure: there are certificates as well"),
        ({"access": {"boss": ["a"]}}, "access: expected viewer, operator, component, coordinator, router, got"),
        ({"access": {"viewer": "a"}}, "access: viewer: expected a list of names"),
        ({"access": {"viewer": ["a"], "operator": ["a"]}}, "access: .a. is viewer and operator"),
        ({"connect": "robot", "insecure": True}, "connect: expected host:port, got 'robot'"),
        ({"listen": ":70000", "insecure": True}, "listen: expected host:port, got ':70000'"),
        ({"listen": "a:1, :2", "insecure": True}, "listen: expected host:port, got ':2'"),
        ({"host": "a/b"}, "host: expected letters"),
        ({"domain": "a*"}, "domain: expected letters"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said.replace("(", r"\(")):
        NetworkSettings(**given)


def _listening() -> set[str]:
    """Sockets of this process at which something listens, or that take datagrams from anywhere."""
    own = {os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd") if _is_there(name)}
    found = set()
    for table, states in (("tcp", {"0A"}), ("tcp6", {"0A"}), ("udp", {"07"}), ("udp6", {"07"})):
        for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] in states and f"socket:[{fields[9]}]" in own:
                found.add(f"{table} {fields[1]}")
    return found


def _is_there(name: str) -> bool:
    return os.path.islink(f"/proc/self/fd/{name}")


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_switched_on_alone_it_listens_nowhere() -> None:
    async def main() -> set[str]:
        async with Kernel("alone", services={"zenoh": {}}) as kernel:
            await kernel.service(Network).opened()
            return _listening()

    assert asyncio.run(main()) == set()


async def _all(sink: Any, count: int) -> list[int]:
    return [(await sink.inp.read(timeout=20.0)).tm for _ in range(count)]


def test_two_kernels_of_two_hosts_lose_nothing() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "far", "insecure": True}}
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await writer.connect(source.out, "far/reader/sink.inp", full="block", timeout=None)
            reading = asyncio.ensure_future(_all(sink, 200))
            for number in range(200):
                await source.out.write(TimedOctetSeq(number, bytes(300_000 if number % 50 == 0 else 10)))
            assert await reading == list(range(200))
            ledger = await writer.service(Links).ledger(connector)
            assert (ledger.written, ledger.delivered, ledger.unexplained) == (200, 200, 0)

    asyncio.run(main())


@pytest.mark.slow(kept_by="network/test_zenoh_transport.py::test_it_keeps_every_promise")
def test_what_a_link_carries_decides_about_its_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, str]] = []
    publisher = Engine.publisher

    def noted(self: Engine, key: str, priority: str, *, declared: bool) -> Any:
        found = publisher(self, key, priority, declared=declared)
        made.append((key[-1], str(found.priority).rpartition(".")[2]))
        return found

    monkeypatch.setattr(Engine, "publisher", noted)

    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "far", "insecure": True}}
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("reader", services=far) as reader, Kernel("writer", services=near) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            for push in ("all", "new"):
                connector = await writer.connect(source.out, "far/reader/sink.inp", push=push)
                source.out.write_nowait(TimedOctetSeq(0, b""))
                async with asyncio.timeout(20.0):
                    while not connector.statistics.acknowledged:
                        await asyncio.sleep(0.01)
                await writer.disconnect(connector)
            assert sink.inp.is_new

    asyncio.run(main())
    urgent = "INTERACTIVE_HIGH"
    assert [name for end, name in made if end == "w"] == ["DATA", urgent, "DATA_LOW", urgent]
    assert {name for end, name in made if end == "r"} == {urgent}


def test_all_that_may_be_asked_is_declared_before_the_token(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    answer, announce = Engine.answer, Engine.announce

    def answered(self: Engine, key: str, *arguments: Any) -> Any:
        found = answer(self, key, *arguments)
        done.append(key.split("/")[3])
        return found

    def announced(self: Engine, *tokens: str) -> None:
        done.extend("token" for _ in tokens)
        announce(self, *tokens)

    monkeypatch.setattr(Engine, "answer", answered)
    monkeypatch.setattr(Engine, "announce", announced)

    async def main() -> None:
        services = {"zenoh": {"host": "one", "allow_control": True}, "control": {"name": "robot"}}
        async with Kernel("robot", services=services) as kernel:
            await kernel.service(Network).opened()

    asyncio.run(main())
    assert done[:4] == ["svc", "info", "ctl", "token"]


async def _wait_for(links: Links, count: int) -> None:
    async with asyncio.timeout(20.0):
        while len(links.peers) < count:
            await asyncio.sleep(0.01)


@pytest.mark.row(82)
def test_kernels_of_one_name_on_two_hosts_are_told_apart() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "hub", "insecure": True}}
        near = [{"zenoh": {"connect": address, "host": host, "insecure": True}} for host in ("pc1", "pc2")]
        async with (
            Kernel("station", services=far) as station,
            Kernel("robot", services=near[0]) as one,
            Kernel("robot", services=near[1]) as two,
        ):
            sink = await station.add(Sink("sink"))
            await _wait_for(station.service(Links), 2)
            made, came = [], []
            for number, robot in enumerate((one, two)):
                await _wait_for(robot.service(Links), 2)
                source = await robot.add(Source("source"))
                made.append(
                    (robot, await robot.connect(source.out, "hub/station/sink.inp", full="block", timeout=None))
                )
                for count in range(50):
                    await source.out.write(TimedOctetSeq(1_000 * number + count, b""))
                    came.append((await sink.inp.read(timeout=20.0)).tm)
            assert sorted(came) == [*range(50), *range(1_000, 1_050)]
            for robot, connector in made:
                ledger = await robot.service(Links).ledger(connector)
                assert (ledger.written, ledger.delivered, ledger.unexplained) == (50, 50, 0)
            peer_sink = await two.add(Sink("sink"))  # and one of them writes to the other
            connector = await one.connect(one.components["source"].ports["out"], "pc2/robot/sink.inp")
            await one.components["source"].ports["out"].write(TimedOctetSeq(7, b""))
            assert (await peer_sink.inp.read(timeout=20.0)).tm == 7
            assert (await one.service(Links).ledger(connector)).unexplained == 0

    asyncio.run(main())


@pytest.mark.slow(kept_by="network/test_specification.py::test_keys_and_claims_are_read")
@pytest.mark.row(82)
def test_kernels_of_different_domains_do_not_see_each_other() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        listens = {"zenoh": {"listen": address, "host": "hub", "domain": "one", "insecure": True}}
        one, two = (
            {"zenoh": {"connect": address, "host": "pc", "domain": domain, "insecure": True}}
            for domain in ("one", "two")
        )
        async with (
            Kernel("station", services=listens) as station,
            Kernel("robot", services=two) as apart,  # of one name with the other, and first
            Kernel("robot", services=one) as robot,
        ):
            async with asyncio.timeout(20.0):
                while [one.service(Network).report()["name"] for one in (station, apart, robot)] != ["owns"] * 3:
                    await asyncio.sleep(0.01)
            await _wait_for(station.service(Links), 1)
            await _wait_for(robot.service(Links), 1)
            seen = [[peer.kernel for peer in one.service(Links).peers] for one in (station, apart, robot)]
            assert seen == [["robot"], [], ["station"]]

    asyncio.run(main())


@pytest.mark.slow(kept_by="test_two_kernels_of_two_hosts_lose_nothing")
@pytest.mark.row(83)
@pytest.mark.fault("E01")
def test_a_reader_that_is_killed_is_missed_at_once_and_linked_again(tmp_path: Path) -> None:
    address, program = f"127.0.0.1:{free_port()}", Path(__file__).with_name("reading_program.py")
    seen = tmp_path / "seen.txt"

    def start() -> subprocess.Popen[bytes]:
        with seen.open("ab") as output:
            return subprocess.Popen([sys.executable, str(program), address], stdout=output)

    async def main() -> Any:
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("writer", services=near) as kernel:
            source = await kernel.add(Number("source"))
            connector = await kernel.connect(source.out, "far/reader/sink.inp", length=20_000)
            links, number = kernel.service(Links), 0
            for _ in range(2):
                reader = start()
                try:
                    async with asyncio.timeout(20.0):
                        before = connector.statistics.acknowledged or 0
                        while (connector.statistics.acknowledged or 0) < before + 100:
                            source.out.write_nowait(TimedLong(number, number))
                            number += 1
                            await asyncio.sleep(0.005)
                finally:
                    reader.kill()
                    reader.wait(10)
                killed = time.monotonic()
                while links.peers:
                    assert time.monotonic() - killed < 5.0, "a killed kernel is still there"
                    await asyncio.sleep(0.01)
            return number, connector.statistics

    number, ledger = asyncio.run(main())
    came = [int(line) for line in seen.read_text().split()]
    assert (ledger.written, ledger.balanced, set(ledger.dropped) <= {"unknown_fate"}) == (number, True, True)
    assert came == sorted(set(came)), "doubled, or in another order"
    unsure = ledger.dropped.get("unknown_fate", 0) + ledger.in_flight  # sent to a reader that was killed
    assert len(came) <= ledger.acknowledged + unsure  # fewer, where some lay unread in the reader that was killed
    assert len(came) > 100


@pytest.mark.slow(kept_by="test_two_kernels_of_two_hosts_lose_nothing")
def test_a_real_drive_is_computed_on_two_hosts(hosts: tuple[list[str], list[str]], tmp_path: Path) -> None:
    here, there = hosts
    run = [sys.executable, "-m", "aiorts", "run"]
    near = ["--host", "one", "--connect", "10.77.0.2:7447", "--insecure-network"]
    far = ["--host", "two", "--listen", "10.77.0.2:7447", "--insecure-network"]
    said = tmp_path / "said.txt"
    with said.open("w") as output:
        started = [
            subprocess.Popen([*there, *run, str(EXAMPLE / "odometry.toml"), *far], stdout=output, stderr=output),
            subprocess.Popen([*here, *run, str(EXAMPLE / "monitor.toml"), *near], stdout=output, stderr=output),
        ]
        try:
            robot = [*here, *run, str(EXAMPLE / "robot.toml"), "--set", "imu.speed=20", *near]
            played = subprocess.run(robot, capture_output=True, text=True, check=False, timeout=100)
            assert played.returncode == 0, played.stderr[-2000:]
            until = time.monotonic() + 20.0
            while "TimedPose2D 18." not in said.read_text() and time.monotonic() < until:
                time.sleep(0.1)
            time.sleep(1.0)  # the last of what is computed is on its way
            started[0].terminate()
            started[0].wait(20)
        finally:
            for one in started:
                one.terminate()
            for one in started:
                one.wait(20)
    assert "heading verified: 1216 of 1216 within 1e-6 rad" in said.read_text(), said.read_text()[-2000:]


def test_what_is_handed_over_behind_a_fault_is_handled_all_the_same() -> None:
    async def main() -> tuple[list[int], list[str]]:
        loop, came, faults = asyncio.get_running_loop(), [], []  # type: tuple[Any, list[int], list[str]]
        loop.set_exception_handler(lambda _loop, context: faults.append(str(context["exception"])))
        inbox = Inbox(loop)
        for number in range(600):
            inbox.put(lambda one: came.append(one) if one % 300 else [][one], number)
        async with asyncio.timeout(5.0):
            while len(came) < 598:
                await asyncio.sleep(0)
        return came, faults

    came, faults = asyncio.run(main())
    assert came == [number for number in range(600) if number % 300]
    assert faults == ["list index out of range"] * 2


@pytest.mark.fault("E24")
def test_what_is_beyond_the_bounds_is_left_out_and_counted() -> None:
    async def main() -> tuple[int, int, int]:
        came: list[int] = []
        inbox = Inbox(asyncio.get_running_loop())
        for number in range(100):
            inbox.put(came.append, number, size=1 << 20)
        left_out = inbox.dropped
        async with asyncio.timeout(5.0):
            while len(came) + left_out < 100:
                await asyncio.sleep(0)
        inbox.put(came.append, 100, size=1 << 20)
        async with asyncio.timeout(5.0):
            while came[-1] != 100:
                await asyncio.sleep(0)
        return len(came), left_out, came[-1]

    assert asyncio.run(main()) == (65, 36, 100)


def test_a_run_without_the_engine_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)

    async def main() -> None:
        async with Kernel("alone", services={"zenoh": {}}):
            pass

    with pytest.raises(MissingExtra, match=r'pip install "aiorts\[zenoh\]"'):
        asyncio.run(main())


@pytest.mark.parametrize("version", ["1.8.0", "1.11.0", "2.0.0", "0.11.0"])
def test_an_engine_of_another_version_is_refused_at_the_start(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.version", lambda name: version)

    async def main() -> None:
        async with Kernel("alone", services={"zenoh": {}}):
            pass

    with pytest.raises(PluginError, match=f"eclipse-zenoh {version}: aiorts takes versions from 1.9 to before 1.11"):
        asyncio.run(main())


def test_the_versions_that_are_taken_are_those_that_the_extra_installs_and_the_specification_names() -> None:
    root = Path(__file__).parents[2]
    low, high = (".".join(map(str, one)) for one in (LOWEST, HIGHEST))
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"eclipse-zenoh>={low},<{high}" in project["optional-dependencies"]["zenoh"]
    specification = (root / "plugins" / "aiorts_zenoh" / "SPEC.md").read_text(encoding="utf-8")
    assert f"\nZenoh {low} or later, before {high}. " in specification


@pytest.mark.fault("E26")
def test_an_address_that_is_not_of_this_machine_is_said_before_anything_runs() -> None:
    async def main() -> None:
        async with Kernel("one", services={"zenoh": {"listen": "10.255.255.1:1", "insecure": True}}):
            pass

    with pytest.raises(ConfigurationError, match=r"listen: 10\.255\.255\.1:1: Cannot assign"):
        asyncio.run(main())


@pytest.mark.slow(kept_by="test_an_address_that_is_not_of_this_machine_is_said_before_anything_runs")
@pytest.mark.fault("E26")
def test_a_port_that_is_taken_ends_the_run_with_2_before_anything_runs(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        words = ["run", str(EXAMPLE / "odometry.toml"), "--listen", address, "--insecure-network"]
        done = subprocess.run(
            [sys.executable, "-m", "aiorts", *words], capture_output=True, text=True, check=False, timeout=30
        )
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert f"listen: {address}: Address already in use" in done.stderr
    assert "Traceback" not in done.stderr
