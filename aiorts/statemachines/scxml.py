"""Writes charts as SCXML (W3C, 2015) and reads them back, with all checks of a chart.

Plain SCXML: states, parallel, final, history, transitions, timers as delayed `send` with `cancel`. In a namespace of
our own, which SCXML allows: `call` (an action), `do`. A guard is the name of a method in `cond`, as the data model
declares. It reads what it writes, and charts of other programs where they mean the same; anything else is refused
by name: parts that charts do not support, and parts with another meaning here (`_check_events`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from typing import Any, Final
from xml.etree import ElementTree

from aiorts.errors import DeclarationError
from aiorts.statemachines.chart_structure import StateStructure, TransitionStructure, structure_of
from aiorts.statemachines.charting import Chart, means
from aiorts.statemachines.statechart import After, Always, End, Guard, History, In, On, Parallel, State, Way

W3C: Final = "http://www.w3.org/2005/07/scxml"
OURS: Final = "urn:aiorts:statechart"
_DATA_MODEL: Final = "aiorts"
_STATES: Final = ("state", "parallel", "final", "history")
_PREFIXES: Final = (("", W3C), ("a", OURS))


def write_scxml(chart: Chart) -> str:
    """The chart as an SCXML document."""
    root = structure_of(chart)
    attributes = {"version": "1.0", "datamodel": _DATA_MODEL}
    if chart.name:
        attributes["name"] = chart.name
    document = _element(None, "scxml", attributes)
    if chart.keep_history:
        document.set(f"{{{OURS}}}keep-history", "true")
    wrapped = any((root.entry, root.init, root.exit, root.do, root.transitions)) or any(
        state.kind in ("history", "deep") for state in root.states
    )
    if wrapped:
        # SCXML's root has neither transitions nor actions; a state of that name stands in for it.
        document.set("initial", root.name)
        _write_state(document, root)
    else:
        document.set("initial", root.initial[0])
        for state in root.states:
            _write_state(document, state)
    ElementTree.indent(document)
    names = {uri: prefix for prefix, uri in _PREFIXES}
    text = ElementTree.tostring(_prefixed(document, names), encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def read_scxml(text: str) -> Chart:
    """The chart of an SCXML document.

    Raises:
        DeclarationError: it is no SCXML, has parts that charts do not support, or is wrong as a chart.
    """
    if "<!DOCTYPE" in text:
        raise DeclarationError("SCXML: a document type is not read; take the line out")
    try:
        document = ElementTree.fromstring(text)  # noqa: S314 - no document type, hence no entities
    except ElementTree.ParseError as error:
        raise DeclarationError(f"SCXML: {error}") from None
    if document.tag != f"{{{W3C}}}scxml":
        raise DeclarationError(f"SCXML: expected scxml of {W3C}, got {document.tag}")
    _check_events(document)
    reader = _Reader()
    root: dict[str, Any] = reader.state(document, "root")
    inner = root["parts"][0] if len(root["parts"]) == 1 else None
    if isinstance(inner, State) and inner.name == "root":
        root = dict[str, Any](parts=inner.parts) | {
            word: getattr(inner, word) for word in ("entry", "init", "exit", "do")
        }
    root.pop("initial", None)
    kept = document.get(f"{{{OURS}}}keep-history") == "true"
    return Chart(*root.pop("parts"), **root, keep_history=kept, name=document.get("name", ""))


# -- writing -----------------------------------------------------------------------------------------------------------


def _element(parent: Any, tag: str, attributes: dict[str, str] | None = None, space: str = W3C) -> Any:
    name = f"{{{space}}}{tag}"
    if parent is None:
        return ElementTree.Element(name, attributes or {})
    return ElementTree.SubElement(parent, name, attributes or {})


def _prefixed(document: Any, names: dict[str, str]) -> Any:
    """Write SCXML's own names without a prefix, since ElementTree would number the prefixes."""
    for element in document.iter():
        element.tag = _short(element.tag, names)
        for key in [key for key in element.keys() if key.startswith("{")]:  # noqa: SIM118 - an Element is no mapping
            element.set(_short(key, names), element.attrib.pop(key))
    for prefix, uri in _PREFIXES:
        document.set(f"xmlns:{prefix}" if prefix else "xmlns", uri)
    return document


def _short(tag: str, names: dict[str, str]) -> str:
    uri, _, name = tag.removeprefix("{").partition("}")
    return f"{names[uri]}:{name}" if names[uri] else name


def _write_state(parent: Any, state: StateStructure) -> None:
    if state.kind in ("history", "deep"):
        kind = "deep" if state.kind == "deep" else "shallow"
        history = _element(parent, "history", {"id": state.name, "type": kind})
        _element(history, "transition", {"target": " ".join(state.initial)})
        return
    element = _element(parent, state.kind, {"id": state.name})
    if state.defer:
        element.set(f"{{{OURS}}}defer", " ".join(state.defer))
    if state.init:
        _calls(_element(_element(element, "initial"), "transition", {"target": state.initial[0]}), state.init)
    elif state.initial:
        element.set("initial", state.initial[0])
    timers = [way for way in state.transitions if way.delay is not None]
    if timers or state.entry:
        moment = _element(element, "onentry")
        for way in timers:
            delay = {"delayexpr": way.delay} if isinstance(way.delay, str) else {"delay": _seconds(way.delay)}
            _element(moment, "send", {"event": way.event, "id": way.event, **delay})
        _calls(moment, state.entry)
    if timers or state.exit:
        moment = _element(element, "onexit")
        _calls(moment, state.exit)
        for way in timers:
            _element(moment, "cancel", {"sendid": way.event})
    if state.do:
        _calls(_element(element, "do", space=OURS), state.do)
    for way in state.transitions:
        _write_transition(element, way)
    for child in state.states:
        _write_state(element, child)


def _write_transition(parent: Any, way: TransitionStructure) -> None:
    given = {"event": way.event, "cond": way.guard, "target": way.target, "type": "internal" if way.local else None}
    _calls(_element(parent, "transition", {key: value for key, value in given.items() if value}), way.actions)


def _calls(parent: Any, names: tuple[str, ...]) -> None:
    for name in names:
        _element(parent, "call", {"name": name}, OURS)


def _seconds(value: float | None) -> str:
    """A time without an exponent, as SCXML demands."""
    return f"{Decimal(repr(value)):f}s"


# -- what would mean something else ------------------------------------------------------------------------------------


def _check_events(document: Any) -> None:
    """Refuse events that an interpreter of SCXML would bring to other transitions than a chart does."""
    around = {child: parent for parent in document.iter() for child in parent}
    names = {state: state.get("id", "?") for state in document.iter() if _tag(state) in _STATES}
    timers = {(state, _of(send)): send for state in names for send in state.findall(f"{{{W3C}}}onentry/{{{W3C}}}send")}
    ends = [state for state in names if _tag(state) == "final" and around[state] is not document]
    for way in document.iter(f"{{{W3C}}}transition"):
        source = around[way]
        where = f"SCXML: {names.get(source, _tag(source))}"
        for event in _events(way):
            if event == "*" and document.get("datamodel") != _DATA_MODEL and (timers or ends):
                raise DeclarationError(
                    f"{where}: event '*' takes timers and done.state, too, and is only any event from outside here; "
                    "name the events"
                )
            if means("error", event) or means("done.invoke", event):
                raise DeclarationError(f"{where}: event {event!r}: there is none of the kind here; take it out")
            for state, sent in timers:
                if means(event, sent) and not (state is source and sent == event):
                    raise DeclarationError(
                        f"{where}: event {event!r} is also a timer of {names[state]}, which only {names[state]} can "
                        "hear here, by its whole name; give one of them another name"
                    )
    for state in names:
        for act in state.findall(f"{{{W3C}}}onexit/{{{W3C}}}cancel"):
            if (state, act.get("sendid")) not in timers:
                raise DeclarationError(
                    f"SCXML: {names[state]}: cancel {act.get('sendid')!r}: is no timer of this state"
                )
    for state, sent in timers:
        _check_timer(document, around, state, sent, f"SCXML: {names[state]}: timer {sent!r}")


def _check_timer(document: Any, around: Any, state: Any, sent: str, where: str) -> None:
    own = [way for way in state.findall(f"{{{W3C}}}transition") if sent in _events(way)]
    if any(way.get("target") is None or way.get("type") == "internal" for way in own[:-1]):
        raise DeclarationError(f"{where}: one transition that stays in the state hides another, and would not here")
    cancelled = [act.get("sendid") for act in state.findall(f"{{{W3C}}}onexit/{{{W3C}}}cancel")]
    if sent in cancelled:
        return
    above, outer = [], around[state]
    while outer is not document:
        above.append(outer)
        outer = around[outer]
    inside = [way for way in state.iter(f"{{{W3C}}}transition") if way not in own]
    outside = [way for part in above for way in part.findall(f"{{{W3C}}}transition")]
    if inside or outside or any(_tag(part) == "parallel" for part in above):
        raise DeclarationError(
            f"{where}: goes on when the state is left, and ends with it here; write <cancel sendid={sent!r}/> in onexit"
        )


def _events(way: Any) -> list[str]:
    """The events of a transition; "door.*" and "door." are "door"."""
    return [re.sub(r"(?<=.)\.\*?$", "", event) for event in way.get("event", "").split()]


def _of(send: Any) -> str:
    return str(send.get("event", send.get("id", "")))


# -- reading -----------------------------------------------------------------------------------------------------------


class _Reader:
    """Reads states from inside a document."""

    def state(self, element: Any, name: str) -> dict[str, Any]:
        """The arguments for a state, without its name and whether it is initial."""
        words: dict[str, Any] = {"entry": [], "exit": [], "init": [], "do": []}
        timers: dict[str, float | str] = {}
        inside = [child for child in element if _tag(child) in _STATES]
        initial = element.get("initial")
        ways: list[Any] = []
        for child in element:
            tag = _tag(child)
            if tag in ("onentry", "onexit"):
                for act in child:
                    if _tag(act) == "send" and tag == "onentry":
                        timers[act.get("id", act.get("event", ""))] = self._delay(name, act)
                    elif _tag(act) != "cancel" or tag == "onentry":
                        words[tag.removeprefix("on")].append(self._call(name, act))
            elif tag == "a:do":
                words["do"] += [self._call(name, act) for act in child]
            elif tag == "initial":
                if len(child) != 1:
                    raise DeclarationError(f"SCXML: {name}: initial: expected one transition, got {len(child)}")
                initial = child[0].get("target")
                words["init"] += [self._call(name, act) for act in child[0]]
            elif tag == "transition":
                ways.append(child)
            elif tag not in _STATES:
                raise DeclarationError(f"SCXML: {name}: {tag} is not supported")
        parts: list[Any] = [way for child in ways for way in self._ways(name, child, timers)]
        if initial is None and _tag(element) != "parallel":
            initial = next((child.get("id") for child in inside if _tag(child) != "history"), None)
        elif initial is not None and initial not in [child.get("id") for child in inside if _tag(child) != "history"]:
            raise DeclarationError(
                f"SCXML: {name}: initial={initial!r} is no state directly inside it, which is not supported; "
                "give each state on the way its own"
            )
        whole = [child.get("id") for child in inside if _tag(child) != "history"]
        defaults = whole if _tag(element) == "parallel" else [initial]
        parts += [self._inside(child, initial, defaults) for child in inside]
        return {"parts": tuple(parts)} | {word: tuple(acts) or None for word, acts in words.items()}

    def _inside(self, child: Any, initial: str | None, defaults: list[Any]) -> State | History:
        name = child.get("id")
        if name is None:
            raise DeclarationError(f"SCXML: a {_tag(child)} has no id")
        if _tag(child) == "history":
            if len(child) > 1 or any(len(way) for way in child):
                raise DeclarationError(f"SCXML: history {name}: only one transition without actions is supported")
            targets = child[0].get("target", "").split() if len(child) else []
            if targets == defaults or not targets:
                return History(name, None, child.get("type") == "deep")
            return History(name, _one(name, targets), child.get("type") == "deep")
        words = self.state(child, name)
        parts = words.pop("parts")
        is_initial = name == initial
        if _tag(child) == "final":
            if parts:
                raise DeclarationError(f"SCXML: final {name} has something inside")
            return End(name, initial=is_initial, entry=words["entry"], exit=words["exit"])
        kind = Parallel if _tag(child) == "parallel" else State
        defer = child.get(f"{{{OURS}}}defer", "").split()
        return kind(name, *parts, initial=is_initial, defer=defer, **words)

    def _ways(self, name: str, element: Any, timers: dict[str, float | str]) -> Iterator[Way]:
        """One transition, or one for each event it names."""
        to = None if element.get("target") is None else _one(name, element.get("target").split())
        guard = _guards(name, element.get("cond"))
        acts = tuple(self._call(name, act) for act in element)
        action = acts[0] if len(acts) == 1 else acts or None
        local = element.get("type") == "internal" and to is not None
        events = _events(element)
        if not events:
            yield Always(to, guard, action, local)
        for number, event in enumerate(events):
            if event in timers:
                yield After(timers[event], to, guard, action, local)
            elif not any(means(other, event) for other in events[:number]):
                yield On(event, to, guard, action, local)

    @staticmethod
    def _call(name: str, act: Any) -> str:
        if _tag(act) != "a:call" or not act.get("name"):
            raise DeclarationError(f"SCXML: {name}: {_tag(act)} is not supported; write <call name=...> of {OURS}")
        return str(act.get("name"))

    @staticmethod
    def _delay(name: str, act: Any) -> float | str:
        plain = set(act.keys()) <= {"event", "id", "delay", "delayexpr"} and not len(act)
        plain = plain and act.get("event") == act.get("id", act.get("event"))
        if plain and (parameter := act.get("delayexpr", "")).isidentifier():
            return str(parameter)
        found = re.fullmatch(r"(\d*\.?\d+)(ms|s)", act.get("delay", ""))
        if found is None or not plain:
            raise DeclarationError(f"SCXML: {name}: send is supported as a timer: event, id=event, delay='5s'")
        return float(Decimal(found[1]) / (1000 if found[2] == "ms" else 1))


def _guards(name: str, condition: str | None) -> Guard | tuple[Guard, ...] | None:
    """The guards of a condition: names of methods and In('state'), joined by &&, with ! before In."""
    if condition is None:
        return None
    guards: list[Guard] = []
    for part in condition.split("&&"):
        text = part.strip()
        if found := re.fullmatch(r"(!?)\s*In\(\s*(['\"])([\w-]+)\2\s*\)", text):
            guards.append(In(found[3], not found[1]))
        elif text.isidentifier():
            guards.append(text)
        else:
            raise DeclarationError(
                f"SCXML: {name}: cond={condition!r}: expected names of methods and In('state'), joined by &&"
            )
    return guards[0] if len(guards) == 1 else tuple(guards)


def _tag(element: Any) -> str:
    uri, _, name = str(element.tag).removeprefix("{").partition("}")
    return name if uri == W3C else f"a:{name}" if uri == OURS else str(element.tag)


def _one(name: str, targets: list[str]) -> str:
    if len(targets) != 1:
        raise DeclarationError(f"SCXML: {name}: {len(targets)} targets in one transition are not supported")
    return targets[0]
