"""The messages of Foxglove's WebSocket protocol, version 1, as far as a read-only server needs them."""

from __future__ import annotations

import json
import struct
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from aiorts.errors import WireError

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The subprotocol of today's app, and that of older ones; the messages are the same."""
INFO: Final = 0
WARNING: Final = 1
ERROR: Final = 2
REQUEST: Final = 1 << 20
"""Bytes of the longest request of a viewer."""
_SAMPLE: Final = struct.Struct("<BIQ")
_TIME: Final = struct.Struct("<BQ")
_IDS: Final = range(1 << 32)
_WRITING: Final = frozenset(
    {
        *("advertise", "unadvertise", "getParameters", "setParameters", "subscribeParameterUpdates"),
        *("unsubscribeParameterUpdates", "subscribeConnectionGraph", "unsubscribeConnectionGraph", "fetchAsset"),
    }
)
"""Operations that need a capability which this server does not have."""


@dataclass(frozen=True, slots=True)
class Subscribe:
    """A viewer's request to subscribe to channels."""

    wanted: tuple[tuple[int, int], ...]
    """The viewer's number of each subscription, and the channel."""


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """A viewer's request to end subscriptions."""

    subscriptions: tuple[int, ...]


def request_in(message: str | bytes) -> Subscribe | Unsubscribe:
    """The request in a viewer's message.

    Raises:
        WireError: the message is not of the protocol, or asks for a thing that is not offered; the text says which.
    """
    if isinstance(message, bytes):
        raise WireError("a binary message: this server only shows samples, nothing is published or called through it")
    try:
        request = json.loads(message)
    except (ValueError, RecursionError):
        raise WireError("a message that is no JSON") from None
    if not isinstance(request, dict) or not isinstance(op := request.get("op"), str):
        raise WireError('a message without "op"')
    if op == "subscribe":
        return Subscribe(tuple(_subscription(one) for one in _list(request, "subscriptions")))
    if op == "unsubscribe":
        return Unsubscribe(tuple(_id(one, "subscriptionIds") for one in _list(request, "subscriptionIds")))
    if op in _WRITING:
        raise WireError(f"{op}: this server only shows samples")
    raise WireError(f"{op[:40]!r}: no such operation")


def _list(request: Mapping[str, Any], name: str) -> list[Any]:
    found = request.get(name)
    if not isinstance(found, list):
        raise WireError(f"{request['op']}: {name}: expected a list")
    return found


def _subscription(one: Any) -> tuple[int, int]:
    if not isinstance(one, dict):
        raise WireError("subscribe: subscriptions: expected objects with id and channelId")
    return _id(one.get("id"), "id"), _id(one.get("channelId"), "channelId")


def _id(value: Any, name: str) -> int:
    if type(value) is not int or value not in _IDS:
        raise WireError(f"{name}: expected a whole number from 0 to {_IDS[-1]}")
    return value


def server_info(name: str, session: str) -> str:
    """The first message to a viewer; a new `session` makes it forget what it knew."""
    return _text("serverInfo", name=name, capabilities=["time"], sessionId=session)


def advertise(channels: Iterable[Mapping[str, Any]]) -> str:
    """The message that offers channels."""
    return _text("advertise", channels=list(channels))


def unadvertise(channels: Collection[int]) -> str:
    """The message that channels are gone."""
    return _text("unadvertise", channelIds=sorted(channels))


def status(key: str, level: int, message: str) -> str:
    """The message that shows a line in the place of the line with the same key."""
    return _text("status", level=level, message=message, id=key)


def remove_status(keys: Iterable[str]) -> str:
    """The message that removes the lines with these keys."""
    return _text("removeStatus", statusIds=list(keys))


def sample(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """The message with a sample of a channel."""
    return _SAMPLE.pack(1, subscription, time_ns) + payload


def time(time_ns: int) -> bytes:
    """The message with the time of the system that is shown."""
    return _TIME.pack(2, time_ns)


def _text(op: str, **fields: Any) -> str:
    return json.dumps({"op": op, **fields}, separators=(",", ":"))
