"""How much a client may ask, and have under way. The clock is a number."""

from __future__ import annotations

from contextlib import ExitStack, suppress

import pytest

from aiorts_studio.plain.limits import (
    AT_ONCE,
    BODIES,
    BODIES_OF_CLIENT,
    OF_CLIENT,
    OF_KERNEL,
    OPEN,
    RATE,
    Bucket,
    Open,
    UnderWay,
)
from aiorts_studio.plain.problems import HttpError


def test_a_client_may_ask_much_at_once_and_its_rate_afterwards() -> None:
    bucket, granted = Bucket(), 0
    for step in range(20_000):  # a thousand a second, for 20 s
        with suppress(HttpError):
            bucket.fill(step / 1_000)
            granted += 1
    assert granted == pytest.approx(AT_ONCE + 20.0 * RATE, abs=2)


def test_a_client_and_all_clients_of_a_kernel_have_so_many_calls_under_way() -> None:
    under_way = UnderWay()
    held = []
    for client in range(OF_KERNEL // OF_CLIENT):
        for _ in range(OF_CLIENT):
            held.append(under_way.one(client, "robot"))
            held[-1].__enter__()
        with pytest.raises(HttpError, match="this client"):
            under_way.one(client, "other").__enter__()
    with pytest.raises(HttpError, match="the clients of robot"):
        under_way.one(99, "robot").__enter__()
    with under_way.one(99, "other"):
        held.pop().__exit__(None, None, None)
        with under_way.one(99, "robot"):
            pass
    for one in held:
        one.__exit__(None, None, None)


def test_a_client_has_so_many_requests_open_and_others_have_theirs() -> None:
    requests = Open()
    with ExitStack() as held:
        for _ in range(OPEN - 1):
            held.enter_context(requests.one(1))
        with requests.one(1), pytest.raises(HttpError, match=f"this client: {OPEN} requests"):
            requests.one(1).__enter__()
        with requests.one(1), requests.one(2):
            pass
    with requests.one(1):
        pass


def test_so_many_bytes_of_the_bodies_of_a_client_and_of_all_are_taken() -> None:
    requests = Open()
    with ExitStack() as held:
        for client in range(BODIES // BODIES_OF_CLIENT):
            held.enter_context(requests.one(client))(BODIES_OF_CLIENT - 1)
            take = held.enter_context(requests.one(client))
            with pytest.raises(HttpError, match="this client: the open requests are longer than 2 MiB"):
                take(2)
            take(1)  # what was refused does not count
        take = held.enter_context(requests.one(99))
        take(0)
        with pytest.raises(HttpError, match="all clients: the open requests are longer than 8 MiB"):
            take(1)
    with requests.one(1) as take:
        take(BODIES_OF_CLIENT)
