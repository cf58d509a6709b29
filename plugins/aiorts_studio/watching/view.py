"""A kernel as the scene has it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from aiorts.sessions import Entry


@dataclass(slots=True)
class View:
    """A kernel as the scene has it.

    Attributes:
        key: the name by which it is known again after a restart.
        address: the address of the process that runs, or ran last.
        profile: the parts of its profile, as `changes` tells them.
        lasting: its name that stays over restarts; "" is not known.
        changes: how often its profile has changed.
        settled: whether it was laid out after it was whole.
        answered: when it answered last, by the monotonic clock.
        about: what the page says of it: "name", "state", "why", and others.
    """

    key: str
    address: str
    about: dict[str, Any]
    profile: dict[str, Any] = field(default_factory=dict)
    lasting: str = ""
    changes: int = 0
    settled: bool = False
    answered: float = field(default_factory=time.monotonic)

    def say(self, state: str, why: str) -> bool:
        """Take whether it answers; False: that was known."""
        if (state, why) == (self.about["state"], self.about["why"]):
            return False
        since = 0.0 if state == "live" else round(time.monotonic() - self.answered, 1)
        self.about.update(state=state, why=why, since_s=since)
        return True

    @property
    def components(self) -> Mapping[str, Any]:
        """Its components by name, as reports."""
        return self.profile.get("components") or {}

    @property
    def connectors(self) -> Mapping[str, Any]:
        """Its connectors by name, as reports."""
        return self.profile.get("connectors") or {}

    @property
    def contexts(self) -> Mapping[str, Any]:
        """Its contexts by name, as reports."""
        return self.profile.get("contexts") or {}

    def processes_of(self, components: Iterable[str]) -> list[int]:
        """The processes of those of the components that have their own."""
        known = self.service("isolation")
        return list(dict.fromkeys(known[name]["pid"] for name in components if name in known))

    def service(self, name: str) -> Mapping[str, Any]:
        """What a service attached to the kernel says of itself."""
        found = (self.profile.get("services") or {}).get(name)
        return found if isinstance(found, dict) else {}


def about(entry: Entry) -> dict[str, Any]:
    """What the page says of a kernel before it has answered."""
    host, _, name = entry.address.partition("/")
    return {
        "name": name, "host": host, "pid": entry.pid, "state": "silent", "why": "has not answered yet", "since_s": 0.0,
        "simulated": False, "round_trip_ms": None,
    }  # fmt: skip
