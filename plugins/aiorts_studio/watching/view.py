"""A kernel as the scene has it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from aiorts.sessions import Entry
from aiorts_studio.watching.words import class_of, error_of

NOT_YET: Final = "has not answered yet"
"""The reason why a kernel that has just been found is silent."""
_FILTER: Final = "FlexiFilter"
_LOOK_ON: Final = frozenset(("FlexiDump", "FlexiLogger"))


@dataclass(slots=True)
class View:
    """A kernel as the scene has it.

    Attributes:
        key: the name by which it is known again after a restart.
        address: the address of the process that runs, or ran last.
        profile: the parts of its profile, as `changes` tells them.
        lasting: its name that stays over restarts; "" is not known.
        links: the name by which links of other kernels reach it; "" where they cannot.
        settled: whether it was laid out after it was assembled.
        answered: when it answered last, by the monotonic clock.
        about: the facts that the page shows of it: "name", "state", "why", and others.
    """

    key: str
    address: str
    about: dict[str, Any]
    profile: dict[str, Any] = field(default_factory=dict)
    lasting: str = ""
    links: str = ""
    settled: bool = False
    answered: float = field(default_factory=time.monotonic)

    def say(self, state: str, why: str) -> bool:
        """Set a state and its reason; False: both were known."""
        if (state, why) == (self.about["state"], self.about["why"]):
            return False
        since = 0.0 if state == "live" else round(time.monotonic() - self.answered, 1)
        self.about.update(state=state, why=why, since_s=since)
        return True

    def is_called(self, name: str, host: str) -> bool:
        """Whether a connector's path that begins with this name leads to this kernel, from a kernel of this host."""
        own, _, address = self.address.rpartition("/")
        names = [self.address, *([address] if own == host else [])]
        return name in names or (bool(self.links) and name in (self.links, f"{own}/{self.links}"))

    @property
    def shape(self) -> tuple[int, tuple[str, ...]]:
        """The number of its connectors, and the contexts of its components, which a layout follows."""
        return len(self.connectors), tuple(map(self.context_of, self.components))

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

    def is_infrastructure(self, component: str) -> bool:
        """Whether a component only looks on, or was put in where two ports do not fit."""
        kind = class_of(self.components[component]["type"])
        return kind in _LOOK_ON or (kind == _FILTER and self._is_adapter(component))

    def _is_adapter(self, component: str) -> bool:
        """Whether a component is a filter that `adapt` put in, by its name and its one connector at each end."""
        before = [one["source"] for one in self.connectors.values() if one["target"].startswith(f"{component}.")]
        after = [one["target"] for one in self.connectors.values() if one["source"].startswith(f"{component}.")]
        if len(before) != 1 or len(after) != 1:
            return False
        writer, reader = before[0].partition(".")[0], after[0].replace(".", "_")
        return component.startswith(f"{writer}_to_{reader}")

    def ends_of(self, connector: str) -> list[str]:
        """The components at the ends of a connector; none for a connector that has gone."""
        report = self.connectors.get(connector)
        return [] if report is None else [report[end].rpartition(".")[0] for end in ("source", "target")]

    def context_of(self, component: str) -> str:
        """The context that runs a component, the first of several; "" is none."""
        return next(iter(self.components[component]["states"]), "")

    def members(self) -> dict[str, str]:
        """The outermost composite that stands for a component in its context, by component."""
        found: dict[str, str] = {}
        inner = self.inner_composites()
        for name, composite in self._composites().items():
            states = self.components[name]["states"]
            for part in composite["parts"] if name not in inner else ():
                if part in self.components and self.context_of(part) in (states or ("",)):
                    found[part] = name
        return found

    def inner_composites(self) -> set[str]:
        """The composites that are members of others."""
        known = self._composites()
        return {member for one in known.values() for member in one["members"] if member in known}

    def exported(self, composite: str) -> dict[str, str]:
        """The ports that a composite shows: their names by the paths of the members' ports."""
        names = self.components[composite]["composite"]["exported"]
        return {".".join(self.member_port(composite, name)): name for name in names}

    def member_port(self, component: str, port: str) -> tuple[str, str]:
        """The component and the port that a path leads to: a composite's port is its member's own."""
        composite = (self.components.get(component) or {}).get("composite")
        if composite is None or port not in composite["exported"]:
            return component, port
        name, _, port = composite["exported"][port].rpartition(".")
        return self.member_port(name, port)

    def failure_of(self, report: Mapping[str, Any]) -> dict[str, Any] | None:
        """The last error of a component, as pages have it: where and when, too, as far as its last lines say."""
        failed = report["last_error"]
        if failed is None:
            return None
        lines = [line for line in report["log"] if failed in line["text"]]
        if not lines:
            return error_of(failed)
        clock, line = self.profile["clock"], lines[-1]
        at_ns = int(line["monotonic_ns"]) + int(clock["time_ns"]) - int(clock["monotonic_ns"])
        return {**(error_of(line["text"]) or {}), "message": failed, "at_ns": at_ns}

    def _composites(self) -> dict[str, Mapping[str, Any]]:
        return {name: one["composite"] for name, one in self.components.items() if one["composite"] is not None}

    def service(self, name: str) -> Mapping[str, Any]:
        """The report of a service that is attached to the kernel."""
        found = (self.profile.get("services") or {}).get(name)
        return found if isinstance(found, dict) else {}


def about(entry: Entry) -> dict[str, Any]:
    """The facts of a kernel that has not answered yet, as pages have them."""
    host, _, name = entry.address.partition("/")
    return {
        "name": name, "host": host, "pid": entry.pid, "state": "silent", "why": NOT_YET, "since_s": 0.0,
        "simulated": False, "round_trip_ms": None,
    }  # fmt: skip
