"""Describes a system as boxes and arrows: the components of each context, their ports, and the connectors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.ports import OutPort
from aiorts.late import dataclass
from aiorts.model.policy import Dataflow, Subscription, default_push
from aiorts.model.profile import ConnectorProfile
from aiorts.services import ServicePort
from aiorts.system.checks.adapting import adapted
from aiorts.system.checks.composed_drafts import compositions, leaf_paths
from aiorts.system.checks.draft import Draft, drafts_of
from aiorts.system.file.families import owners, with_parts
from aiorts.system.file.survey import Survey, survey
from aiorts.system.file.values import SystemFile
from aiorts.types import type_name


@dataclass(frozen=True, slots=True)
class Pin:
    """A port of a box; `type` is "" when it is unknown."""

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
    """The components whose first context this is; the group without a name has those in no context."""

    name: str
    title: str
    boxes: tuple[Box, ...]
    inner: tuple[Group, ...] = ()
    """The composites in the group, with their members."""

    @property
    def all_boxes(self) -> tuple[Box, ...]:
        """The boxes of the group and of the composites in it."""
        return (*self.boxes, *(box for group in self.inner for box in group.all_boxes))

    def flat(self, depth: int = 0) -> Iterator[tuple[Group, int]]:
        """The group and those inside it, each with its depth."""
        yield self, depth
        for group in self.inner:
            yield from group.flat(depth + 1)


@dataclass(frozen=True, slots=True)
class Arrow:
    """A connector, from ("component", "port") to ("component", "port")."""

    source: tuple[str, str]
    target: tuple[str, str]
    label: str = ""
    """The connector's options that are no defaults: subscription, push policy, full policy."""


@dataclass(frozen=True, slots=True)
class Picture:
    """All parts of a system's drawing."""

    groups: tuple[Group, ...]
    arrows: tuple[Arrow, ...]

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The boxes of all groups."""
        return tuple(box for group in self.groups for box in group.all_boxes)


def picture(system: SystemFile, catalogue: Catalogue | None = None) -> Picture:
    """The picture of a system; a part that cannot be loaded is drawn as far as the file describes it."""
    found = survey(system, catalogue)
    adapted(found)
    system = found.system
    drafts = drafts_of(found)
    found.system = leaf_paths(system, {**drafts, **compositions(system, drafts).drafts})
    arrows = tuple(_arrows(found))
    homes: dict[str, str] = {}
    several: dict[str, list[str]] = {}
    for context in with_parts(found.system).contexts.values():
        for member in context.members:
            homes.setdefault(member, context.name)
            several.setdefault(member, []).append(context.name)
    ends = {end for arrow in arrows for end in (arrow.source[0], arrow.target[0])}
    unknown = [name for name in system.composites if name in ends]  # its ports are not known: drawn as one box
    also = {name: several.get(name, [])[1:] for name in (*system.components, *unknown)}
    boxes = {name: _box(found, name, drafts.get(name), arrows, others) for name, others in also.items()}
    groups = [
        _group(system, entry.name, _title(found, entry.name), entry.members, boxes, homes, entry.name)
        for entry in system.contexts.values()
    ]
    of = owners(system.composites)
    alone = [name for name in (*system.components, *system.composites) if name not in of]
    inside = {member for entry in system.contexts.values() for member in entry.members}
    outside = _group(system, "", "in no context", [name for name in alone if name not in inside], boxes, homes, "")
    if outside.boxes or outside.inner:
        groups.append(outside)
    return Picture((*groups, *elsewhere(arrows)), arrows)


def end_of(path: str) -> tuple[str, str]:
    """The component of a port's path, with the name of its kernel if that is another one, and the port."""
    kernel, slash, rest = path.rpartition("/")
    component, _, port = rest.partition(".")
    return f"{kernel}{slash}{component}", port


def elsewhere(arrows: Iterable[Arrow]) -> Iterator[Group]:
    """A group of those components at the ends of arrows that are in other kernels, if there are any."""
    boxes: dict[str, dict[tuple[str, bool], Pin]] = {}
    for arrow in arrows:
        for (component, port), out in ((arrow.source, True), (arrow.target, False)):
            if "/" in component:
                boxes.setdefault(component, {})[port, out] = Pin(port, "", out)
    if boxes:
        found = (Box(name, "in another kernel", tuple(pins.values())) for name, pins in boxes.items())
        yield Group("", "in other kernels", tuple(found))


def _group(
    system: SystemFile,
    name: str,
    title: str,
    members: Iterable[str],
    boxes: Mapping[str, Box],
    homes: Mapping[str, str],
    context: str,
) -> Group:
    """The group of a context or composite, with the members whose first context this is."""
    members = tuple(members)
    own = [boxes[one] for one in members if one in boxes and homes.get(one, context) == context]
    inner = [
        _group(system, one, _composite_title(system, one), system.composites[one].members, boxes, homes, context)
        for one in members
        if one in system.composites
    ]
    return Group(name, title, tuple(own), tuple(group for group in inner if group.all_boxes))


def _composite_title(system: SystemFile, name: str) -> str:
    entry = system.composites[name]
    return composite_title(name, entry.order, entry.errors, entry.groups)


def composite_title(name: str, order: str, errors: str, groups: Iterable[Iterable[str]]) -> str:
    """The title of a composite, with its options that are no defaults."""
    words = [said for said, usual in ((order, "stated"), (errors, "stop")) if said != usual]
    if beside := " | ".join(", ".join(group) for group in groups):
        words.append(beside)
    return ", ".join([f"{name}: composite", *words])


def _box(found: Survey, name: str, made: Draft | None, arrows: tuple[Arrow, ...], also: list[str]) -> Box:
    entry = found.system.components.get(name)
    kind = "composite" if entry is None else _printable(entry.type.rpartition(":")[2])
    pins: dict[tuple[str, bool], Pin] = {}
    if made is not None:
        for port in made.ports.values():
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
    """A text of the file without control characters and line ends."""
    return "".join(c if c.isprintable() else "?" for c in text[:80])


def _arrows(found: Survey) -> list[Arrow]:
    arrows = []
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        said = "" if profile is None else label(profile[0])
        source, *targets = connection.ports
        arrows += [Arrow(end_of(source), end_of(target), said) for target in targets]
    return arrows


def label(profile: ConnectorProfile) -> str:
    """The options of a connector that are no defaults."""
    words: list[str] = []
    if profile.dataflow is not Dataflow.PUSH:
        words.append(profile.dataflow.value)
    if profile.subscription is not Subscription.FLUSH:
        words.append(profile.subscription.value)
        if profile.push is not default_push(profile.subscription):
            words.append(profile.push.value)
        if profile.push_rate is not None:
            words.append(f"{profile.push_rate:g} Hz")
    if not profile.length:
        words.append("length 0")
    elif profile.full.value != "overwrite":
        words.append(profile.full.value)
    return ", ".join(words)


def names_of(system: Picture) -> Mapping[str, str]:
    """A short name for each component, valid in every drawing language."""
    return {box.name: f"c{number}" for number, box in enumerate(system.boxes)}
