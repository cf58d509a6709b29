"""Two kernels of one name on real sessions, and in real processes: one has it, and all see the same one."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.links import Links, Peer

pytest.importorskip("zenoh")

import zenoh

from aiorts_zenoh import Network, NetworkSettings, ZenohTransport
from aiorts_zenoh.keys import Keys
from aiorts_zenoh.network import engine_settings
from network.network_parts import free_port

PROGRAM = Path(__file__).with_name("claiming_program.py")
RACES = 100 if os.environ.get("AIORTS_CAMPAIGN") else 6


class Face:
    """What a transport sees of a kernel, and what it has said."""

    def __init__(self, name: str, epoch: int) -> None:
        self.name, self.epoch = name, epoch
        self.said: list[str] = []

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        return asyncio.get_running_loop().create_task(coroutine, name=name)

    def report(self, text: str) -> None:
        self.said.append(text)


class At:
    """A kernel of the host `same`."""

    def __init__(self, name: str, epoch: int, machine: int = 1, **reached: str) -> None:
        self.face = Face(name, epoch)
        settings = engine_settings(NetworkSettings(insecure=True, **reached))
        self.transport = ZenohTransport("same", engine=settings, machine=machine)

    async def __aenter__(self) -> At:
        await self.transport.open(self.face)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.transport.close()

    @property
    def standing(self) -> str:
        return self.transport.standing

    @property
    def sees(self) -> list[tuple[str, int]]:
        return sorted((peer.kernel, peer.epoch) for peer in self.transport.peers)


async def _until(met: Callable[[], bool], within: float = 10.0) -> None:
    async with asyncio.timeout(within):
        while not met():
            await asyncio.sleep(0.01)


async def _one_race(number: int) -> None:
    """Two that start at once: by turns they are linked with each other, or with the one that looks on alone."""
    address = f"127.0.0.1:{free_port()}"
    async with At("watch", 1, listen=address) as watch:
        second = f"127.0.0.1:{free_port()}"
        direct = number % 2
        reached = [{"connect": address}, {"connect": address}]
        if direct:
            reached = [{"connect": address, "listen": second}, {"connect": f"{address},{second}"}]
        two = [At("robot", 10 + one, **reached[one]) for one in (0, 1)]
        async with two[0], two[1]:
            await _until(lambda: sorted(one.standing for one in two) == ["owns", "withdrawn"])
            await _until(lambda: len(watch.sees) == 1)
            owner = next(one for one in two if one.standing == "owns")
            loser = next(one for one in two if one is not owner)
            assert watch.sees == [("robot", owner.face.epoch)]
            assert loser.sees == []
            assert ("robot", loser.face.epoch) not in owner.sees
            await _until(lambda: any("does not get the name" in text for text in owner.face.said))
            assert any("a kernel named 'robot' runs already on same" in text for text in loser.face.said)


@pytest.mark.slow(
    kept_by="network/test_names.py::test_of_two_that_claim_the_lower_stays_and_the_other_takes_the_name_when_it_is_free"
)
@pytest.mark.fault("E09")
def test_of_two_that_start_at_once_exactly_one_has_the_name() -> None:
    async def main() -> None:
        for begin in range(0, RACES, 6):
            await asyncio.gather(*(_one_race(number) for number in range(begin, min(begin + 6, RACES))))

    asyncio.run(main())


@pytest.mark.slow(
    kept_by="network/test_names.py::test_of_two_that_claim_the_lower_stays_and_the_other_takes_the_name_when_it_is_free"
)
@pytest.mark.fault("E09")
def test_a_later_one_is_refused_and_takes_the_name_when_it_is_free() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        async with At("watch", 1, listen=address) as watch:
            first = At("robot", 10, connect=address)
            async with first:
                await _until(lambda: first.standing == "owns" and watch.sees == [("robot", 10)])
                second = At("robot", 2, connect=address)
                async with second:
                    began = time.monotonic()
                    await _until(lambda: second.standing == "withdrawn")
                    assert time.monotonic() - began < 1.0
                    assert (first.standing, watch.sees, second.sees) == ("owns", [("robot", 10)], [])
                    await first.transport.close()
                    await _until(lambda: second.standing == "owns" and watch.sees == [("robot", 2)])
                    assert ("watch", 1) in second.sees

    asyncio.run(main())


@pytest.mark.slow(kept_by="network/test_names.py::test_an_owner_stays_whatever_the_clock_of_a_later_one_says")
def test_who_runs_already_stays_though_the_clock_of_the_later_one_is_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        async with At("robot", 10, listen=address) as first:
            await _until(lambda: first.standing == "owns")
            monkeypatch.setattr("aiorts_zenoh.transport.time.time_ns", lambda: 5)
            async with At("robot", 2, connect=address) as second:
                await _until(lambda: second.standing == "withdrawn")
                await asyncio.sleep(0.2)
                assert first.standing == "owns"

    asyncio.run(main())


@pytest.mark.slow(kept_by="network/test_names.py::test_of_two_machines_of_one_name_neither_has_it")
def test_of_two_machines_that_have_one_host_name_neither_is_seen() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        async with ZenohWatch(address) as watch:
            one, two = At("arm", 10, 1, connect=address), At("leg", 11, 2, connect=address)
            async with one, two:
                await _until(lambda: one.standing == two.standing == "refused")
                await _until(lambda: watch.sees == [])
                for each, other in ((one, "leg"), (two, "arm")):
                    assert any(f"with a kernel '{other}'" in text and "--host" in text for text in each.face.said)
                three = At("leg", 12, 1, connect=address)
                async with three:
                    await _until(lambda: three.standing == "owns" and watch.sees == [("leg", 12)])

    asyncio.run(main())


class ZenohWatch(At):
    """A kernel of another host."""

    def __init__(self, address: str) -> None:
        super().__init__("watch", 1, listen=address)
        settings = engine_settings(NetworkSettings(insecure=True, listen=address))
        self.transport = ZenohTransport("station", engine=settings, machine=9)


@pytest.mark.slow
@pytest.mark.fault("E18")
def test_a_kernel_is_seen_when_that_of_another_machine_with_its_host_name_is_revoked() -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        async with ZenohWatch(address) as watch:
            await _until(lambda: watch.standing == "owns")  # else it looks at all once more when it does
            config = zenoh.Config()
            config.insert_json5("connect/endpoints", json.dumps([f"tcp/{address}"]))
            with await asyncio.to_thread(zenoh.open, config) as others:
                kept: list[Any] = []
                for start_ns, name, machine in ((2, "arm", 1), (1, "leg", 2)):  # who was there first is seen
                    keys = Keys("default", Peer("same", name, 10), start_ns, machine)
                    kept += [others.liveliness().declare_token(one) for one in (keys.token, keys.owned)]
                    await _until(lambda name=name: watch.sees == [(name, 10)])  # type: ignore[misc]
                watch.transport.deny("leg")
                await _until(lambda: watch.sees == [("arm", 10)])

    asyncio.run(main())


@pytest.mark.slow(kept_by="first")
def test_a_name_that_is_taken_is_said_at_both_ends(caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "same", "insecure": True}}
        near = {"zenoh": {"connect": address, "host": "same", "insecure": True}}
        async with Kernel("robot", services=far) as one:
            await one.service(Network).opened()
            await _until(lambda: one.service(Network).report()["name"] == "owns")
            async with Kernel("robot", services=near) as two:
                await two.service(Network).opened()
                await _until(lambda: two.service(Network).report()["name"] == "withdrawn")
                await _until(lambda: "it does not get the name" in caplog.text)
                assert one.service(Links).peers == two.service(Links).peers == ()

    asyncio.run(main())
    assert "a kernel named 'robot' runs already on same; this one is not seen from other hosts" in caplog.text
    assert "another kernel named 'robot' was started on same" in caplog.text


class Process:
    """A process whose kernel claims a name; what it says goes to a file."""

    def __init__(self, output: Path, *arguments: str, before: list[str] | None = None) -> None:
        self.output = output
        with output.open("wb") as stream:
            command = [*(before or []), sys.executable, "-u", str(PROGRAM), *arguments]
            self.process = subprocess.Popen(command, stdout=stream, stderr=stream)

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait(10)

    @property
    def said(self) -> str:
        return self.output.read_text()

    @property
    def standing(self) -> str:
        return self.said.rpartition("standing: ")[2].split("\n")[0] if "standing: " in self.said else ""


def _wait(met: Callable[[], bool], *processes: Process, within: float = 60.0) -> None:
    until = time.monotonic() + within
    while not met():
        assert time.monotonic() < until, [one.said[-1000:] for one in processes]
        time.sleep(0.02)


@pytest.mark.slow(
    kept_by="network/test_names.py::test_of_two_that_claim_the_lower_stays_and_the_other_takes_the_name_when_it_is_free"
)
@pytest.mark.fault("E09")
def test_of_two_processes_that_start_at_once_one_has_the_name(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    with (
        Process(tmp_path / "0", "watch", "station", "listen", address) as watch,
        Process(tmp_path / "1", "robot", "same", "connect", address) as one,
        Process(tmp_path / "2", "robot", "same", "connect", address) as two,
    ):
        _wait(lambda: {one.standing, two.standing} == {"owns", "withdrawn"}, watch, one, two)
        owner, other = (one, two) if one.standing == "owns" else (two, one)
        _wait(lambda: "was started on same; it does not get the name" in owner.said, owner)
        assert "a kernel named 'robot' runs already on same" in other.said
        owner.process.kill()
        _wait(lambda: other.standing == "owns", other)


@pytest.mark.slow(kept_by="network/test_names.py::test_of_two_machines_of_one_name_neither_has_it")
@pytest.mark.fault("E09")
def test_a_host_name_that_two_machines_have_is_refused_to_both(
    hosts: tuple[list[str], list[str]], tmp_path: Path
) -> None:
    here, there = hosts
    with (
        Process(tmp_path / "1", "arm", "same", "listen", "10.77.0.2:7447", before=there) as one,
        Process(tmp_path / "2", "leg", "same", "connect", "10.77.0.2:7447", before=here) as two,
    ):
        _wait(lambda: one.standing in ("refused", "owns") and two.standing in ("refused", "withdrawn"), one, two)
        assert one.standing == ("refused" if two.standing == "refused" else "owns"), (one.said, two.said)
        for each in (one, two):
            _wait(lambda each=each: "another machine calls itself 'same' as well" in each.said, one, two)  # type: ignore[misc]
            assert "--host" in each.said
