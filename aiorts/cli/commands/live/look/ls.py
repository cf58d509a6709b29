"""`aiorts ls`: lists running kernels, their components and ports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.look.named import Named, outlines
from aiorts.cli.commands.live.look.named import named as meant_by
from aiorts.cli.commands.live.showing import json_option, mute, named, say_silent, timeout_option
from aiorts.cli.commands.live.target import Running, complete, kernels
from aiorts.cli.console.output import say, say_json, table
from aiorts.model.lifecycle import state_text


@click.command(short_help="List the kernels that run, their components and ports.")
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete)
@click.option("-l", "--long", "long", is_flag=True, help="With the state of each component, and its contexts.")
@click.option("-R", "--recursive", "ports", is_flag=True, help="With the ports of each component.")
@timeout_option(1.0)
@json_option()
def ls(names: tuple[str, ...], long: bool, ports: bool, timeout: float, as_json: bool) -> int:
    """List what runs: every kernel of this user that can be reached, and its components; of a component its ports.

    NAME is a kernel, a component, a port, a context or a connector: `comp`, `comp.port`, `kernel/comp.port`; * and ?
    in quotes stand for any characters. `aiorts run` can be reached unless --control=off; a program or a filter where it
    asks for it. A kernel that does not answer, stopped or stuck, shows as such.
    """
    with kernels(timeout) as found:
        every = [Named(one, "kernel", "") for one in found.running]
        shown = [one for word in names for one in meant_by(found, word)] if names else every
        shown = list({one.full: one for one in shown}.values())
        if as_json:
            say_json({
                "kernels": [_document(one, shown, ports=ports) for one in found.running if _is_of(one, shown)],
                "no_answer": mute(found),
            })  # fmt: skip
            return exits.DONE
        for one in shown:
            say(_text(one, long=long, ports=ports))
        if not names:
            say_silent(found)
    return exits.DONE


# -- as JSON -----------------------------------------------------------------------------------------------------------


def _is_of(running: Running, shown: list[Named]) -> bool:
    return any(one.running is running for one in shown)


def _document(running: Running, shown: list[Named], *, ports: bool) -> dict[str, Any]:
    """A kernel with the named parts of it; with `ports` also the ports of each component."""
    meant = [one for one in shown if one.running is running]
    names, whole = running.names, any(one.kind == "kernel" for one in meant)
    of = dict.fromkeys(one.name.partition(".")[0] for one in meant if one.kind in ("component", "port"))
    components = names["components"] if whole else of
    wanted = {kind: [one.name for one in meant if one.kind == kind] for kind in ("context", "connector")}
    asked = components if ports else of
    inside = outlines(running, *asked) if asked else {}
    return {
        "name": running.name,
        "pid": running.client.entry.pid,
        "state": names["state"],
        "links": running.links or None,
        "notices": list(names.get("notices", ())),
        "components": [_component(names, name, inside.get(name)) for name in components],
        "contexts": [
            {"name": name, "members": members}
            for name, members in names["contexts"].items()
            if whole or name in wanted["context"]
        ],
        "connectors": [
            {"name": name, "ports": ends}
            for name, ends in names["connectors"].items()
            if whole or name in wanted["connector"]
        ],
    }


def _component(names: Mapping[str, Any], name: str, outline: Mapping[str, Any] | None) -> dict[str, Any]:
    found = {"name": name, "states": names["components"][name], "failed": name in names["in_error"]}
    if late := _overdue(names, name):
        found["overdue"] = late
    if outline is not None:
        found |= {"type": outline["type"], "ports": named(outline["ports"]), "params": outline["params"]}
    return found


# -- as text -----------------------------------------------------------------------------------------------------------


def _text(one: Named, *, long: bool, ports: bool) -> str:
    names = one.running.names
    if one.kind == "kernel":
        return _kernel(one, long=long, ports=ports)
    if one.kind == "port":
        return f"{one.full}  {_kind((one.outline or {})['ports'][one.name.partition('.')[2]])}"
    if one.kind != "component":
        return f"{one.full}  {one.kind} of {', '.join(names[f'{one.kind}s'][one.name]) or 'nothing'}"
    head = f"{one.full}  {'  '.join(_row(names, one.name, long=True)[1:])}".rstrip() if long else one.full
    return "\n".join(filter(None, (head, _ports(outlines(one.running, one.name)[one.name], "  "))))


def _kernel(one: Named, *, long: bool, ports: bool) -> str:
    names, client = one.running.names, one.running.client
    links = one.running.links
    head = one.full if not long else f"{one.full}  process {client.entry.pid}, {names['state']}"
    head = head if links in ("", one.running.name) else f"{head}  links: {links}"
    lines = ["  ".join((head, *names.get("notices", ())))]
    rows = table([_row(names, component, long=long) for component in names["components"]])
    if not ports:
        return "\n".join(filter(None, (*lines, rows)))
    every = outlines(one.running) if rows else {}
    for component, row in zip(names["components"], rows.split("\n"), strict=bool(rows)):
        lines += filter(None, (row, _ports(every.get(component, {"ports": {}}), "    ")))
    return "\n".join(lines)


def _ports(outline: Mapping[str, Any], indent: str) -> str:
    return table([(port["direction"], name, port["type"]) for name, port in outline["ports"].items()], indent=indent)


def _kind(port: Mapping[str, Any]) -> str:
    return f"{port['direction']} {port['type']}"


def _row(names: Mapping[str, Any], component: str, *, long: bool) -> tuple[str, ...]:
    states: Mapping[str, str] = names["components"][component]
    if not long:
        return (component,)
    failed = "failed" if component in names["in_error"] else ""
    return (component, state_text(states, _overdue(names, component)), ", ".join(states), failed)


def _overdue(names: Mapping[str, Any], component: str) -> Mapping[str, Any]:
    """The late hooks of a component by context; empty for a kernel of an earlier release, which reports none."""
    found: Mapping[str, Any] = names.get("overdue", {}).get(component, {})
    return found
