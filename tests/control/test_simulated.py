"""A client of a run in simulated time holds no time, changes no byte of a recording, and can end the run."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import pytest

from aiorts import Kernel, PeriodicContext
from aiorts.errors import ClosedError
from aiorts.sessions import Client
from aiorts.testing import simulate
from control_parts import WAIT, Counter, Reader, entry_of, running

pytestmark = pytest.mark.slow

SYSTEM = str(Path(__file__).parents[2] / "examples/pid/system.toml")


def recorded(file: Path, seed: int | None, seconds: int | None) -> tuple[int, bytes]:
    """A recording of so many seconds; of as many as a client needs for some answers where they are not given."""
    asked = 0

    def ask(client: Client) -> None:
        nonlocal asked
        with client, contextlib.suppress(ClosedError):
            events = client.stream("events", WAIT)
            counters = client.stream("counters", WAIT, rate=50.0)
            values = client.stream("monitor", WAIT, paths=["counter0.out"], rate=50.0)
            while True:
                client.call("names", WAIT)
                client.call("profile", WAIT)
                client.call("statistics", WAIT)
                events.next(WAIT)
                counters.next(WAIT)
                values.next(WAIT)
                asked += 1

    async def run() -> int:
        mode = "on" if seconds is None else "off"
        services = {"control": {"name": "recorded", "mode": mode}, "record": {"file": file}}
        watcher: threading.Thread | None = None
        async with Kernel(services=services) as kernel:
            counter, reader = await kernel.create(Counter, "counter0"), await kernel.create(Reader, "reader0")
            await kernel.connect(counter.out, reader.in_)
            if seconds is None:
                watcher = threading.Thread(target=ask, args=(Client.open(entry_of("recorded"), timeout=WAIT),))
                watcher.start()
            await kernel.start(PeriodicContext(rate=100.0, name="loop"), counter, reader, activate=True)
            done = 0
            while done < (seconds or 3) or (seconds is None and asked < 5 and done < 5000):
                await kernel.sleep(1.0)
                await kernel.deactivate(reader)
                await kernel.activate(reader)
                done += 1
        if watcher is not None:
            watcher.join(WAIT)
            assert asked >= 5
        return done

    return simulate(run(), seed=seed), file.read_bytes()


@pytest.mark.parametrize("seed", [None, 7])
def test_a_client_that_looks_all_the_time_changes_no_byte_of_a_recording(seed: int | None, tmp_path: Path) -> None:
    seconds, watched = recorded(tmp_path / "watched.mcap", seed, None)
    (tmp_path / "watched.mcap").rename(tmp_path / "before.mcap")
    assert recorded(tmp_path / "watched.mcap", seed, seconds) == (seconds, watched)


def test_a_run_in_simulated_time_is_ended_through_its_socket() -> None:
    with running("virtual", "--simulate", SYSTEM) as process:
        with Client.open(entry_of("virtual"), timeout=WAIT) as client:
            client.call("stop", WAIT)
            client.wait_end(WAIT)
        assert process.wait(WAIT) == 0
