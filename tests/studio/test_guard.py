"""Which requests are answered, by their headers."""

from __future__ import annotations

import asyncio
import time
import tracemalloc
from collections import Counter
from collections.abc import Iterable

import pytest

from aiorts.control import Right
from aiorts_studio import guard
from aiorts_studio.api import Api
from aiorts_studio.entrance import invitations
from aiorts_studio.guard import EXCHANGE, LARGE_BODY, Message, hosts_of, refusal
from aiorts_studio.plain.limits import BODIES_OF_CLIENT, OPEN
from aiorts_studio.serving import HOST
from campaign import CAMPAIGN
from control_parts import WAIT
from studio_parts import Reply, Site, parsed, resident, serving, site

OURS = frozenset({"127.0.0.1:8080", "localhost:8080"})


@pytest.mark.parametrize("host", sorted(OURS))
def test_a_request_by_a_name_of_the_server_and_from_its_own_page_is_answered(host: str) -> None:
    assert refusal([host], [], OURS, "http", needs_origin=False) == ""
    for needs_origin in (False, True):
        assert refusal([host], [f"http://{host}"], OURS, "http", needs_origin=needs_origin) == ""


@pytest.mark.parametrize(
    "hosts",
    [
        *([], [""], ["127.0.0.1"], ["127.0.0.1:80800"], ["127.0.0.1:8081"], ["evil.example:8080"], ["LOCALHOST:8080"]),
        *(["127.0.0.1:8080", "127.0.0.1:8080"], ["localhost:8080.evil.example"], ["0.0.0.0:8080"], ["[::1]:8080"]),
    ],
)
def test_a_name_that_leads_here_is_refused(hosts: list[str]) -> None:
    assert "Host" in refusal(hosts, [], OURS, "http", needs_origin=False)


@pytest.mark.parametrize(
    "origins",
    [
        *(["http://evil.example"], ["null"], [""], ["http://127.0.0.1:8081"], ["http://127.0.0.1"], ["file://"]),
        *(["https://127.0.0.1:8080"], ["http://localhost:8080"], ["http://127.0.0.1:8080.evil.example"]),
        *(["http://127.0.0.1:8080/"], ["http://127.0.0.1:8080", "http://127.0.0.1:8080"]),
    ],
)
def test_every_other_page_is_refused(origins: list[str]) -> None:
    assert "Origin" in refusal(["127.0.0.1:8080"], origins, OURS, "http", needs_origin=False)


def test_an_origin_that_is_needed_may_not_be_absent() -> None:
    assert "Origin" in refusal(["127.0.0.1:8080"], [], OURS, "http", needs_origin=True)


@pytest.mark.parametrize(("scheme", "port"), [("http", 80), ("https", 443)])
def test_a_browser_leaves_out_the_usual_port(scheme: str, port: int) -> None:
    ours = hosts_of(scheme, ("127.0.0.1", "::1"), port)
    assert ours[0] == f"127.0.0.1:{port}"
    for host in ("127.0.0.1", "[::1]", f"[::1]:{port}"):
        assert refusal([host], [f"{scheme}://{host}"], ours, scheme, needs_origin=True) == ""
    assert hosts_of(scheme, ("127.0.0.1", "::1"), 8080) == ("127.0.0.1:8080", "[::1]:8080")


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("host", "path", "status"),
    [("evil:1", "/api/kernels/robot/plan", 403), ("here:1", "/api/kernels/robot/plan", 401), ("here:1", EXCHANGE, 413)],
)
async def test_nothing_is_kept_of_what_a_stranger_sends(host: str, path: str, status: int) -> None:
    """A hundred of them would else fill the memory."""
    said: list[Message] = []
    part = b"x" * 65_536

    async def receive() -> Message:
        held.append(tracemalloc.get_traced_memory()[0])
        return {"type": "http.request", "body": bytes(part), "more_body": True}

    async def send(message: Message) -> None:
        said.append(message)

    api = Api("http", ["here:1"], Right.VIEW, said.append)  # type: ignore[arg-type]
    headers = [(b"host", host.encode()), (b"origin", b"http://here:1")]
    scope = {"type": "http", "method": "POST", "path": path, "query_string": b"", "headers": headers}
    tracemalloc.start()
    try:
        held: list[int] = []
        await api.app(scope, receive, send)
    finally:
        tracemalloc.stop()
    assert said[0]["status"] == status
    assert len(held) > 5
    assert max(held) - held[0] < len(part)


# -- limits, before a body is read -------------------------------------------------------------------------------------


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def never_ending(client: Site, count: int, size: int) -> list[Streams]:
    """Requests whose last byte does not come, of which `size` bytes have been sent."""
    head = f"POST /api/kernels/robot/plan HTTP/1.1\r\nHost: {client.host}\r\nContent-Type: application/json\r\n"
    head += f"Authorization: Bearer {client.token}\r\nContent-Length: {size + 1}\r\n\r\n"
    found = [await asyncio.open_connection(HOST, client.port) for _ in range(count)]
    for _, writer in found:
        writer.write(head.encode() + b"[" * size)
    return found


async def answer_of(streams: Streams) -> Reply:
    """What is answered, while the request goes on."""
    async with asyncio.timeout(WAIT):
        head = await streams[0].readuntil(b"\r\n\r\n")
        return parsed(head + await streams[0].readexactly(int(parsed(head).headers["content-length"])))


async def answers(requests: Iterable[Streams], count: int) -> list[Reply]:
    """The first answers to some of these."""
    waiting, done = {asyncio.ensure_future(answer_of(one)) for one in requests}, set[asyncio.Future[Reply]]()
    try:
        while len(done) < count:
            some, waiting = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            done |= some
        return [one.result() for one in done]
    finally:
        for one in waiting:
            one.cancel()
        await asyncio.wait(waiting)


@pytest.mark.anyio
@pytest.mark.row(86)
async def test_more_requests_of_one_client_than_may_be_open_are_refused_before_they_have_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(guard, "BODY_SECONDS", 10 * WAIT)
    async with site() as client:
        requests = await never_ending(client, OPEN + 2, 1)
        for reply in await answers(requests, 2):
            assert (reply.status, reply.value["code"], reply.headers["retry-after"]) == (429, "E-BUSY", "1")
            assert f"this client: {OPEN} requests are open already" in reply.value["detail"]
        assert (await client.ask("GET", "/api/kernels")).status == 429
        await another_is_answered(client)
        for _, writer in requests:
            writer.close()
        async with asyncio.timeout(WAIT):
            while (await client.ask("GET", "/api/kernels")).status == 429:
                await asyncio.sleep(0.01)


async def another_is_answered(client: Site) -> None:
    """A client with another token is answered within a second."""
    assert client.api is not None
    another = Site(client.port, client.api.codes.issue(time.monotonic()))
    await another.enter()
    began = time.monotonic()
    assert (await another.ask("GET", "/api/kernels")).status == 200
    assert time.monotonic() - began < (1.0 if CAMPAIGN else WAIT)


@pytest.mark.slow
@pytest.mark.row(86)
def test_a_client_with_a_hundred_large_requests_that_never_end_neither_fills_the_memory_nor_holds_up_another() -> None:
    async def look(pid: int) -> None:
        await client.enter()
        another = Site(client.port, invitations()[0].code)
        await another.enter()
        assert (await another.ask("GET", "/api/kernels")).status == 200
        before = resident(pid)
        requests = await never_ending(client, 100, LARGE_BODY - 1)
        refused = await answers(requests, 100 - BODIES_OF_CLIENT // LARGE_BODY)
        assert Counter(one.status for one in refused) == {429: len(refused)}
        began = time.monotonic()
        assert (await another.ask("GET", "/api/kernels")).status == 200
        assert time.monotonic() - began < (1.0 if CAMPAIGN else WAIT)
        grown = resident(pid) - before
        assert grown < 48 << 20, grown  # what a hundred connections have on its way is in it; all of it is 75 MiB
        for _, writer in requests:
            writer.transport.abort()

    with serving() as (process, client):
        asyncio.run(look(process.pid))
        assert process.poll() is None
