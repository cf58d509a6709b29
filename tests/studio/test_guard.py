"""Which requests are answered, by their headers."""

from __future__ import annotations

import tracemalloc

import pytest

from aiorts.control import Right
from aiorts_studio.api import Api
from aiorts_studio.guard import EXCHANGE, Message, hosts_of, refusal

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
