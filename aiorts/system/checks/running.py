"""The findings about a running system, from its profile alone: failed or idle components, lost samples, lateness."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from aiorts.kernel.ports.losses import WHY_DROPPED
from aiorts.model.policy import Dataflow
from aiorts.observe import SystemProfile
from aiorts.system.checks.circles import BEGIN
from aiorts.system.checks.cycles import cycles
from aiorts.system.checks.findings import Finding


def check_running(profile: SystemProfile, name: str) -> tuple[Finding, ...]:
    """The findings about a system that runs, or ran: the worst first.

    Args:
        profile: the profile of the system, maybe read back.
        name: the name of the system in the findings.
    """
    order = ("error", "warning", "note")
    found = [
        Finding(severity, code, Path(name), 0, 0, 0, where, cause, remedy)
        for severity, code, where, cause, remedy in _said(profile)
    ]
    return tuple(sorted(found, key=lambda one: order.index(one.severity)))


def _said(profile: SystemProfile) -> Iterator[tuple[str, str, str, str, str]]:
    """Severity, code, where, cause and remedy of each finding."""
    parts = {part for one in profile.components.values() if one.composite is not None for part in one.composite.parts}
    for name, one in profile.components.items():
        where = f"components.{name}"
        if "error" in one.states.values():
            cause = f"{name} is in error: {one.last_error or 'it does not say why'}"
            yield "error", "E-COMPONENT", where, cause, f"mend the cause, then aiorts reset {name}"
        elif one.last_error:
            yield "warning", "E-COMPONENT", where, f"{name} has failed: {one.last_error}", "see aiorts vlog"
        if not one.states and name not in parts and one.composite is None:
            yield "warning", "W-UNUSED", where, f"{name} is in no context and never runs", "start it in a context"
        free = [port.name for port in one.ports.values() if not port.connectors]
        if free and one.composite is None:
            word = "ports have" if len(free) > 1 else "port has"
            more = f" and {len(free) - 6} more" if len(free) > 6 else ""
            yield "note", "N-OPEN", where, f"{len(free)} {word} no connection: {', '.join(free[:6])}{more}", ""
    for name, wire in profile.connectors.items():
        where, ledger = f"connectors.{name}", wire.ledger
        if dropped := sum(ledger.dropped.values()):
            lost = ", ".join(f"{count} {reason}" for reason, count in ledger.dropped.items() if count)
            cause = f"{dropped} of {ledger.written} samples were dropped ({lost})"
            most = max(ledger.dropped, key=lambda reason: ledger.dropped[reason])
            helps = f"{WHY_DROPPED[most]}; " if most in WHY_DROPPED else ""
            yield "warning", "W-DROPPED", where, cause, f"{helps}see aiorts help slow-reader"
        if ledger.silent:
            cause = f"{wire.source} has not written for longer than max_gap"
            yield "warning", "W-SILENT", where, cause, f"look at {wire.source.partition('.')[0]} with aiorts cat"
    for path, ends in _waiting(profile):
        cause = f"{path}: all run on events, and no sample came along this circle so far"
        yield "note", "N-CIRCLE", f"connectors.{ends}", cause, BEGIN
    for name, context in profile.contexts.items():
        where, counts = f"contexts.{name}", context.statistics
        if counts.overruns:
            blame = f", the last by {counts.last_blame.place}" if counts.last_blame is not None else ""
            cause = f"{counts.overruns} of {counts.cycles} cycles were not done when the next was due{blame}"
            yield "warning", "W-LATE", where, cause, "see aiorts help missed-deadline"


def _waiting(profile: SystemProfile) -> Iterator[tuple[str, str]]:
    """Circles of active components that run on events alone, and that no sample has entered: the ports, and the last
    connector of each."""
    others = {name for one in profile.contexts.values() if one.kind != "event" for name in one.members}
    edges: dict[str, dict[str, tuple[str, str, int]]] = {
        name: {}
        for name, one in profile.components.items()
        if one.composite is None and name not in others and "active" in one.states.values()
    }
    names = list(profile.connectors)
    for number, wire in enumerate(profile.connectors.values()):
        writer, reader = (path.partition(".")[0] for path in (wire.source, wire.target))
        arrived = wire.ledger.written - sum(wire.ledger.dropped.values())
        if writer in edges and reader in edges and wire.options.dataflow is Dataflow.PUSH and not arrived:
            edges[writer].setdefault(reader, (wire.source, wire.target, number))
    return ((path, names[number]) for path, number, _ in cycles(edges))
