"""Requests of viewers: those of the protocol are read, all else is answered with what is wrong."""

from __future__ import annotations

import json
import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import WireError
from aiorts_foxglove import protocol


def test_subscriptions_are_read() -> None:
    asked = '{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}, {"id": 7, "channelId": 2}]}'
    assert protocol.request_in(asked) == protocol.Subscribe(((7, 1), (7, 2)))
    assert protocol.request_in('{"op": "unsubscribe", "subscriptionIds": [7]}') == protocol.Unsubscribe((7,))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b"\x01\x00\x00\x00\x00hello", "only shows samples"),
        ('{"op": "advertise", "channels": []}', "only shows samples"),
        ('{"op": "setParameters", "parameters": []}', "only shows samples"),
        ('{"op": "launch"}', "no such operation"),
        ('{"op": 1}', '"op"'),
        ("[]", '"op"'),
        ("{", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("9" * 10_000, "no JSON"),
        ('{"op": "subscribe"}', "subscriptions: expected a list"),
        ('{"op": "subscribe", "subscriptions": [1]}', "objects with id and channelId"),
        ('{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}', "id: expected a whole number"),
        ('{"op": "subscribe", "subscriptions": [{"id": 4294967296, "channelId": 1}]}', "expected a whole number"),
        ('{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}', "expected a whole number"),
        ('{"op": "unsubscribe", "subscriptionIds": [1.0]}', "expected a whole number"),
    ],
)
def test_what_is_wrong_is_said(message: str | bytes, said: str) -> None:
    with pytest.raises(WireError, match=said):
        protocol.request_in(message)


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@pytest.mark.slow(kept_by="test_what_is_wrong_is_said")
@given(op=st.sampled_from(["subscribe", "unsubscribe", "advertise"]) | st.text(), rest=PLAIN)
def test_nothing_but_the_documented_error_comes_of_any_message(op: str, rest: object) -> None:
    for message in ({"op": op, "subscriptions": rest, "subscriptionIds": rest}, rest):
        with suppress(WireError):
            protocol.request_in(json.dumps(message))


def test_binary_messages_lie_as_the_protocol_has_them() -> None:
    assert protocol.sample(3, 5, b"{}") == b"\x01" + struct.pack("<I", 3) + struct.pack("<Q", 5) + b"{}"
    assert protocol.time(9) == b"\x02" + struct.pack("<Q", 9)
