"""`aiorts foxglove` beside the running Roomba system, as its user has it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import pytest

from aiorts.cli.app import run_command
from control_parts import WAIT, controlled, running
from foxglove_parts import serving, viewer

ROOMBA = str(Path(__file__).parents[2] / "examples/roomba/system.toml")
PORTS = {
    *("imu.encoders", "imu.gyro", "imu.acceleration", "imu.truth", "odometry.pose"),
    *("metres.output0", "turn_rate.output0"),
}


@pytest.mark.slow(
    kept_by="foxglove/test_serving.py::test_samples_of_a_port_come_as_its_schema_says_and_the_system_is_as_it_was"
)
@pytest.mark.parametrize("subprotocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_the_roomba_is_shown_and_the_end_of_it_too(subprotocol: str) -> None:
    async def look(url: str) -> None:
        async with viewer(url, subprotocol) as one, viewer(url) as two:
            for each in (one, two):
                await each.until(lambda each=each: each.channels.keys() >= PORTS)
                await each.want(*PORTS)
            await one.until(lambda: all(len(one.samples.get(port, ())) >= 20 for port in PORTS) and one.times)
            for port in PORTS:
                schema = json.loads(one.channels[port]["schema"])
                for sample in one.samples[port]:
                    jsonschema.validate(sample, schema)
            assert one.times == sorted(one.times)
            two.socket.transport.abort()  # it has gone without a word
            run.send_signal(signal.SIGINT)
            await one.until(lambda: "kernel" in one.statuses)
            assert "has ended" in one.statuses["kernel"]["message"]

    with running("roomba", ROOMBA) as run, serving("roomba") as (process, url):
        asyncio.run(look(url))
        assert process.wait(WAIT) == 0


@pytest.mark.slow
def test_it_ends_soon_after_its_kernel_beside_a_viewer_that_does_not_read(tmp_path: Path) -> None:
    (tmp_path / "large.py").write_text(
        "import numpy\nfrom aiorts import Component, OutPort\nfrom aiorts.types import TimedDoubleSeq\n"
        "class Large(Component):\n    out = OutPort(TimedDoubleSeq)\n"
        "    def on_execute(self):\n        self.out.write_nowait(TimedDoubleSeq(0, numpy.ones(20_000)))\n"
    )

    async def look(url: str, run: subprocess.Popen[str]) -> None:
        async with viewer(url, close_timeout=0.1) as one:
            await one.until(lambda: "large.out" in one.channels)
            await one.want("large.out")
            await one.until(lambda: one.samples)
            one.socket.transport.pause_reading()
            await asyncio.sleep(2.0)  # until the sockets between the two are full
            run.send_signal(signal.SIGINT)
            began = time.monotonic()
            assert await asyncio.to_thread(process.wait, WAIT) == 0
            assert time.monotonic() - began < 8.0  # 11 s before; about 3 on a machine that is free
            one.socket.transport.abort()

    with (
        running("large", f"{tmp_path}/large.py:Large", "--rate", "50", "--quiet") as run,
        serving("large") as (process, url),
    ):
        asyncio.run(look(url, run))


@pytest.mark.slow(kept_by="foxglove/test_viewer.py::test_a_kernel_that_comes_again_is_a_new_session")
def test_it_waits_for_a_kernel_and_for_its_return() -> None:
    async def look(url: str) -> None:
        async with viewer(url) as one:
            await one.until(lambda: one.channels)
            first, before = one.info[-1]["sessionId"], {channel["id"] for channel in one.channels.values()}
            run.kill()
            await one.until(lambda: "waiting for it" in one.statuses.get("kernel", {}).get("message", ""))
            assert not one.channels
            with running("again", ROOMBA):
                await one.until(lambda: len(one.channels) >= len(PORTS))
                assert one.info[-1]["sessionId"] != first
                assert not before & {channel["id"] for channel in one.channels.values()}
                assert "kernel" not in one.statuses
                await one.want("imu.gyro")
                await one.until(lambda: one.samples)

    with running("again", ROOMBA) as run, serving("again", "--wait") as (_, url):
        asyncio.run(look(url))


@pytest.mark.slow(kept_by="foxglove/test_viewer.py::test_a_kernel_that_comes_again_is_a_new_session")
def test_a_stopped_process_is_said_not_to_answer() -> None:
    async def look(url: str) -> None:
        async with viewer(url) as one:
            await one.until(lambda: one.channels)
            os.kill(run.pid, signal.SIGSTOP)
            try:
                await one.until(lambda: "no answer" in one.statuses.get("kernel", {}).get("message", ""))
            finally:
                os.kill(run.pid, signal.SIGCONT)
            await one.until(lambda: "kernel" not in one.statuses)

    with running("stopped", ROOMBA) as run, serving("stopped") as (_, url):
        asyncio.run(look(url))


def test_nothing_that_runs_is_an_error_that_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["foxglove", "nobody"]) == 6
    assert "aiorts run" in capsys.readouterr().err


@pytest.mark.anyio
async def test_a_port_that_is_taken_and_a_missing_package_are_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with controlled("taken"):
        async with await asyncio.start_server(lambda *_: None, "127.0.0.1", 0) as server:
            port = str(server.sockets[0].getsockname()[1])
            assert await asyncio.to_thread(run_command, ["foxglove", "taken", "--port", port]) == 2
        assert f"--port {port}" in capsys.readouterr().err
        monkeypatch.setitem(sys.modules, "websockets.asyncio.server", None)
        assert await asyncio.to_thread(run_command, ["foxglove", "taken"]) == 2
        assert 'pip install "aiorts[foxglove]"' in capsys.readouterr().err


@pytest.mark.slow(
    kept_by="foxglove/test_viewer.py::test_it_begins_with_the_server_and_an_advertisement_even_of_nothing"
)
def test_a_viewer_may_come_before_the_kernel() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    async def look() -> None:
        url = f"ws://127.0.0.1:{port}"
        async with viewer(url) as one:
            assert (one.info[0]["name"], one.channels) == ("aiorts", {})
            with running("later", ROOMBA):
                await one.until(lambda: one.channels.keys() >= PORTS)
                assert one.info[-1]["name"] == "later"

    command = [sys.executable, "-m", "aiorts", "foxglove", "later", "--wait", "--port", str(port)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stderr is not None
            assert "waiting for it" in process.stderr.readline()
            asyncio.run(look())
        finally:
            process.kill()
