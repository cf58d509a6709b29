"""What kernels ask each other: an answer is for who asked alone, and what is asked twice is carried out once."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Coroutine
from typing import Any

import pytest

pytest.importorskip("zenoh")

import zenoh

from aiorts.links import Caller
from aiorts_zenoh import NetworkSettings, ZenohTransport
from aiorts_zenoh.network import engine_settings
from network.network_parts import free_port

pytestmark = pytest.mark.slow

EPOCHS = {"victim": 7, "mallory": 8}


class Face:
    """What the transport sees of a kernel."""

    name, epoch = "asked", 5

    def run_in_background(self, coroutine: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        return asyncio.get_running_loop().create_task(coroutine, name=name)

    def report(self, text: str) -> None:
        raise AssertionError(text)


class Asking:
    """Two kernels of another host, as one session of the bare engine, and a kernel that they ask."""

    def __init__(self) -> None:
        self.carried_out: list[str] = []

    async def answer(self, body: bytes, caller: Caller) -> bytes:
        assert caller.peer is not None
        self.carried_out.append(caller.peer.kernel)
        return f"for {caller.peer.kernel}".encode() + bytes(int(body))

    async def ask(self, key: str, attachment: str, number: int, body: str) -> tuple[bool, bytes]:
        """What comes back for a question at the key of one name, with the attachment of another."""
        who = EPOCHS[attachment].to_bytes(8, "little") + number.to_bytes(8, "little") + f"far/{attachment}".encode()
        at = f"aiorts/1/default/svc/here/asked/{Face.epoch:016x}/{key}/secret"

        def work() -> tuple[bool, bytes]:
            (reply,) = self.session.get(at, payload=body.encode(), attachment=who, timeout=10.0)
            return (True, reply.ok.payload.to_bytes()) if reply.ok else (False, reply.err.payload.to_bytes())

        return await asyncio.to_thread(work)

    async def __aenter__(self) -> Asking:
        address = f"127.0.0.1:{free_port()}"
        settings = NetworkSettings(listen=address, insecure=True)
        self.transport = ZenohTransport("here", engine=engine_settings(settings))
        self.transport.answer("secret", self.answer)
        await self.transport.open(Face())
        self.transport.presence(lambda _peer, _up: None)
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", json.dumps([f"tcp/{address}"]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session: Any = await asyncio.to_thread(zenoh.open, config)
        tokens = [
            f"aiorts/1/default/live/far/{name}/1-{epoch:016x}-{1:016x}{end}"
            for name, epoch in EPOCHS.items()
            for end in ("", "/own")
        ]
        self.tokens = [self.session.liveliness().declare_token(token) for token in tokens]
        async with asyncio.timeout(20.0):
            while len(self.transport.peers) < 2:
                await asyncio.sleep(0.01)
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.to_thread(self.session.close)
        await self.transport.close()


def test_an_answer_is_for_who_asked_alone() -> None:
    async def main() -> None:
        async with Asking() as asking:
            assert await asking.ask("victim", "victim", 1, "0") == (True, b"for victim")
            assert await asking.ask("mallory", "victim", 1, "0") == (False, b"who asks is not known here")
            # Who asks ahead in another's name spoils nothing.
            assert (await asking.ask("mallory", "victim", 2, "0"))[0] is False
            assert await asking.ask("victim", "victim", 2, "0") == (True, b"for victim")

    asyncio.run(main())


@pytest.mark.parametrize("size", ["0", "100000"])
def test_a_question_that_comes_twice_is_carried_out_once(size: str) -> None:
    async def main() -> None:
        async with Asking() as asking:
            good, answer = await asking.ask("victim", "victim", 1, size)
            assert (good, len(answer)) == (True, len(b"for victim") + int(size))
            good, answer = await asking.ask("victim", "victim", 1, size)
            assert (good, answer.startswith(b"for victim")) == ((True, True) if size == "0" else (False, False))
            assert asking.carried_out == ["victim"]

    asyncio.run(main())


def test_answers_that_are_given_are_forgotten_though_older_questions_wait_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts_zenoh.transport._ASKED", 10)

    async def main() -> None:
        async with Asking() as asking:
            free = asyncio.Event()

            async def slow(body: bytes, caller: Caller) -> bytes:
                if body == b"1":
                    await free.wait()
                return await asking.answer(body, caller)

            asking.transport.answer("secret", slow)
            waiting = [asyncio.ensure_future(asking.ask("victim", "victim", number, "1")) for number in range(1, 6)]
            while len(asking.transport._answers) < 5:
                await asyncio.sleep(0.01)
            for number in range(6, 56):
                assert await asking.ask("victim", "victim", number, "0") == (True, b"for victim")
                assert len(asking.transport._answers) <= 20
            free.set()
            assert {good for good, _ in await asyncio.gather(*waiting)} == {True}

    asyncio.run(main())
