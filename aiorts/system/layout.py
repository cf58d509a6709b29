"""A system as boxes and arrows: who is in which context, with which ports, and what joins them; it draws nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from aiorts.kernel.catalogue import Catalogue
from aiorts.kernel.ports import OutPort, ServicePort
from aiorts.model.policy import Dataflow, Subscription, default_push
from aiorts.model.profile import ConnectorProfile
from aiorts.system.draft import draft
from aiorts.system.survey import Survey, survey
from aiorts.system.values import SystemFile
from aiorts.types import type_name

__all__ = ("Arrow", "Box", "Group", "Picture", "Pin", "picture")


@dataclass(frozen=True, slots=True)
class Pin:
    """A port of a box; `type` is "" where it could not be found out."""

    name: str
    type: str
    out: bool


@dataclass(frozen=True, slots=True)
class Box:
    """A component."""

    name: str
    type: str
    pins: tuple[Pin, ...]


@dataclass(frozen=True, slots=True)
class Group:
    """The components whose first context this is; the one without a name holds those that are in none."""

    name: str
    title: str
    boxes: tuple[Box, ...]


@dataclass(frozen=True, slots=True)
class Arrow:
    """A connector, from "component", "port" to "component", "port"."""

    source: tuple[str, str]
    target: tuple[str, str]
    label: str = ""
    """What differs from the usual: subscription, push policy, full policy."""


@dataclass(frozen=True, slots=True)
class Picture:
    """All of a system that is drawn."""

    groups: tuple[Group, ...]
    arrows: tuple[Arrow, ...]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Of all groups."""
        return tuple(box for group in self.groups for box in group.boxes)


def picture(system: SystemFile, catalogue: Catalogue | None = None) -> Picture:
    """What there is to draw; a part that cannot be loaded is drawn as far as the file tells."""
    found = survey(system, catalogue)
    arrows = tuple(_arrows(found))
    homes: dict[str, str] = {}
    several: dict[str, list[str]] = {}
    for context in system.contexts.values():
        for member in context.members:
            homes.setdefault(member, context.name)
            several.setdefault(member, []).append(context.name)
    boxes = {name: _box(found, name, arrows, several.get(name, [])[1:]) for name in system.components}
    groups = [
        Group(entry.name, _title(found, entry.name), tuple(boxes[n] for n in entry.members if homes[n] == entry.name))
        for entry in system.contexts.values()
    ]
    if outside := tuple(box for name, box in boxes.items() if name not in homes):
        groups.append(Group("", "in no context", outside))
    return Picture(tuple(groups), arrows)


def _box(found: Survey, name: str, arrows: tuple[Arrow, ...], also: list[str]) -> Box:
    kind = _printable(found.system.components[name].type.rpartition(":")[2])
    pins: dict[tuple[str, bool], Pin] = {}
    if name in found.types and name not in found.bad_params:
        for port in draft(found.types[name], name, found.settings[name]).ports.values():
            out = isinstance(port, OutPort)
            unit = f" [{port.unit}]" if port.unit else ""
            if isinstance(port, ServicePort):
                out = any(arrow.source == (name, port.name) for arrow in arrows)
                kind_ = port.profile.type
            else:
                kind_ = f"{type_name(port.type)}{unit}"
            pins[port.name, out] = Pin(port.name, kind_, out)
    for arrow in arrows:
        for end, out in ((arrow.source, True), (arrow.target, False)):
            if end[0] == name:
                pins.setdefault((end[1], out), Pin(end[1], "", out))
    return Box(name, f"{kind} (also in {', '.join(also)})" if also else kind, tuple(pins.values()))


def _title(found: Survey, name: str) -> str:
    entry = found.system.contexts[name]
    rate = entry.options.get("rate")
    return f"{name}: {_printable(entry.kind)}" + (f", {rate:g} Hz" if isinstance(rate, int | float) else "")


def _printable(text: str) -> str:
    """What a file says, as it may stand in a line of any language."""
    return "".join(c if c.isprintable() else "?" for c in text[:80])


def _arrows(found: Survey) -> list[Arrow]:
    arrows = []
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        label = "" if profile is None else _label(profile[0])
        source, *targets = connection.ports
        here = source.partition(".")
        for target in targets:
            there = target.partition(".")
            arrows.append(Arrow((here[0], here[2]), (there[0], there[2]), label))
    return arrows


def _label(profile: ConnectorProfile) -> str:
    words: list[str] = []
    if profile.dataflow is not Dataflow.PUSH:
        words.append(profile.dataflow.value)
    if profile.subscription is not Subscription.FLUSH:
        words.append(profile.subscription.value)
        if profile.push is not default_push(profile.subscription):
            words.append(profile.push.value)
        if profile.push_rate is not None:
            words.append(f"{profile.push_rate:g} Hz")
    if profile.full.value != "overwrite":
        words.append(profile.full.value)
    return ", ".join(words)


def names_of(system: Picture) -> Mapping[str, str]:
    """A short name that is safe in any language of drawings, for each component."""
    return {box.name: f"c{number}" for number, box in enumerate(system.boxes)}
