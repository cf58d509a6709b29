"""Reports of a running kernel as text: all that is worth knowing of one thing, with `long` the rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from aiorts.cli.commands.live.ledger import EXACT, UP_TO_LINK, ledger_text
from aiorts.cli.console.output import table
from aiorts.model.lifecycle import state_text
from aiorts.model.options import OWN_OPTIONS

_WIDEST: Final = 60
_WAYS: Final = {"in": "in", "out": "out", "service": "srv"}
_USUAL: Final = {key: one.default for key, one in OWN_OPTIONS.items() if not one.shown}
"""The default values of a connector's options that are not shown."""
_NO_WORD: Final = ("name", "ports", "extra")


def text_of(kind: str, name: str, full: str, report: Mapping[str, Any], *, long: bool = False) -> str:
    """The report of one thing, as the commands print it.

    Args:
        kind: "kernel", "component", "port", "context" or "connector".
        name: the name within the kernel.
        full: the name with the kernel's, for the head.
        report: the result of `Named.report`.
        long: with the documentation of parts, everything about connectors, and log lines.
    """
    if kind == "kernel":
        return "\n".join(_kernel(full, report, long=long))
    if kind == "component":
        return "\n".join(_component(name, full, report, long=long))
    if kind == "port":
        return "\n".join(_port(name, full, report))
    if kind == "context":
        return "\n".join(_context(full, report["contexts"][name], long=long))
    return "\n".join([full, *_connector(name, report, long=True)])


# -- kernels and contexts ----------------------------------------------------------------------------------------------


def _kernel(full: str, report: Mapping[str, Any], *, long: bool) -> Iterator[str]:
    clock, versions = report["clock"], report["versions"]
    yield f"{full}  {report['state']}"
    rows = [
        ("clock", f"{clock['kind']}, up for {clock['uptime_ns'] / 1e9:.1f} s"),
        ("versions", ", ".join(f"{name} {text}" for name, text in versions.items())),
        ("components", _counted(one["states"].values() for one in report["components"].values())),
        ("connectors", _ledgers(report["connectors"].values())),
        ("service connectors", str(len(report["service_connectors"]) or "")),
        ("services", ", ".join(report["services"])),
    ]
    yield table([row for row in rows if row[1]])
    for name, one in report["contexts"].items():
        yield from _inside(_context(f"context {name}", one, long=long))
    if tools := report["services"].get("tool", {}).get("connectors"):
        yield "  tools"
        yield table([_tool_row(one) for one in tools], indent="    ")
    failed = [(name, one["last_error"]) for name, one in report["components"].items() if one["last_error"]]
    if failed:
        yield "  errors"
        yield table(failed, indent="    ")


def _counted(states: Any) -> str:
    every = [tuple(one) for one in states]
    words: dict[str, int] = {}
    for one in every:
        word = ", ".join(dict.fromkeys(one)) or "in no context"
        words[word] = words.get(word, 0) + 1
    return f"{len(every)}: {', '.join(f'{count} {word}' for word, count in words.items())}" if every else "none"


def _ledgers(connectors: Any) -> str:
    ledgers = [one["ledger"] for one in connectors]
    dropped = sum(sum(one["dropped"].values()) for one in ledgers)
    return f"{len(ledgers)}: {sum(one['written'] for one in ledgers)} written, {dropped} dropped" if ledgers else ""


def _tool_row(one: Mapping[str, Any]) -> tuple[str, ...]:
    lost = sum(one["dropped"].values())
    return (
        one["client"],
        "reads" if one["reads"] else "writes",
        one["port"],
        f"{one['written']} samples, {lost} dropped",
    )


def _context(full: str, one: Mapping[str, Any], *, long: bool) -> Iterator[str]:
    rate = "" if one["rate"] is None else f", {one['rate']:g} Hz"
    yield f"{full}  {one['kind']}{rate}"
    counts = one["statistics"]
    late = f", late {counts['lateness_p50_ns'] / 1e6:.3f} ms (p99 {counts['lateness_p99_ns'] / 1e6:.3f})"
    rows = [
        ("members", ", ".join(one["members"]) or "none"),
        (
            "cycles",
            f"{counts['cycles']}, {counts['overruns']} overruns, {counts['skipped']} skipped"
            f"{late if one['rate'] is not None and counts['cycles'] else ''}",
        ),
    ]
    if long:
        rows += [(name, f"{hook['count']} runs, longest {hook['max_ns'] / 1e6:.3f} ms")
                 for name, hook in counts["hooks"].items()]  # fmt: skip
        rows += [("missed", f"{count} times: {who}") for who, count in counts["missed"].items()]
    yield table(rows)


# -- components and ports ----------------------------------------------------------------------------------------------


def _component(name: str, full: str, report: Mapping[str, Any], *, long: bool) -> Iterator[str]:
    one = report["components"][name]
    yield f"{full}  {one['type']}"
    if one["doc"]:
        yield f"  {one['doc']}"
    said = {context: f"{state} in {context}" for context, state in one["states"].items()}
    rows = [("state", state_text(said, one.get("overdue", {}))), ("error", one["last_error"] or "")]
    if (process := _part(report, "processes", "isolation").get(name)) is not None:
        busy = f", busy for {process['busy']:.1f} s" if process["busy"] else ""
        rows.append(("process", f"{process['pid']}{busy if process['runs'] else ', has ended'}"))
    if one["modes"] is not None:
        pending = f", {one['modes']['pending']} is requested" if one["modes"]["pending"] else ""
        rows.append(("mode", f"{one['modes']['mode']} of {', '.join(one['modes']['modes'])}{pending}"))
    if one["machine"] is not None:
        rows.append(("machine", f"{one['machine']['chart']}: {' > '.join(one['machine']['states']) or 'not entered'}"))
    if one["composite"] is not None:
        rows.append(("members", ", ".join(one["composite"]["members"])))
    yield table([row for row in rows if row[1]])
    if one["ports"]:
        yield "  ports"
        yield table([_port_row(port, long=long) for port in one["ports"].values()], indent="    ")
    sets = one["configuration"]
    if one["params"]:
        others = f" (set {sets['active']} of {', '.join(sets['sets'])})" if len(sets["sets"]) > 1 else ""
        yield f"  parameters{others}"
        yield table([_param_row(*item, long=long) for item in one["params"].items()], indent="    ")
    for each in (*report["connectors"], *report["service_connectors"]):
        yield from _inside(_connector(each, report, long=long))
    for each, context in report["contexts"].items():
        yield from _inside(_context(f"context {each}", context, long=long))
    if one["calls"]:
        yield "  calls"
        yield table([_call_row(*item) for item in one["calls"].items()], indent="    ")
    if long and one["log"]:
        yield "  log"
        yield table([(line["level"], line["hook"], line["text"]) for line in one["log"]], indent="    ")


def _port_row(port: Mapping[str, Any], *, long: bool) -> tuple[str, ...]:
    interfaces = ", ".join(f"{one['polarity']} {one['type']}" for one in port["interfaces"])
    count = len(port["connectors"])
    wired = f"{count} connector{'s' * (count != 1)}" if count else "not connected"
    row = (_WAYS[port["direction"]], port["name"], interfaces or port["type"], port["unit"] or "", wired)
    return (*row, port["doc"]) if long else row


def _param_row(name: str, one: Mapping[str, Any], *, long: bool) -> tuple[str, ...]:
    row = (name, shown(one["value"]), one["unit"])
    return (*row, one["type"], one["allowed"], f"default {shown(one['default'])}", one["doc"]) if long else row


def _call_row(name: str, one: Mapping[str, Any]) -> tuple[str, ...]:
    mean = f"mean {one['total_ns'] / one['calls'] / 1e6:.3f} ms" if one["calls"] else ""
    return (name, f"{one['calls']} calls, {one['failures']} failed, {one['timeouts']} late", mean)


def _port(path: str, full: str, report: Mapping[str, Any]) -> Iterator[str]:
    name, _, port = path.partition(".")
    one = report["components"][name]["ports"][port]
    yield f"{full}  {' '.join(_port_row(one, long=False)[i] for i in (0, 2))}"
    shape = "" if one["shape"] is None else f"({', '.join(map(str, one['shape']))})"
    if rows := [row for row in (("unit", one["unit"] or ""), ("shape", shape), ("", one["doc"])) if row[1]]:
        yield table(rows)
    for interface in one["interfaces"]:
        yield f"  {interface['polarity']} {interface['name']}: {interface['type']}"
        yield table(
            [(method["name"], method["doc"].partition("\n")[0]) for method in interface["methods"]], indent="    "
        )
    for each in one["connectors"]:
        yield from _inside(_connector(each, report, long=True))


# -- connectors --------------------------------------------------------------------------------------------------------


def _connector(name: str, report: Mapping[str, Any], *, long: bool) -> Iterator[str]:
    if name in report["service_connectors"]:
        yield f"{name}"
        for each in report["service_connectors"][name]["bindings"]:
            counts = each["statistics"]
            yield f"  {each['required']} -> {each['provided']}: {counts['calls']} calls, {counts['failures']} failed"
        if (state := _link_states(report).get(name)) is not None:
            yield f"  link {state}"
        return
    one = report["connectors"].get(name)
    if one is None:  # it ended during the request
        return
    options, counts = one["options"], one["ledger"]
    yield f"{one['source']} -> {one['target']}"
    yield f"  {ledger_text(counts)}{', the writer is silent' if counts['silent'] else ''}"
    if (state := _link_states(report).get(name)) is not None:
        yield f"  link {state}"
    if long:
        said = [
            f"{key} {shown(value)}"
            for key, value in options.items()
            if key not in _NO_WORD and value is not None and _USUAL.get(key) != value
        ]
        yield f"  {', '.join(said)}"
        end = UP_TO_LINK if counts["delivered"] is None else ""
        for word in ("latency", "age"):
            if (spans := counts[word]) is not None:
                off = counts.get("age_within_ns") if word == "age" else None
                texts = [f"{spans[key] / 1e6:.3f} ms{_off(off)}" for key in ("p50_ns", "p99_ns")]
                yield f"  {word} p50 {texts[0]}, p99 {texts[1]}{end}" if off is None or off <= EXACT else f"  {word} ?"


def _off(within_ns: int | None) -> str:
    return "" if within_ns is None else f" +- {within_ns / 1e6:.3f} ms"


def _link_states(report: Mapping[str, Any]) -> Mapping[str, str]:
    """The states of links by connector, in the report of a whole kernel or of a part."""
    return _part(report, "links", "links")


def _part(report: Mapping[str, Any], key: str, service: str) -> Mapping[str, Any]:
    """The report of a service: in the report of a part it stands under `key`, in that of a kernel under "services"."""
    found: Mapping[str, Any] = report[key] if key in report else report.get("services", {}).get(service, {})
    return found


def _inside(parts: Iterator[str]) -> Iterator[str]:
    """The lines, indented by two characters."""
    return (f"  {line}" for part in parts for line in part.split("\n"))


def shown(value: Any) -> str:
    """A value on one line; a long one is cut."""
    text = '""' if value == "" else str(value).lower() if isinstance(value, bool) else str(value)
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
