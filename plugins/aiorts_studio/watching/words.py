"""Words for components, connectors, contexts and links, as pages show them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from aiorts.control import state_text

_PLACE: Final = re.compile(r"\(([^()\s]+\.py):(\d+)\)")


def state_of(states: Mapping[str, str], *, failed: bool) -> str:
    """The state of a component in one word, by its states in its contexts."""
    if failed:
        return "error"
    found = set(states.values())
    return "active" if "active" in found else next(iter(states.values()), "inactive")


def said_of(states: Mapping[str, str], overdue: Mapping[str, Any]) -> str:
    """Words next to the state of a component: a hook over its deadline, states that differ; "" is nothing."""
    return state_text(states, overdue) if overdue or len(set(states.values())) > 1 else ""


def error_of(text: str | None) -> dict[str, Any] | None:
    """The last error of a component, with the place that its text names."""
    if text is None:
        return None
    found = _PLACE.search(text)
    place = {"file": found[1], "line": int(found[2])} if found else {}
    return {"message": text, **place}


def policy_of(options: Mapping[str, Any]) -> str:
    """The options of a connector in a few words."""
    words = [options["subscription"]]
    if options["subscription"] != "new" and options["push"] not in ("all", None):
        words.append(f"push {options['push']}")
    if options["push_rate"]:
        words.append(f"{options['push_rate']:g} Hz")
    words += [f"{options['length']} long", options["full"]]
    return ", ".join(words)


def link_state(links: Iterable[str]) -> str:
    """The state of a link, by the reports of both of its ends: "up", "waiting" or "down"."""
    states = {one.partition(":")[0] for one in links}
    if states <= {"up"}:
        return "up"
    return "waiting" if any(one.startswith("connecting") for one in states) else "down"


def context_said(report: Mapping[str, Any] | None) -> str:
    """The kind of an execution context, and its rate in Hz."""
    if report is None:
        return ""
    kind = report["kind"]
    return f"{kind}, {report['rate']:g} Hz" if report["rate"] else str(kind)


def composite_said(report: Mapping[str, Any]) -> str:
    """The number of components that run with a composite, and its state."""
    return f"composite of {len(report['composite']['parts'])}, {state_text(report['states'], report['overdue'])}"


def class_of(type_text: str) -> str:
    """The name of a class without its module."""
    return type_text.rpartition(":")[2].rpartition(".")[2]


def event_said(event: Mapping[str, Any]) -> str:
    """An event in words: "gain: 3.0 → 2.5, set default"; its component, and a context without one, stand apart."""
    apart = {"component"} if event.get("component") else {"component", "context"}
    return ", ".join(_event_words({name: value for name, value in event.items() if name not in apart}))


def _event_words(fields: Mapping[str, Any]) -> Iterator[str]:
    """The words of each field that has something to say."""
    left = dict(fields)
    if "old" in left and "new" in left:
        old, new = left.pop("old"), left.pop("new")
        subject = next((name for name in ("parameter", "set", "context", "path") if left.get(name)), None)
        before = f"{left.pop(subject)}: " if subject else ""
        yield before + (_pairs_said(new, old if _are_pairs(old) else ()) if _are_pairs(new) else f"{old} → {new}")
    for name, value in left.items():
        if isinstance(value, Mapping):
            value = value.get("name")  # of a connector
        if value in (None, "", [], ()):
            continue
        if name.endswith("_ns") and isinstance(value, int | float):
            yield f"{name.removesuffix('_ns')} {value / 1e6:.3g} ms"
        elif _are_pairs(value):
            yield _pairs_said(value)
        else:
            yield f"{name} {value}"


def _are_pairs(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(one, list) and len(one) == 2 for one in value)


def _pairs_said(pairs: Iterable[Any], old: Iterable[Any] = ()) -> str:
    """Names and values, without those that are as they were."""
    before = list(old)
    return ", ".join(f"{name} = {value}" for name, value in pairs if [name, value] not in before)
