"""Bare Zenoh with the codec, the hand-over and the engine's settings of a link over Zenoh."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Mapping
from itertools import repeat
from typing import Any, Final

from aiorts.types import TimedDouble
from aiorts_bench.interprocess.zenoh import Peer
from aiorts_zenoh.engine import Inbox

BATCHED: Final = "batched"
"""The key of a stream like `MANY`, whose puts the engine may send together."""
FLOOD: Final = "flood"
"""The key that asks for a number of messages; they are counted in the engine's callback."""
HANDED: Final = "handed"
"""The key that asks for messages as `FLOOD` does; they are counted on the loop."""
MESSAGE: Final = bytes(24)


class Express(Peer):
    """A session that sends each put at once, and hands samples over to the loop as a kernel does.

    Args:
        settings: the engine's settings, by key.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        import zenoh  # type: ignore[import-not-found, unused-ignore]

        config: Any = zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.inbox = Inbox(asyncio.get_running_loop())
        super().__init__(zenoh.open(config), self.inbox.put)

    def publisher(self, key: str, *, express: bool = True) -> Any:
        return super().publisher(key, express=express and key != BATCHED)

    def on_sample(self, key: str, arrived: Callable[[Any], None]) -> None:
        handler = self._zenoh.handlers.Callback(arrived, indirect=False)
        self._subscribers.append(self._session.declare_subscriber(f"aiorts/bench/{key}", handler))

    def flood(self, key: str, sample: TimedDouble) -> None:
        """Put as many messages as the sample says, from a new thread."""

        def put() -> None:
            publisher = self.publisher(key)
            for _ in repeat(None, int(sample.data)):
                publisher.put(MESSAGE)
            publisher.undeclare()

        threading.Thread(target=put, name="flood", daemon=True).start()
