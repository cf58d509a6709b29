"""Draws a running system from its profile: its present parts, and their rates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from aiorts.model.lifecycle import state_text
from aiorts.model.plain import plain
from aiorts.observe import ComponentReport, ConnectorReport, ContextReport, SystemProfile
from aiorts.system.draw.graph import drawn
from aiorts.system.draw.picture import Arrow, Box, Group, Picture, Pin, composite_title, elsewhere, end_of, label


def running_graph(profile: SystemProfile, language: str = "mermaid", earlier: SystemProfile | None = None) -> str:
    """Draw a system that runs, or ran: components with their states, connectors with rates and dropped samples.

    Args:
        profile: the profile of the system, maybe read back.
        language: "mermaid", "dot" or "svg".
        earlier: an earlier profile of the same system; with it the connectors have rates.

    Raises:
        ValueError: there is no such language.
    """
    return drawn(_picture(profile, earlier), language)


def _picture(profile: SystemProfile, earlier: SystemProfile | None) -> Picture:
    arrows = tuple(_arrows(profile, earlier))
    drawn_ends = {end for arrow in arrows for end in (arrow.source[0], arrow.target[0])}
    components = {name: one for name, one in profile.components.items() if one.composite is None or name in drawn_ends}
    composites = {name: one for name, one in profile.components.items() if one.composite is not None}
    boxes = {name: _box(name, one, arrows) for name, one in components.items()}
    left = dict(boxes)
    groups = [_group(name, _title(name, one), one.members, composites, left) for name, one in profile.contexts.items()]
    inside = {member for one in composites.values() if one.composite is not None for member in one.composite.members}
    alone = (name for name in profile.components if name not in inside)
    groups.append(_group("", "in no context", (*alone, *left), composites, left))
    return Picture((*(group for group in groups if group.all_boxes), *elsewhere(arrows)), arrows)


def _group(
    name: str,
    title: str,
    members: Iterable[str],
    composites: Mapping[str, ComponentReport],
    left: dict[str, Box],
) -> Group:
    """The group of the members that are not drawn yet; composites with their own members."""
    own, inner = [], []
    for member in members:
        if member in left:
            own.append(left.pop(member))
        if (one := composites.get(member)) is not None and one.composite is not None:
            said = composite_title(member, one.composite.order, one.composite.errors, one.composite.groups)
            inner.append(_group(member, said, one.composite.members, composites, left))
    return Group(name, title, tuple(own), tuple(group for group in inner if group.all_boxes))


def _title(name: str, one: ContextReport) -> str:
    overruns = one.statistics.overruns
    late = f", {overruns} overruns" if overruns else ""
    return f"{name}: {one.kind}" + (f", {one.rate:g} Hz" if one.rate is not None else "") + late


def _box(name: str, one: ComponentReport, arrows: tuple[Arrow, ...]) -> Box:
    states = state_text(one.states, plain(one.overdue))
    pins = []
    for port in one.ports.values():
        unit = f" [{port.unit}]" if port.unit else ""
        served = port.direction == "service" and any(arrow.source == (name, port.name) for arrow in arrows)
        pins.append(Pin(port.name, f"{port.type}{unit}", port.direction == "out" or served))
    known = {(pin.name, pin.out) for pin in pins}
    for arrow in arrows:
        for end, out in ((arrow.source, True), (arrow.target, False)):
            if end[0] == name and (end[1], out) not in known:
                known.add((end[1], out))
                pins.append(Pin(end[1], "", out))
    return Box(name, f"{one.type.rpartition(':')[2]} ({'failed' if one.last_error else states})", tuple(pins))


def _arrows(profile: SystemProfile, earlier: SystemProfile | None) -> Iterator[Arrow]:
    for name, one in profile.connectors.items():
        before = earlier.connectors.get(name) if earlier is not None else None
        words = (_rate(one, before), label(one.options), _dropped(one))
        yield Arrow(end_of(one.source), end_of(one.target), ", ".join(filter(None, words)))
    for each in profile.service_connectors.values():
        calls = sum(binding.statistics.calls for binding in each.bindings)
        source, *targets = each.ports
        for target in targets:
            yield Arrow(end_of(source), end_of(target), f"{calls} calls")


def _rate(one: ConnectorReport, before: ConnectorReport | None) -> str:
    if before is None or one.ledger.at_ns <= before.ledger.at_ns or one.ledger.written < before.ledger.written:
        return ""
    return f"{one.ledger.rate_since(before.ledger):.4g} Hz"


def _dropped(one: ConnectorReport) -> str:
    dropped = sum(one.ledger.dropped.values())
    silent = "silent" if one.ledger.silent else ""
    return ", ".join(filter(None, (f"{dropped} dropped" if dropped else "", silent)))
