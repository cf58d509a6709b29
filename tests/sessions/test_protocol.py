"""What peers of other releases say is understood or refused in one sentence; what is wrong harms its sender alone."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack  # type: ignore[import-untyped]
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import AiortsError, ControlError, LimitError, NoAnswerError, WireError
from aiorts.sessions import Client, Entry
from aiorts.sessions.protocol import REQUESTS, WAITING, answer_in, frames, packed, request_in
from campaign import cases
from control_parts import WAIT, controlled, entry_of, until, with_client
from garbage import HELLO, framed

TRANSCRIPTS = json.loads(Path(__file__).with_name("transcripts.json").read_text(encoding="utf-8"))


def said(message: Any) -> bytes:
    """A message as its frame."""
    return framed(msgpack.packb(message))


class Peer:
    """A client that says bytes."""

    def __init__(self, path: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(WAIT)
        self.socket.connect(path)
        self._buffer = bytearray()
        self._frames: list[dict[Any, Any]] = []

    def say(self, data: bytes) -> None:
        """Send."""
        self.socket.sendall(data)

    def hear(self) -> dict[Any, Any] | None:
        """The next message; None when the session has ended."""
        while not self._frames:
            try:
                data = self.socket.recv(1 << 16)
            except ConnectionError:
                return None
            if not data:
                return None
            self._buffer += data
            self._frames.extend(answer_in(one) for one in frames(self._buffer, 1 << 30))
        return self._frames.pop(0)


async def with_peer(name: str, use: Callable[[Peer, Entry], Any]) -> Any:
    """What `use` makes of a client that says bytes to the kernel of this name, in a thread."""

    def work() -> Any:
        entry = entry_of(name)
        peer = Peer(entry.path)
        try:
            return use(peer, entry)
        finally:
            peer.socket.close()

    return await asyncio.to_thread(work)


@contextmanager
def kernel_that_says(answers: list[bytes], path: str) -> Iterator[list[bytes]]:
    """A kernel of another release: an answer for each frame that comes; what came is in the list."""
    heard: list[bytes] = []
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(path)
    listener.listen()
    listener.settimeout(WAIT)

    def serve() -> None:
        connected, _ = listener.accept()
        with connected:
            connected.settimeout(WAIT)
            buffer, left = bytearray(), list(answers)
            while data := connected.recv(1 << 16):
                buffer += data
                for one in frames(buffer, 1 << 20):
                    if not heard:
                        connected.sendall(left.pop(0))
                    elif left:
                        connected.sendall(b"".join(left))
                        left.clear()
                    heard.append(framed(one))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield heard
    finally:
        thread.join(WAIT)
        listener.close()


@pytest.mark.fault("E16")
@pytest.mark.anyio
@pytest.mark.parametrize("case", TRANSCRIPTS["clients"])
async def test_a_client_of_another_release(case: str, caplog: pytest.LogCaptureFixture) -> None:
    transcript = TRANSCRIPTS["clients"][case]

    def use(peer: Peer, entry: Entry) -> list[Any]:
        peer.say(b"".join(bytes.fromhex(one) for one in transcript["says"]))
        first = peer.hear()
        if "error" in transcript:
            return [first, peer.hear()]
        peer.say(said({"id": 1, "op": "names", "epoch": entry.epoch, "args": {}, "of n+1": True}))
        return [first, peer.hear()]

    async with controlled("golden"):
        first, second = await with_peer("golden", use)
    if "error" in transcript:
        sentence = transcript["error"].replace("PID", str(os.getpid()))
        assert first["error"]["text"].startswith(sentence)
        assert second is None
        assert sentence in caplog.text
    else:
        assert first["hello"]["protocol"] == transcript["protocol"]
        assert second["ok"]["state"] == "open"


@pytest.mark.fault("E16")
@pytest.mark.parametrize("case", TRANSCRIPTS["kernels"])
def test_a_kernel_of_another_release(case: str, runtime: str) -> None:
    transcript, path = TRANSCRIPTS["kernels"][case], f"{runtime}/k.sock"
    with kernel_that_says([bytes.fromhex(one) for one in transcript["answers"]], path) as heard:
        entry = Entry("host/golden", 1, "", path)
        if "error" in transcript:
            with pytest.raises(ControlError) as caught:
                Client.open(entry, timeout=WAIT, who="golden")
            assert str(caught.value).startswith(transcript["error"])
        else:
            with Client.open(entry, timeout=WAIT, who="golden") as client:
                assert client.call("names", WAIT) == transcript["ok"]
    assert heard == [bytes.fromhex(one) for one in transcript["says"]]


# -- wrong frames ------------------------------------------------------------------------------------------------------

SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats()
PLAIN = st.recursive(
    SCALARS | st.text(max_size=8) | st.binary(max_size=8),
    lambda one: st.lists(one, max_size=4) | st.dictionaries(st.text(max_size=4) | st.integers(0, 9), one, max_size=4),
    max_leaves=10,
)
ARGUMENTS = st.dictionaries(st.sampled_from(("component", "context", "timeout", "follow")), PLAIN, max_size=3)
CALLS = st.fixed_dictionaries(
    {},
    optional={
        "id": st.integers(-2, 3) | PLAIN,
        "op": st.sampled_from(("names", "profile", "log", "activate", "nothing")) | PLAIN,
        "epoch": st.just("EPOCH") | PLAIN,
        "args": ARGUMENTS | PLAIN,
        "cancel": PLAIN,
        "hello": PLAIN,
    },
)


@given(st.binary(max_size=200))
@settings(max_examples=cases(5000), deadline=None)
def test_a_frame_of_any_bytes_is_a_map_or_an_error(frame: bytes) -> None:
    with contextlib.suppress(WireError):
        assert type(request_in(frame)) is dict


@pytest.mark.parametrize(
    "frame",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b"\xc0", id="nil"),
        pytest.param(b"\x90", id="list"),
        pytest.param(b"\xc1", id="never used"),
        pytest.param(b"\xd4\x01\x00", id="extension"),
        pytest.param(b"\x81\x80\x01", id="map as key"),
        pytest.param(b"\x81\x90\x01", id="list as key"),
        pytest.param(b"\xdf\xff\xff\xff\xff", id="lying map"),
        pytest.param(b"\xdd\xff\xff\xff\xff", id="lying list"),
        pytest.param(b"\x81\xa1a\xdb\xff\xff\xff\xff", id="lying text"),
        pytest.param(b"\x81\xa1a" + b"\x91" * 1000 + b"\x01", id="deep"),
        pytest.param(b"\x80\x80", id="two values"),
        pytest.param(msgpack.packb({"a": list(range(9000))}), id="many values"),
    ],
)
@pytest.mark.anyio
async def test_a_wrong_frame_ends_its_own_session_with_the_reason(frame: bytes) -> None:
    def use(peer: Peer, entry: Entry) -> list[Any]:
        peer.say(HELLO + framed(frame))
        return [peer.hear(), peer.hear(), peer.hear()]

    async with controlled("wrong"):
        hello, error, end = await with_peer("wrong", use)
        names = await with_client("wrong", lambda client: client.call("names"))
    assert "hello" in hello
    assert error["error"]["code"] in (WireError.code, LimitError.code)
    assert end is None
    assert names["state"] == "open"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ({"id": 1, "op": "names"}, ControlError.code),
        ({"hello": None}, ControlError.code),
        ({"hello": {"oldest": "1", "newest": 1}}, ControlError.code),
        ({"hello": {"oldest": True, "newest": 1}}, ControlError.code),
    ],
)
@pytest.mark.anyio
async def test_who_does_not_begin_with_hello_is_refused(message: Any, code: str) -> None:
    def use(peer: Peer, entry: Entry) -> list[Any]:
        peer.say(said(message))
        return [peer.hear(), peer.hear()]

    async with controlled("hello"):
        error, end = await with_peer("hello", use)
    assert error["error"]["code"] == code
    assert end is None


@pytest.mark.anyio
async def test_a_length_that_is_too_long_is_refused_before_its_bytes_come() -> None:
    def use(peer: Peer, entry: Entry) -> Any:
        peer.say((REQUESTS.frame + 1).to_bytes(4, "big"))
        return peer.hear()

    async with controlled("length"):
        error = await with_peer("length", use)
        with pytest.raises(LimitError, match=f"at most {REQUESTS.frame} are allowed"):
            await with_client("length", lambda client: client.call("activate", component="x" * REQUESTS.frame))
    assert error["error"]["code"] == LimitError.code


@pytest.mark.anyio
async def test_who_it_is_cannot_write_into_the_terminal_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")

    def use(peer: Peer, entry: Entry) -> None:
        peer.say(said({"hello": {"oldest": 1, "newest": 1, "who": "a\x1b[2J\nb\u202e"}}))
        peer.hear()
        peer.say(said({"id": 1, "op": "deactivate", "epoch": entry.epoch, "args": {"component": "reader0"}}))
        peer.hear()

    async with controlled("who"):
        await with_peer("who", use)
    line = next(one for one in caplog.messages if "deactivate(" in one)
    assert line.startswith('who="a [2J b  [process ')


@pytest.mark.slow(kept_by="test_a_wrong_frame_ends_its_own_session_with_the_reason")
@given(st.lists(CALLS, min_size=1, max_size=8))
@settings(max_examples=cases(500), deadline=None)
def test_calls_of_any_shape_are_answered_or_refused_and_the_next_client_is_served(messages: list[Any]) -> None:
    async def run() -> None:
        async with controlled("any"):

            def use(peer: Peer, entry: Entry) -> None:
                peer.say(HELLO)
                peer.hear()
                for message in messages:
                    if message.get("epoch") == "EPOCH":
                        message["epoch"] = entry.epoch
                    try:
                        peer.say(said(message))
                    except (ConnectionError, OverflowError):
                        return
                peer.socket.shutdown(socket.SHUT_WR)
                while peer.hear() is not None:
                    pass

            await with_peer("any", use)
            assert (await with_client("any", lambda client: client.call("names")))["state"] == "open"

    asyncio.run(run())


# -- calls -------------------------------------------------------------------------------------------------------------


@pytest.mark.anyio
async def test_a_number_that_is_in_use_is_refused_and_the_first_call_goes_on() -> None:
    def use(peer: Peer, entry: Entry) -> list[Any]:
        events = {"id": 1, "op": "events", "epoch": entry.epoch, "args": {"kinds": ["HookFailed"]}}
        peer.say(HELLO + said(events))
        answers = [peer.hear(), peer.hear()]
        peer.say(said(events) + said({"id": 5, "cancel": True}) + said({"id": 1, "cancel": True}))
        return [*answers, peer.hear(), peer.hear()]

    async with controlled("twice"):
        _, began, refused, ended = await with_peer("twice", use)
    assert "ok" in began
    assert refused["error"]["code"] == "E-BUSY"
    assert "end" in ended


@pytest.mark.slow(kept_by="test_a_number_that_is_in_use_is_refused_and_the_first_call_goes_on")
@pytest.mark.anyio
async def test_so_many_calls_and_streams_run_at_a_time_and_as_many_again_once_they_were_cancelled() -> None:
    def use(client: Client) -> int:
        for _ in range(2):
            streams = [client.stream("events", WAIT) for _ in range(WAITING)]
            with pytest.raises(AiortsError, match=f"{WAITING} calls of this client"):
                client.call("names", WAIT)
            for _ in range(300):  # what is refused makes no room
                with pytest.raises(ControlError, match="no operation"):
                    client.call("nothing", WAIT)
            with pytest.raises(AiortsError, match=f"{WAITING} calls of this client"):
                client.call("names", WAIT)
            for stream in streams:
                stream.close()
            until(lambda: _works(client))
        return len(streams)

    async with controlled("many") as kernel:
        before = kernel.bus.sequence
        assert await with_client("many", use) == WAITING
        assert kernel.bus.sequence >= before


@pytest.mark.anyio
async def test_a_stream_that_did_not_begin_in_time_has_ended_in_the_kernel_too() -> None:
    """Each one went on there unseen, and 256 of them were all that a client may have."""

    def use(client: Client) -> bool:
        for _ in range(WAITING + 20):
            with pytest.raises(NoAnswerError):
                client.stream("tap", 0.0, port="counter0.out")
        until(lambda: _works(client))
        return True

    async with controlled("unanswered"):
        assert await with_client("unanswered", use)


def _works(client: Client) -> bool:
    try:
        client.call("names", WAIT)
    except AiortsError:
        return False
    return True


@pytest.mark.anyio
async def test_a_call_that_is_cancelled_has_a_last_answer_and_a_line_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")

    def use(peer: Peer, entry: Entry) -> Any:
        call = {"id": 1, "op": "deactivate", "epoch": entry.epoch, "args": {"component": "reader0"}}
        peer.say(HELLO + said(call) + said({"id": 1, "cancel": True}))
        peer.hear()
        return peer.hear()

    async with controlled("cancel"):
        answer = await with_peer("cancel", use)
    assert "error" in answer or "ok" in answer
    line = next(one for one in caplog.messages if "deactivate(" in one)
    assert line.endswith('outcome="cancelled"' if "error" in answer else 'outcome="done"')


@pytest.mark.slow
@pytest.mark.anyio
async def test_who_waits_while_the_loop_is_held_is_told_so() -> None:
    import time

    async with controlled("held") as kernel:
        began = threading.Event()

        def ask() -> str:
            with Client.open(entry_of("held"), timeout=WAIT) as client:
                client.call("names", WAIT)
                began.set()
                try:
                    while True:
                        client.call("names", 0.5)
                except AiortsError as error:
                    return str(error)

        asked = asyncio.create_task(asyncio.to_thread(ask))
        while not began.is_set():
            await asyncio.sleep(0.01)
        time.sleep(1.0)
        answer = await asked
    assert answer == f"{kernel.address or answer.partition(':')[0]}: no answer: {answer.rpartition(': ')[2]}"
    assert answer.rpartition(": ")[2].startswith("its event loop has been busy for at least 0.")


@pytest.mark.parametrize(
    ("sent", "heard"),
    [
        (os.fsdecode(b"/r\xc3\xc4\xff"), os.fsdecode(b"/r\xc3\xc4\xff")),  # a path whose bytes are no UTF-8
        ("a\ud800b", "a\ufffdb"),  # half a character, as JSON can escape it
        (f"\udfff{os.fsdecode(bytes([255]))}", f"\ufffd{os.fsdecode(bytes([255]))}"),
        ("ä\U0001f916", "ä\U0001f916"),
    ],
)
def test_every_text_can_be_said(sent: str, heard: str) -> None:
    assert answer_in(packed({"id": 1, "ok": {sent: [sent, 2**70]}})) == {"id": 1, "ok": {heard: [heard, str(2**70)]}}
    assert request_in(packed({"op": sent})) == {"op": heard}
    assert packed({"x": "ä"}) == msgpack.packb({"x": "ä"})
