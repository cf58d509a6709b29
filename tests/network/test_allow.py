"""`[zenoh.allow]`: what the kernels of which names may read, write and call, whichever end makes the connector."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Protocol

import pytest

from aiorts import Component, Composite, Goal, InPort, Kernel, OutPort, Provided, Required
from aiorts.errors import ConfigurationError, WiringError
from aiorts.links import Links
from aiorts.types import TimedLong

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts_zenoh import Network, NetworkSettings
from network.certificate_parts import folder
from network.network_parts import by_network_alone, free_port

WAIT = 20.0
RULES = {
    "write": {"station": ["!robot.trim", "robot.*", "later.inp"], "*": ["robot.inp"]},
    "read": {"station": ["robot.out"]},
    "call": {"station": ["robot.open"]},
}
WHERE = "[zenoh.allow] of far/robot:"


class Drive(Protocol):
    async def add(self, number: int) -> int: ...

    async def go(self, number: int) -> Goal[int, int]: ...


class Robot(Component):
    out = OutPort(TimedLong)
    secret = OutPort(TimedLong)
    inp = InPort(TimedLong)
    trim = InPort(TimedLong)
    open = Provided[Drive]()
    closed = Provided[Drive]()

    async def add(self, number: int) -> int:
        return number + 1

    async def go(self, number: int) -> Goal[int, int]:
        goal: Goal[int, int] = Goal()
        goal.succeed(number)
        return goal


class Station(Component):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong)
    asks = Required[Drive](timeout=WAIT)


class Pair:
    """A robot with rules, and a station that is certified as a component."""

    def __init__(self, robot: Kernel, station: Kernel) -> None:
        self.robot, self.station = robot, station
        self.ends: dict[Kernel, Any] = {}


def refused_in(caplog: pytest.LogCaptureFixture, rule: str) -> int:
    """How many lines of the log say so, of both kernels."""
    return sum(f"{WHERE} {rule}" in one.getMessage() for one in caplog.records)


@asynccontextmanager
async def pair(path: Path, rules: Any = RULES) -> AsyncIterator[Pair]:
    folder(path, robot="component", station="component", other="component")
    address = f"127.0.0.1:{free_port()}"
    far = {"zenoh": {"listen": address, "host": "far", "certificates": path, "allow": rules}}
    near = {"zenoh": {"connect": address, "host": "near", "certificates": path}}
    async with Kernel("robot", services=far) as robot, Kernel("station", services=near) as station:
        made = Pair(robot, station)
        by_network_alone(robot)
        by_network_alone(station)
        made.ends = {robot: await robot.add(Robot("robot")), station: await station.add(Station("station"))}
        async with asyncio.timeout(WAIT):
            while not (robot.service(Links).peers and station.service(Links).peers):
                await asyncio.sleep(0.01)
        yield made


def run(main: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(3 * WAIT):
            await main()

    asyncio.run(bounded())


# -- as settings -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"allow": RULES}, "allow: names are known by certificates alone; give their folder (--certs)"),
        ({"allow": {"reads": {}}, "certificates": Path()}, "allow: expected read, write, call, got 'reads'"),
        ({"allow": {"read": {"a": ["x"]}}, "certificates": Path()}, "allow: read.a: expected COMPONENT.PORT, with *"),
    ],
)
def test_settings_that_say_no_rights_are_refused(given: Any, said: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        NetworkSettings(**given)
    assert str(refused.value).startswith(said)


@pytest.mark.parametrize("name", ["statoin", "anna", "gone"])
def test_a_name_that_no_kernel_can_have_is_mistaken_and_the_kernel_is_not_started(tmp_path: Path, name: str) -> None:
    folder(tmp_path, robot="component", anna="viewer", gone="component").revoke("gone")
    rules = {"read": {name: [], "*": ["*.*"]}}  # a mistaken name that is to be kept out would be let in
    zenoh = {"listen": f"127.0.0.1:{free_port()}", "certificates": tmp_path, "allow": rules}

    async def main() -> None:
        with pytest.raises(ConfigurationError, match=f"allow: '{name}' is the name of no kernel"):
            await Kernel("robot", services={"zenoh": zenoh}).open()

    run(main)


# -- at both ends ------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E18")
@pytest.mark.parametrize(
    ("by", "ports", "rule", "ends"),
    [
        ("station", ("own.out", "robot.trim"), "write 'station': '!robot.trim' denies it", 2),
        ("station", ("own.out", "nobody.inp"), "write 'station': no pattern matches it", 2),
        ("station", ("robot.secret", "own.inp"), "read 'station': no pattern matches it", 2),
        ("station", ("own.asks", "robot.closed"), "call 'station': no pattern matches it", 2),
        ("robot", ("station.out", "own.trim"), "write 'station': '!robot.trim' denies it", 2),
        ("robot", ("own.secret", "station.inp"), "read 'station': no pattern matches it", 1),
    ],
)
def test_what_no_rule_allows_is_refused_to_whoever_connects_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, by: str, ports: tuple[str, str], rule: str, ends: int
) -> None:
    """`ends`: how many ends the connector has had, each with one line in the log."""

    async def main() -> None:
        async with pair(tmp_path) as made:
            kernel = made.robot if by == "robot" else made.station
            other = "far/robot" if by == "station" else "near/station"

            def end(path: str) -> Any:
                component, _, port = path.partition(".")
                return getattr(made.ends[kernel], port) if component == "own" else f"{other}/{path}"

            with pytest.raises(WiringError) as refused:
                await kernel.connect(*map(end, ports))
            assert f"'station' may not {rule.partition(' ')[0]} it: {WHERE} {rule}" in str(refused.value)
            async with asyncio.timeout(WAIT):
                while refused_in(caplog, rule) < ends or made.robot.connectors or made.station.connectors:
                    await asyncio.sleep(0.01)
            await asyncio.sleep(0.5)  # it is tried no more
            assert (made.robot.connectors, made.station.connectors) == ({}, {})
            assert made.robot.service(Links).report() == made.station.service(Links).report() == {}
        assert refused_in(caplog, rule) == ends

    with caplog.at_level(logging.INFO):
        run(main)


@pytest.mark.slow(kept_by="test_what_no_rule_allows_is_refused_to_whoever_connects_it")
@pytest.mark.parametrize("options", [{}, {"dataflow": "pull"}])
@pytest.mark.parametrize("by", ["station", "robot"])
def test_what_a_rule_allows_carries_as_ever(tmp_path: Path, by: str, options: Any) -> None:
    async def main() -> None:
        async with pair(tmp_path) as made:
            robot, station = made.ends[made.robot], made.ends[made.station]
            if by == "station":
                await made.station.connect(station.out, "far/robot/robot.inp", **options)
                await made.station.connect("far/robot/robot.out", station.inp, **options)
            else:
                await made.robot.connect("near/station/station.out", robot.inp, **options)
                await made.robot.connect(robot.out, "near/station/station.inp", **options)
            for writer, reader in ((station.out, robot.inp), (robot.out, station.inp)):
                writer.write_nowait(TimedLong(0, 7))
                assert (await reader.read(timeout=WAIT)).data == 7

    run(main)


@pytest.mark.slow(kept_by="test_what_no_rule_allows_is_refused_to_whoever_connects_it")
def test_calls_and_goals_of_a_service_that_a_rule_allows(tmp_path: Path) -> None:
    async def main() -> None:
        async with pair(tmp_path) as made:
            asks = made.ends[made.station].asks
            await made.station.connect(asks, "far/robot/robot.open")
            assert await asks.proxy.add(1) == 2
            assert await (await asks.proxy.go(7)).result() == 7

    run(main)


@pytest.mark.slow(kept_by="test_what_no_rule_allows_is_refused_to_whoever_connects_it")
def test_the_rules_hold_for_what_comes_later_too(tmp_path: Path) -> None:
    async def main() -> None:
        async with pair(tmp_path) as made:
            station = made.ends[made.station]
            await made.station.connect(station.out, "far/robot/later.inp")  # waits
            with pytest.raises(WiringError, match=r"later.trim: 'station' may not write it"):
                await made.station.connect(station.out, "far/robot/later.trim")
            later = await made.robot.add(Robot("later"))
            while list(made.station.service(Links).report().values()) != ["up"]:
                await asyncio.sleep(0.01)
            station.out.write_nowait(TimedLong(0, 7))
            assert (await later.inp.read(timeout=WAIT)).data == 7

    run(main)


@pytest.mark.slow(kept_by="test_what_no_rule_allows_is_refused_to_whoever_connects_it")
def test_a_port_of_a_composite_is_that_of_its_member(tmp_path: Path) -> None:
    async def main() -> None:
        async with pair(tmp_path, {"write": {"*": ["arm.*"]}}) as made:
            robot = made.ends[made.robot]
            await made.robot.add(Composite("arm", robot, exported={"robot.trim": "trim"}))
            with pytest.raises(WiringError, match=r"robot.trim: 'station' may not write it"):
                await made.station.connect(made.ends[made.station].out, "far/robot/arm.trim")

    run(main)


@pytest.mark.slow(kept_by="test_settings_that_say_no_rights_are_refused")
def test_what_is_in_force_is_reported(tmp_path: Path) -> None:
    async def main() -> None:
        async with pair(tmp_path) as made:
            assert made.robot.service(Network).report()["allow"] == RULES
            assert "allow" not in made.station.service(Network).report()

    run(main)
