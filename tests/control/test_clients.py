"""No client takes connections, calls or descriptors that others need, and some are kept for those who operate."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.control import Control, Right
from aiorts.control.server.clients import CALLS, CONNECTIONS, LOOKING, OF_ONE, Clients
from aiorts.errors import BusyError
from aiorts.guide import pages
from aiorts.sessions import Client, answer_in, framed, frames
from aiorts.sessions.protocol import NEWEST, OLDEST
from control_parts import WAIT, controlled, entry_of, until, with_client

pytestmark = pytest.mark.anyio
HOG = Path(__file__).with_name("hogging_program.py")


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_a_client_has_its_connections_and_those_who_look_leave_some() -> None:
    clients = Clients()
    made = [clients.connect("anna", Right.VIEW) for _ in range(OF_ONE[Right.VIEW])]
    assert len(set(made)) == 1
    with pytest.raises(BusyError, match=rf"anna has {OF_ONE[Right.VIEW]} connections with this kernel already"):
        clients.connect("anna", Right.VIEW)
    made += [clients.connect(f"viewer {number}", Right.VIEW) for number in range(LOOKING - len(made))]
    with pytest.raises(BusyError, match=f"{LOOKING} clients look into this kernel already"):
        clients.connect("one more", Right.VIEW)
    made += [clients.connect(f"operator {number}", Right.OPERATE) for number in range(CONNECTIONS - LOOKING)]
    with pytest.raises(BusyError, match=f"{CONNECTIONS} clients are connected with this kernel already"):
        clients.connect("one more", Right.CODE)
    clients.disconnect(made[0])
    assert clients.connect("anna", Right.VIEW) is made[0]


def test_a_connection_counts_as_what_is_wanted_of_it() -> None:
    clients = Clients()
    made = [clients.connect("anna", Right.CODE) for _ in range(OF_ONE[Right.CODE])]
    lowered = [clients.lower(made.pop(), Right.VIEW) for _ in range(OF_ONE[Right.VIEW])]
    with pytest.raises(BusyError, match=rf"anna has {OF_ONE[Right.VIEW]} connections with this kernel already"):
        clients.lower(made[0], Right.VIEW)
    assert clients.lower(made[0], Right.CODE) is made[0]
    for one in (*made, *lowered):
        clients.disconnect(one)
    assert (clients._connections, clients._looking, made[0].connections, lowered[0].connections) == (0, 0, 0, 0)


def test_what_a_client_used_counts_for_its_next_connection_and_few_are_known() -> None:
    clients = Clients()
    first = clients.connect("anna", Right.VIEW)
    first.use(1.0)
    clients.disconnect(first)
    assert clients.connect("anna", Right.VIEW) is first
    for number in range(5_000):
        clients.disconnect(clients.connect(f"process {number}", Right.VIEW))
    assert len(clients._known) <= 1_024
    assert clients.connect("anna", Right.VIEW) is first  # it is connected


@pytest.mark.slow(kept_by="test_a_client_has_its_connections_and_those_who_look_leave_some")
async def test_who_looks_leaves_connections_and_descriptors_to_who_operates() -> None:
    async with controlled("kept") as kernel:
        control = kernel.service(Control)
        before = descriptors()
        with ExitStack() as connected:
            for number in range(LOOKING):
                connected.enter_context(control.admit(Right.VIEW, f"viewer {number}"))
            full = descriptors()
            for number in range(2_000):
                with pytest.raises(BusyError):
                    control.admit(Right.VIEW, f"viewer {number}")
            assert descriptors() <= full
            operator = connected.enter_context(control.admit(Right.OPERATE, "otto"))
            call = {"id": 1, "op": "deactivate", "epoch": control.hello["epoch"], "args": {"component": "reader0"}}

            def work() -> str:
                buffer, came = bytearray(), ""
                operator.settimeout(WAIT)
                operator.sendall(framed({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": "it"}}) + framed(call))
                while not came:
                    data = operator.recv(65_536)
                    assert data, "it hangs up"
                    buffer += data
                    came = "".join("done" for frame in frames(buffer, 1 << 20) if "ok" in answer_in(frame))
                return came

            assert await asyncio.to_thread(work) == "done"
        await asyncio.to_thread(until, lambda: descriptors() <= before)
        assert await with_client("kept", lambda client: client.call("names"))


@pytest.mark.slow(kept_by="test_a_client_has_its_connections_and_those_who_look_leave_some")
@pytest.mark.parametrize(("mode", "right"), [("on", ""), ("view", ""), ("on", "view")])
async def test_a_process_that_takes_all_it_can_is_told_so_and_others_are_served(mode: str, right: str) -> None:
    async with controlled("hogged", mode=mode):
        hog = subprocess.Popen(
            [sys.executable, str(HOG), "hogged", "300", right], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        try:
            assert hog.stdout is not None
            said = await asyncio.wait_for(asyncio.to_thread(lambda: list(iter(hog.stdout.readline, "\n"))), 2 * WAIT)  # type: ignore[union-attr]
            most = OF_ONE[Right.VIEW if "view" in (mode, right) else Right.CODE]
            assert int(said[0]) == most
            told = f"E-BUSY .*process {hog.pid} has {most} connections with this kernel already; end one of them"
            assert [bool(re.match(told, line)) for line in said[1:]] == [True]
            for _ in range(3):
                assert await with_client("hogged", lambda client: client.call("names"))
        finally:
            hog.kill()
            hog.communicate(timeout=WAIT)
        assert await with_client("hogged", lambda client: client.call("names"))


async def test_a_client_that_has_all_its_connections_ends_none_of_another() -> None:
    """Each one more that it tried took the connection of somebody who had not said hello yet."""
    async with controlled("crowded", mode="view") as kernel:
        with kernel.service(Control).admit(Right.VIEW, "anna") as other:
            hog = subprocess.Popen(
                [sys.executable, str(HOG), "crowded", "100"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            try:
                assert hog.stdout is not None
                await asyncio.wait_for(asyncio.to_thread(lambda: list(iter(hog.stdout.readline, "\n"))), 2 * WAIT)  # type: ignore[union-attr]

                def greeted() -> bytes:
                    other.settimeout(WAIT)
                    other.sendall(framed({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": "it"}}))
                    return other.recv(65_536)

                assert b"crowded" in await asyncio.to_thread(greeted)
            finally:
                hog.kill()
                hog.communicate(timeout=WAIT)


async def test_calls_of_one_client_are_counted_together() -> None:
    async with controlled("called", mode="view"):

        def work() -> tuple[int, str]:
            with ExitStack() as stack:
                begun, told = 0, ""
                for _ in range(3):
                    client = stack.enter_context(Client.open(entry_of("called"), timeout=WAIT))
                    for _ in range(CALLS[Right.VIEW] // 2):
                        try:
                            client.call("log", WAIT, follow=True)
                            begun += 1
                        except BusyError as error:
                            told = str(error)
                return begun, told

        begun, told = await asyncio.to_thread(work)
        assert begun == CALLS[Right.VIEW]
        assert f"log: {begun} calls of process {os.getpid()} wait already" in told
        assert await with_client("called", lambda client: client.call("names"))


def test_the_guide_names_these_limits() -> None:
    text = " ".join(next(one for one in pages() if one.name == "secure-network").text.split())
    said = re.search(
        r"at most (\d+) connections and (\d+) calls .* (\d+) and ([\d,]+) for who operates.* of (\d+) connections "
        r"(\d+) are",
        text,
    )
    assert said is not None
    assert [int(one.replace(",", "")) for one in said.groups()] == [
        *(OF_ONE[Right.VIEW], CALLS[Right.VIEW], OF_ONE[Right.OPERATE], CALLS[Right.OPERATE]),
        *(CONNECTIONS, CONNECTIONS - LOOKING),
    ]


async def test_a_kernel_that_ends_has_no_connection_left() -> None:
    before = descriptors()
    async with Kernel(services={"control": {"name": "ends"}}) as kernel:
        made = [kernel.service(Control).admit(Right.VIEW, "anna") for _ in range(10)]
    for one in made:
        one.close()
    assert descriptors() <= before + 1
