"""The blocking client and that of a kernel's loop drive one session: both give the same, and neither waits for ever."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import AiortsError, BusyError, ClosedError, LimitError, NoAnswerError, StateError, WireError
from aiorts.remote.session import KernelSession
from aiorts.sessions import END, Client, Entry, framed, frames
from aiorts.sessions.protocol import NEWEST
from campaign import cases
from control_parts import WAIT, controlled, entry_of, until

HELLO = framed({"hello": {"protocol": NEWEST, "epoch": "ab", "right": "code"}})


@contextmanager
def saying(serve: Callable[[socket.socket], object], path: str) -> Iterator[Entry]:
    """What listens at a path, and does this with the one that comes; it hangs up when that is done."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        listener.settimeout(WAIT)

        def run() -> None:
            connected, _ = listener.accept()
            with connected, contextlib.suppress(ConnectionError):  # of a client that has heard enough
                connected.settimeout(WAIT)
                serve(connected)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield Entry("pc/k", 1, "", path)
        finally:
            thread.join(WAIT)
            assert not thread.is_alive()


def greet(connected: socket.socket, calls: int = 1) -> None:
    """Say hello, and hear so many calls."""
    connected.sendall(HELLO)
    buffer, heard = bytearray(), 0
    while heard < 1 + calls:
        buffer += connected.recv(1 << 16)
        heard += len(list(frames(buffer, 1 << 20)))


def outcome(ask: Callable[[], Any]) -> str:
    """What a question gives: a value, or an error by its code."""
    try:
        return repr(ask())
    except AiortsError as error:
        return error.code


async def outcome_of(asked: Any) -> str:
    try:
        return repr(await asked)
    except AiortsError as error:
        return error.code


# -- both give the same ------------------------------------------------------------------------------------------------

PLAIN = st.none() | st.integers(-2, 2) | st.just("x") | st.just([])
ODD = st.fixed_dictionaries({}, optional=dict.fromkeys(("id", "busy", "error"), PLAIN))
ANSWER = st.fixed_dictionaries(
    {"id": st.integers(0, 4)}, optional=dict.fromkeys(("ok", "item", "end", "error", "missed", "note"), PLAIN)
)
SAID = st.lists(st.one_of(ANSWER, ANSWER, ANSWER, ODD), max_size=8)


def of_blocking(client: Client) -> list[str]:
    numbers = [client.begin(name) for name in ("one", "two", "three")]
    return [outcome(lambda number=number: client.result(number, WAIT)) for number in numbers]  # type: ignore[misc]


async def of_loop(connected: socket.socket) -> list[str]:
    connected.setblocking(False)
    try:
        session = await KernelSession.over(connected, "pc/k", "me")
    except AiortsError as error:
        return [error.code] * 3
    try:
        asked = [asyncio.ensure_future(outcome_of(session.call(name))) for name in ("one", "two", "three")]
        return [await one for one in asked]
    finally:
        session.close()


@given(SAID, st.lists(st.integers(0, 200), max_size=4))
@settings(max_examples=cases(5_000))
def test_the_same_bytes_give_the_same_answers_and_an_end(answers: list[dict[str, Any]], cuts: list[int]) -> None:
    data = b"".join(framed(one) for one in answers)
    places = sorted(min(cut, len(data)) for cut in cuts)
    pieces = [data[a:b] for a, b in zip([0, *places], [*places, len(data)], strict=True)]

    def serve(connected: socket.socket) -> None:
        greet(connected, 3)
        for piece in pieces:
            connected.sendall(piece)

    with tempfile.TemporaryDirectory(prefix="al") as folder:
        with saying(serve, f"{folder}/1") as entry, Client.open(entry, timeout=WAIT) as client:
            blocking = of_blocking(client)
        with saying(serve, f"{folder}/2") as entry, socket.socket(socket.AF_UNIX) as connected:
            connected.connect(entry.path)
            looping = asyncio.run(of_loop(connected))
    assert blocking == looping


# -- what a session says of itself -------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_a_busy_kernel_is_said_to_be_so_before_its_hello")
@pytest.mark.anyio
async def test_who_comes_while_the_loop_is_held_is_let_in() -> None:
    """The kernel says that it is busy before it says hello."""
    async with controlled("held"):
        began, entry = threading.Event(), entry_of("held")

        def look() -> None:
            with Client.open(entry, timeout=WAIT) as client:
                client.call("names", WAIT)
                began.set()
                time.sleep(0.1)
                client.call("names", WAIT)  # the loop does not come to it for a while

        def come() -> str:
            time.sleep(0.15)
            with Client.open(entry, timeout=WAIT) as client:
                return client.right

        looks = asyncio.create_task(asyncio.to_thread(look))
        while not began.is_set():
            await asyncio.sleep(0.01)
        comes = asyncio.create_task(asyncio.to_thread(come))
        await asyncio.sleep(0)
        time.sleep(0.6)
        assert await comes == "code"
        await looks


def test_a_busy_kernel_is_said_to_be_so_before_its_hello(tmp_path: Path) -> None:
    gone = threading.Event()

    def serve(connected: socket.socket) -> None:
        connected.sendall(framed({"busy": 1.5}))
        gone.wait(WAIT)

    with saying(serve, str(tmp_path / "k")) as entry:
        try:
            with pytest.raises(NoAnswerError, match=r"no answer: its event loop has been busy for at least 1\.5 s"):
                Client.open(entry, timeout=0.2)
        finally:
            gone.set()


def test_a_stream_that_fails_has_ended(tmp_path: Path) -> None:
    def serve(connected: socket.socket) -> None:
        greet(connected)
        connected.sendall(b"".join(framed({"id": 1, **one}) for one in said))
        while connected.recv(1 << 16):
            pass

    said: list[dict[str, Any]] = [
        {"ok": None},
        {"item": 1, "missed": 0},
        {"error": {"code": "E-STATE", "text": "no more"}, "missed": 3},
    ]
    with saying(serve, str(tmp_path / "k")) as entry, Client.open(entry) as client:
        stream = client.stream("tap", WAIT)
        assert stream.next(WAIT) == 1
        with pytest.raises(StateError, match="no more"):
            stream.next(WAIT)
        assert (stream.next(WAIT), stream.ended, stream.missed) == (END, True, 3)


def test_after_a_call_that_was_sent_in_part_nothing_else_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts.sessions.client.TIMEOUT", 0.2)
    over, heard = threading.Event(), bytearray()

    def serve(connected: socket.socket) -> None:
        connected.sendall(HELLO)
        over.wait(WAIT)
        while data := connected.recv(1 << 16):
            heard.extend(data)

    with saying(serve, str(tmp_path / "k")) as entry:
        try:
            with Client.open(entry, timeout=WAIT) as client:
                for _ in range(2):
                    with pytest.raises(NoAnswerError, match="pc/k: does not take what is sent"):
                        client.call("part", WAIT, components=["x" * 65_000] * 8)
        finally:
            over.set()
    whole = list(frames(heard, 1 << 20))
    assert (len(whole), b'"' in heard, len(heard) < 520_000) == (1, False, True)


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_a_call_that_is_too_large_harms_no_other() -> None:
    async with controlled("large"):
        with socket.socket(socket.AF_UNIX) as connected:
            connected.connect(entry_of("large").path)
            connected.setblocking(False)
            session = await KernelSession.over(connected, "pc/large", "me")
            with pytest.raises(LimitError, match="at most 524288"):
                await session.call("part", components=["x" * 600_000])
            assert (await session.call("names"))["state"] == "open"
            session.close()


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("said", "error"),
    [
        ({"error": {"code": "E-BUSY", "text": "full"}}, BusyError),
        ({"id": 1, "item": 3}, WireError),
        ({"hello": 3}, ClosedError),
    ],
)
async def test_why_a_session_has_ended_is_what_a_call_raises(said: dict[str, Any], error: type[AiortsError]) -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with theirs:
        theirs.sendall(HELLO)
        session = await KernelSession.over(ours, "pc/k", "me")
        lost: list[int] = []
        session.lost = lambda: lost.append(1)
        asked = asyncio.ensure_future(session.call("names"))
        await asyncio.sleep(0)
        theirs.sendall(framed(said))
        theirs.shutdown(socket.SHUT_WR)
        with fail_after(WAIT), pytest.raises(error):
            await asked
        assert (lost, session.is_open) == ([1], False)


@pytest.mark.fault("E16")
@pytest.mark.anyio
async def test_frames_of_a_newer_kernel_are_passed_over() -> None:
    newer: list[dict[str, Any]] = [{"id": [], "ok": 1}, {"id": "x", "item": 1}, {"note": 1}, {"id": 1, "x": 1}]
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with theirs:
        theirs.sendall(HELLO)
        session = await KernelSession.over(ours, "pc/k", "me")
        asked = asyncio.ensure_future(session.call("names"))
        await asyncio.sleep(0)
        theirs.sendall(b"".join(framed(one) for one in (*newer, {"id": 1, "ok": "it"})))
        with fail_after(WAIT):
            assert await asked == "it"
        session.close()


@pytest.mark.fault("E16")
@pytest.mark.anyio
async def test_a_kernel_of_another_protocol_has_no_members_here() -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with theirs:
        theirs.sendall(framed({"hello": {"protocol": 3, "epoch": "ab", "right": "code"}}))
        with fail_after(WAIT), pytest.raises(AiortsError, match="pc/k speaks protocol 3, this speaks 1"):
            await KernelSession.over(ours, "pc/k", "me")


def test_a_thread_that_reads_ahead_ends_with_its_client(tmp_path: Path) -> None:
    def serve(connected: socket.socket) -> None:
        greet(connected)
        connected.sendall(framed({"id": 1, "ok": None}) + framed({"id": 1, "item": 1, "missed": 0}))
        while connected.recv(1 << 16):
            pass

    before = threading.active_count()
    with saying(serve, str(tmp_path / "k")) as entry:
        with Client.open(entry) as client:
            stream = client.stream("tap", WAIT)
            client.read_ahead()
            assert stream.next(WAIT) == 1
            with pytest.raises(NoAnswerError):
                stream.next(0.05)
        with pytest.raises(ClosedError):
            stream.next(WAIT)
    until(lambda: threading.active_count() == before)
