"""Bare Zenoh with the codec of a link, and its hand-over to the event loop."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from aiorts.types import TimedDouble, TimedOctetSeq
from aiorts.wire import LINK, MsgpackCodec
from aiorts_bench.push.peers import zenoh_config

SMALL: Final = "small"
LARGE: Final = "large"
MANY: Final = "many"
ARRAYS: Final = "arrays"
_LENGTH: Final = struct.Struct("<I")


class Peer:
    """A session with publishers and subscribers of records, bound to the running loop.

    Args:
        session: a session of Zenoh; see `opened`.
        post: hands a call over to the loop: called in a thread of Zenoh with a function and its argument.
    """

    def __init__(self, session: Any, post: Callable[..., object]) -> None:
        import zenoh  # type: ignore[import-not-found, unused-ignore]

        self._zenoh: Any = zenoh
        self._session, self._post = session, post
        codec = MsgpackCodec(limits=LINK)
        classes: tuple[type, ...] = (TimedDouble, TimedOctetSeq)
        self._encode = {cls: codec.parts_encoder(cls) for cls in classes}
        self._decode = {cls: codec.parts_decoder(cls) for cls in classes}
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []

    def put(self, key: str, record: Any) -> None:
        """Publish a record; blocks while Zenoh accepts nothing."""
        head, parts = self._encode[type(record)](record)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self.publisher(key)
        publisher.put(b"".join((_LENGTH.pack(len(head)), head, *parts)))

    def publisher(self, key: str, *, express: bool = False) -> Any:
        """A publisher of bytes; with `express` it sends each put at once."""
        block = self._zenoh.CongestionControl.BLOCK
        return self._session.declare_publisher(f"aiorts/bench/{key}", congestion_control=block, express=express)

    def on(self, key: str, cls: type, handler: Callable[[Any], object]) -> None:
        """Call `handler` on the loop with each record of that key."""
        decode, post = self._decode[cls], self._post

        def take(payload: bytes) -> None:
            start = _LENGTH.size + _LENGTH.unpack_from(payload)[0]
            view = memoryview(payload)
            handler(decode(view[_LENGTH.size : start], (view[start:],) if start < len(payload) else ()))

        def arrived(sample: Any) -> None:
            post(take, sample.payload.to_bytes())

        self.on_sample(key, arrived)

    def on_sample(self, key: str, arrived: Callable[[Any], None]) -> None:
        """Call `arrived` in a thread of Zenoh with each sample of that key."""
        self._subscribers.append(self._session.declare_subscriber(f"aiorts/bench/{key}", arrived))

    def close(self) -> None:
        """End the session."""
        self._session.close()


def opened(role: str, endpoint: str) -> Any:
    """A session that listens or connects (`role`) at an endpoint; scouting is off."""
    import zenoh

    return zenoh.open(zenoh_config(zenoh, role, endpoint))
