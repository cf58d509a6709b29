"""A kernel with a socket is found, looked into and controlled by clients of the same user."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import os
import threading
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.errors import AbsentError, ClosedError, ControlError, DeniedError, StaleError, StateError
from aiorts.sessions import Client, entries
from aiorts.testing import simulate
from control_parts import WAIT, Counter, controlled, entry_of, with_client


@pytest.mark.anyio
async def test_a_kernel_is_found_by_its_entry_and_gone_afterwards() -> None:
    async with controlled("found") as kernel:
        entry = entry_of("found")
        assert kernel.address == entry.address
        assert f"{kernel.epoch:016x}" == entry.epoch
        assert entry.pid == os.getpid()
    assert (kernel.address, kernel.epoch) == ("", 0)
    assert entries() == ()


@pytest.mark.anyio
async def test_names_and_profile_are_what_the_kernel_is() -> None:
    async with controlled("names") as kernel:
        names = await with_client("names", lambda client: client.call("names"))
        profile = await with_client("names", lambda client: client.call("profile"))
    assert names["components"] == {"counter0": {"loop": "active"}, "reader0": {"loop": "active"}}
    assert names["contexts"] == {"loop": ["counter0", "reader0"]}
    assert list(profile["components"]) == list(kernel.registry.components) or set(profile["components"]) == {
        "counter0",
        "reader0",
    }


@pytest.mark.anyio
async def test_lifecycles_are_controlled_and_errors_keep_their_class() -> None:
    async with controlled("cycle") as kernel:
        await with_client("cycle", lambda client: client.call("deactivate", component="reader0"))
        assert [state.value for state in kernel.components["reader0"].states.values()] == ["inactive"]
        with pytest.raises(StateError, match="reader0"):
            await with_client("cycle", lambda client: client.call("deactivate", component="reader0"))


@pytest.mark.anyio
async def test_who_may_only_look_is_denied() -> None:
    async with controlled("looks", mode="view") as kernel:
        with pytest.raises(DeniedError, match="deactivate: needs the right 'operate'"):
            await with_client("looks", lambda client: client.call("deactivate", component="reader0"))
        assert [state.value for state in kernel.components["reader0"].states.values()] == ["active"]


@pytest.mark.anyio
async def test_a_call_for_another_epoch_does_nothing() -> None:
    async with controlled("epoch") as kernel:

        def stale() -> None:
            with Client(dataclasses.replace(entry_of("epoch"), epoch="0" * 16)) as client:
                client.call("deactivate", component="reader0")  # on its way before the kernel has said hello

        with pytest.raises(StaleError, match="Nothing was done"):
            await asyncio.to_thread(stale)
        assert [state.value for state in kernel.components["reader0"].states.values()] == ["active"]


@pytest.mark.anyio
async def test_a_name_that_is_held_is_refused_with_its_holder() -> None:
    async with controlled("held"):
        with pytest.raises(ControlError, match=f"held by process {os.getpid()}"):
            await Kernel(services={"control": {"name": "held"}}).open()


@pytest.mark.row(83)
@pytest.mark.anyio
async def test_what_a_killed_kernel_left_is_removed_by_the_next_reader() -> None:
    async with controlled("killed"):
        entry = entry_of("killed")
        file = Path(entry.path).with_suffix(".json")
        data = file.read_text(encoding="utf-8")
    file.write_text(data, encoding="utf-8")
    assert [one.name for one in entries()] == ["killed"]
    with pytest.raises(AbsentError, match="is gone"):
        await asyncio.to_thread(Client.open, entry)
    assert entries() == ()


@pytest.mark.slow
def test_a_client_holds_no_simulated_time_and_changes_no_result() -> None:
    asked = 0

    def ask(client: Client) -> None:
        nonlocal asked
        with client, contextlib.suppress(ClosedError):
            while True:
                client.call("names", WAIT)
                asked += 1

    async def run(seconds: int, *, watched: bool) -> tuple[int, float, int, int]:
        async with controlled("simulated", rate=1000.0) as kernel:
            watcher = None
            if watched:
                client = Client.open(entry_of("simulated"), timeout=WAIT)
                watcher = threading.Thread(target=ask, args=(client,))
                watcher.start()
            slept = 0
            while slept < seconds or (watched and not asked and slept < 2000):
                await kernel.sleep(1.0)
                slept += 1
            counter, loop = kernel.components["counter0"], kernel.contexts["loop"]
            assert isinstance(counter, Counter)
            seen = slept, counter.count, kernel.bus.sequence, loop.statistics.cycles
        if watcher is not None:
            watcher.join(WAIT)
        return seen

    seen = simulate(run(5, watched=True))
    assert asked > 0
    assert simulate(run(seen[0], watched=False)) == seen


def test_nothing_that_will_ever_happen_is_an_error_with_the_socket_open() -> None:
    async def run() -> None:
        async with Kernel(services={"control": {"name": "deadlock"}}):
            client = Client(entry_of("deadlock"))
            try:
                await asyncio.get_running_loop().create_future()
            finally:
                client.close()

    with pytest.raises(StateError, match="nothing will ever happen"):
        simulate(run())
