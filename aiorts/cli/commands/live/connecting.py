"""`aiorts connect` and `disconnect`: make, list and end connectors of running kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.components import absolute
from aiorts.cli.commands.live.ledger import ledger_text
from aiorts.cli.commands.live.showing import json_option, say_done, say_kernels, timeout_option
from aiorts.cli.commands.live.spans import read_text
from aiorts.cli.commands.live.target import Found, Kernels, Running, complete, complete_fitting, kernels, the_one
from aiorts.cli.console.output import counted, say_either
from aiorts.control import converters_read
from aiorts.errors import ControlError
from aiorts.model.options import OWN_KEYS, OWN_OPTIONS


def _with_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add an option to the command for each option of `Kernel.connect`."""
    command = click.option("--adapt", is_flag=True, help="Put a FlexiFilter between ports that do not fit.")(command)
    for key in reversed((*(one for one in OWN_KEYS if one != "adapt"), "strict")):
        command = click.option(f"--{key.replace('_', '-')}", key, metavar="X", help=f"The same as {key}=X.")(command)
    return command


@click.command(short_help="Connect ports of what runs; list connectors.")
@click.argument("words", nargs=-1, metavar="[PORT PORT...] [KEY=VALUE...]", shell_complete=complete_fitting)
@click.option("--both-ends", is_flag=True, help="Of links, ask the other kernel, too: the ledger from end to end.")
@timeout_option(5.0, "Wait S seconds for the answer; --timeout is the connector's own", "--wait")
@json_option()
@_with_options
def connect(
    words: tuple[str, ...], both_ends: bool, wait: float, as_json: bool, adapt: bool, **given: str | None
) -> int:
    """Connect ports: COMPONENT.PORT COMPONENT.PORT, and the options of Kernel.connect as KEY=VALUE or --KEY VALUE.

    It prints the options in force at both ends. With --adapt, where types, units or lengths differ, a FlexiFilter is
    put between, which runs before the reader, and it is printed, too; where there are several ways, all are named and
    nothing is done. Between ports of two kernels it makes a link; the kernel of the reader needs a [links] table.

    Without ports, or with one, a component or a kernel, it lists the connectors that are there, with their ledger. Of a
    link this kernel knows its own end alone; --both-ends asks the other kernel, too, and lists: with two ports those
    between them. Where the link has `measure`, it prints how old samples were as they were read there.
    """
    paths, options = _split(words)
    if adapt:
        options["adapt"] = "true"
    for key, value in given.items():
        if value is not None:
            if key in options:
                raise click.UsageError(f"{key} is given twice; give it once")
            options[key] = value
    if len(paths) < 2 and options:
        raise click.UsageError("options need two ports at least")
    lists = len(paths) < 2 or (both_ends and len(paths) == 2 and not options)
    if both_ends and not lists:
        raise click.UsageError("--both-ends is for listing: name one port, component or kernel, two ports, or none")
    if "convert" in options:
        options["convert"] = absolute(options["convert"])
    with kernels(changing=not lists, right="code" if converters_read(options) else "") as found:
        if lists:
            return _list(found, paths, wait, both_ends=both_ends, as_json=as_json)
        ports = [port_of(found, path) for path in paths]
        running = _maker(ports)
        made = running.client.call("connect", wait, ports=[_seen(one, running) for one in ports], options=options)
        say_either(made, lambda: "\n".join(_text(one, ledger=False) for one in made), as_json=as_json)
    return exits.DONE


@click.command(short_help="End connectors of what runs.")
@click.argument(
    "words", nargs=-1, required=True, metavar="CONNECTOR | PORT [PORT] | COMPONENT", shell_complete=complete
)
@timeout_option(5.0)
@json_option()
def disconnect(words: tuple[str, ...], timeout: float, as_json: bool) -> int:
    """End connectors: one by its name, or those between two ports or components, or all at one port or component."""
    with kernels(changing=True) as found:
        if len(words) == 1 and (named := found.having("connectors", words[0])):
            running, name = the_one(words[0], named, [f"{one.name}/{name}" for one, name in named])
            ended = running.client.call("disconnect", timeout, names=[name])
        else:
            ports = [port_of(found, word, whole=True) for word in words]
            running = _maker(ports)
            ended = running.client.call("disconnect", timeout, at=[_seen(one, running) for one in ports])
    return say_done((f"{running.name}/{name}" for name in ended), as_json=as_json)


def port_of(found: Kernels, word: str, *, whole: bool = False) -> Found:
    """Find the port, or with `whole` the component, that a word means. AbsentError: it means something else."""
    one = found.find(word)
    one.check("port", *(("component",) if whole else ()))
    return one


def _maker(ports: list[Found]) -> Running:
    """The kernel that has or makes the connectors of ports: the common kernel, or, for a link, the writer's kernel."""
    if len({one.running.name for one in ports}) == 1:
        return ports[0].running
    directions = [_direction(one) for one in ports]
    for wanted in ("out", "service"):
        for one, direction in zip(ports, directions, strict=True):
            if direction == wanted:
                return one.running
    return ports[0].running


def _direction(port: Found) -> str:
    outline = port.client.call("outline", components=[port.component])[port.component]
    return str(outline["ports"].get(port.port, {}).get("direction", ""))


def _seen(port: Found, running: Running) -> str:
    """The path of a port as the kernel `running` names it."""
    if port.running is running:
        return port.path
    if not port.running.links:
        name = port.running.name
        raise ControlError(f"{port.full}: links of other kernels cannot reach {name}; give it a [links] table")
    return f"{port.running.links}/{port.path}"


def _split(words: tuple[str, ...]) -> tuple[list[str], dict[str, str]]:
    paths, options = [], dict[str, str]()
    for word in words:
        key, sign, value = word.partition("=")
        if not sign:
            paths.append(word)
            continue
        if key in options:
            raise click.UsageError(f"{key} is given twice; give it once")
        options[key] = value
    return paths, options


def _list(found: Kernels, paths: list[str], timeout: float, *, both_ends: bool, as_json: bool) -> int:
    meant: list[tuple[Running, list[str]]]
    if len(paths) == 2:
        ports = [port_of(found, path, whole=True) for path in paths]
        running = _maker(ports)
        meant = [(running, [_seen(one, running) for one in ports])]
    elif paths:
        one = found.find(paths[0], bare=True)
        meant = [(one.running, [one.path] if one.path else [])]
    else:
        meant = [(one, []) for one in found.running]
    listed = {one.name: list(one.client.call("connectors", timeout, at=at, both_ends=both_ends)) for one, at in meant}
    return say_kernels(found, "connectors", listed, _lines, as_json=as_json, silent=not paths)


def _lines(connectors: list[dict[str, Any]]) -> str:
    return "\n".join(f"  {line}" for one in connectors for line in _text(one, ledger=True).split("\n"))


def _text(one: Mapping[str, Any], *, ledger: bool) -> str:
    if one["service"] is not None:
        lines = [f"  {required} -> {provided}" for required, provided in one["service"]["mapping"]]
        counts = f"    {counted(one['calls']['calls'], 'call')}, {one['calls']['failures']} failed" if ledger else ""
        return "\n".join([f"{one['name']}", *lines, *([counts] if counts else [])])
    options = one["options"]
    text = [
        f"{one['name']}",
        f"  {one['ports'][0]}: {_said(options, 'writer')}",
        f"  {one['ports'][1]}: {_said(options, 'reader')}",
        *([f"  through {one['between']}"] if one.get("between") else []),
    ]
    joined = one.get("both_ends") or ""
    if ledger and (not joined or joined.startswith("not known")):  # two ledgers of different moments disagree
        text.append(f"  {ledger_text(one['ledger'])}")
    if joined:
        text.append(f"  both ends: {joined}")
    if one.get("read"):
        text.append(f"  at the read: {read_text(one['read'])}")
    return "\n".join(text)


def _said(options: Mapping[str, Any], end: str) -> str:
    """The options in force at one end, in words."""
    there = {key: options[key] for key, one in OWN_OPTIONS.items() if one.end == end and key in options}
    return ", ".join(
        f"{key} {str(value).lower() if isinstance(value, bool) else value}"
        for key, value in there.items()
        if value not in (None, "") and (value or OWN_OPTIONS[key].default)
    )
