"""Components of a system as elements of a profile: new ones, and old ones in which only differences are changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Final

from aiorts import Supervision
from aiorts.system import ComponentEntry, CompositeEntry, ContextEntry, said_keys
from aiorts_openrtm.mapping.context_kinds import kind_of
from aiorts_openrtm.mapping.extras import MARK, extra_text
from aiorts_openrtm.mapping.types import word_of
from aiorts_openrtm.mapping.values import is_said, text_of
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import RTS_EXT, before, made, made_component

_DEFAULT: Final = "default"
_TYPES: Final = "__type__"
_WORDS: Final[Mapping[type, str]] = {bool: "bool", int: "int", float: "double"}
_KINDS: Final = {"periodic": "PERIODIC", "realtime": "PERIODIC", "thread": "PERIODIC", "event": "EVENT_DRIVEN"}
_VENDOR: Final = "RTC:aiorts:aiorts"
_COMPOSITE: Final = "PeriodicECSharedComposite"
Entry = ComponentEntry | CompositeEntry


def new_component(entry: Entry, data: Mapping[str, str], services: Sequence[str]) -> Element:
    """The element of a new component, without its contexts."""
    word = word_of(entry.type) if isinstance(entry, ComponentEntry) else _COMPOSITE
    parts = (
        *(made("DataPorts", name=name, ext_visible="true") for name in data),
        *(made("ServicePorts", name=name) for name in services),
        made("ConfigurationSets", id=_DEFAULT),
    )
    composite = "None" if isinstance(entry, ComponentEntry) else "PeriodicECShared"
    element = made_component(entry.name, f"{_VENDOR}:{word}:1.0.0", parts, composite=composite)
    if isinstance(entry, CompositeEntry):
        return change_component(element, CompositeEntry(entry.name, ()), entry)
    changed = change_component(element, ComponentEntry(entry.name, word), entry)
    return _with_types(changed, {_DEFAULT: entry.params, **entry.sets}, is_new=True)


def change_component(element: Element, old: Entry, new: Entry) -> Element:
    """A component in which all that differs between the two is changed, except rules of starting."""
    if isinstance(new, CompositeEntry):
        return _composite(element, new)
    assert isinstance(old, ComponentEntry)  # noqa: S101 - callers have compared the kinds
    if new.type != old.type:
        parts = element.get(element.space, "id").removeprefix("RTC:").split(":")
        if len(parts) >= 4:
            parts[2] = word_of(new.type)
            element = element.with_attribute("rts:id", element.space, ":".join(["RTC", *parts]))
        element = with_property(element, f"{MARK}type", None if new.type == word_of(new.type) else new.type)
    if new.options != old.options:
        element = with_property(element, f"{MARK}options", list(new.options) or None)
    if new.supervision != old.supervision:
        said = None if new.supervision is None else _chosen(new.supervision)
        element = with_property(element, f"{MARK}supervision", said)
    if new.active != old.active:
        element = element.with_attribute("rts:activeConfigurationSet", element.space, new.active or _DEFAULT)
    before_, now = {_DEFAULT: old.params, **old.sets}, {_DEFAULT: new.params, **new.sets}
    for name in {**before_, **now}:
        if before_.get(name) != now.get(name):
            element = _with_set(element, name, before_.get(name, {}), now.get(name))
    return _with_types(element, now) if before_ != now else element


def _with_types(element: Element, sets: Mapping[str, Mapping[str, Any]], *, is_new: bool = False) -> Element:
    """A component with the types by which texts become values again, and an extra for values without such a type.

    An old component without types stays without: its texts stand for the values that they mean.
    """
    there = next((one for one in _sets(element) if one.get(one.space, "id") == _TYPES), None)
    old = {} if there is None else {one.get(one.space, "name"): one.get(one.space, "data") for one in there.elements()}
    kinds = dict(old)
    for values in sets.values():
        for key, value in values.items():
            if (is_new or old) and key not in kinds and type(value) in _WORDS:
                kinds[key] = _WORDS[type(value)]
    if kinds != old:
        element = _with_set(element, _TYPES, old, kinds)
    others = {
        name: found
        for name, values in sets.items()
        if (
            found := {
                key: value
                for key, value in values.items()
                if not (is_said(value, kinds.get(key, "")) or (type(value) in _WORDS and not kinds))
            }
        )
    }
    return with_property(element, f"{MARK}values", others or None)


def _with_set(element: Element, name: str, old: Mapping[str, Any], new: Mapping[str, Any] | None) -> Element:
    """A component with the values of one set changed; None removes the set."""
    there = next((one for one in _sets(element) if one.get(one.space, "id") == name), None)
    if new is None:
        return element.edited(lambda child: None if child is there else child)
    changed = made("ConfigurationSets", id=name) if there is None else there

    def change(child: Element) -> Element | None:
        key = child.get(child.space, "name")
        if child.local != "ConfigurationData" or (key in new and old.get(key) == new[key]):
            return child
        if key in new:
            return child.with_attribute("rts:data", child.space, text_of(new[key]))
        return None if key in old else child

    known = {one.get(one.space, "name") for one in changed.elements()}
    data = [made("ConfigurationData", name=key, data=text_of(new[key])) for key in new if key not in known]
    changed = changed.edited(change).edited(added=[(("ConfigurationData",), one) for one in data])
    if there is None:
        return element.edited(added=[(before("ConfigurationSets"), changed)])
    return element.edited(lambda child: changed if child is there else child)


def _sets(element: Element) -> list[Element]:
    return [one for one in element.elements() if one.local == "ConfigurationSets"]


def _composite(element: Element, new: CompositeEntry) -> Element:
    """A composite with these members and options."""
    members = [made("Participants", made("Participant", componentId="", instanceName=one)) for one in new.members]
    element = element.edited(lambda child: None if child.local == "Participants" else child)
    element = element.edited(added=[(before("Participants"), one) for one in members])
    exported = ",".join(new.exported) if {*new.exported.values()} <= {"{port}"} else ""
    element = _with_set(element, _DEFAULT, {}, {"members": ",".join(new.members), "exported_ports": exported})
    others = {key: value for key, value in said_keys(new).items() if key != "exported" or not exported}
    return with_property(element, f"{MARK}options", others or None)


def change_contexts(element: Element, contexts: Sequence[ContextEntry]) -> Element:
    """A component with these contexts in the place of those it had; members are named as in the profile."""
    own = element.get(element.space, "instanceName")
    old = [one for one in element.elements() if one.local == "ExecutionContexts"]
    element = element.edited(lambda child: None if child in old else child)
    added = []
    for number, one in enumerate(contexts):
        options = dict(one.options)
        rate = options.pop("rate", 0.0)
        if options.get("max_rate") == rate:
            del options["max_rate"]
        before_ = old[number] if number < len(old) else made("ExecutionContexts", id=str(number))
        new = before_
        if kind_of(before_.get(before_.space, "kind")) != one.kind:
            new = new.with_attribute("rts:kind", before_.space, _KINDS.get(one.kind, "OTHER"))
        new = new.with_attribute("rts:rate", before_.space, str(float(rate)))
        new = new.edited(lambda child: None if child.local == "Participants" else child)
        usual = f"{own}_ec{new.get(new.space, 'id') or 0}"
        for key, value in (
            ("name", None if one.name == usual else one.name),
            ("kind", None if kind_of(new.get(new.space, "kind")) == one.kind else one.kind),
            ("options", options or None),
            ("members", None if one.members == (own,) else list(one.members)),
            ("activate", None if one.activate else False),
        ):
            new = with_property(new, f"{MARK}{key}", value)
        added.append((before("ExecutionContexts"), new))
    return element.edited(added=added)


def with_property(element: Element, name: str, value: Any) -> Element:
    """An element with another value of an extra; None removes the extra."""
    there = [one for one in element.elements() if one.local == "Properties" and one.get(one.space, "name") == name]
    if value is None:
        return element.edited(lambda child: None if child in there else child) if there else element
    text = extra_text(value)
    if there:
        changed = there[0].with_attribute("rtsExt:value", RTS_EXT, text)
        return element.edited(lambda child: changed if child is there[0] else child)
    return element.edited(added=[(before("Properties"), made("Properties", ext=True, name=name, value=text))])


def _chosen(policy: Supervision) -> dict[str, Any]:
    """The fields of a policy that differ from their default."""
    usual = Supervision()
    names = [one.name for one in fields(policy)]
    return {name: getattr(policy, name) for name in names if getattr(policy, name) != getattr(usual, name)}
