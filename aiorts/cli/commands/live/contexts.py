"""`aiorts ctx`: lists and changes execution contexts of running kernels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.components import pairs
from aiorts.cli.commands.live.showing import json_option, named, say_done, say_kernels, timeout_option
from aiorts.cli.commands.live.target import Kernels, Running, kernels, the_one
from aiorts.cli.console.output import counted, table
from aiorts.errors import AbsentError


def complete_contexts(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete names of running contexts."""
    from aiorts.cli.console.completion import items

    with kernels(timeout=0.1) as found:
        words = [name for one in found.running for name in one.names["contexts"]]
        words += [f"{one.name}/{name}" for one in found.running for name in one.names["contexts"]]
    return items(dict.fromkeys(words), incomplete)


@click.group(
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    short_help="List, start, stop and change execution contexts.",
)
@timeout_option(5.0)
@json_option()
@click.pass_context
def ctx(context: click.Context, timeout: float, as_json: bool) -> int:
    """List the execution contexts of what runs, or change them.

    Alone it lists them: kind, rate, cycles, overruns, members in order of execution.
    """
    if context.invoked_subcommand is not None:
        return exits.DONE
    with kernels() as found:
        listed = {one.name: named(one.client.call("contexts", timeout)) for one in found.running}
        return say_kernels(found, "contexts", listed, lambda rows: table(map(_row, rows)), as_json=as_json)


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    counts = one["statistics"]
    rate = "" if one["rate"] is None else f"{one['rate']:g} Hz"
    overruns = counted(counts["overruns"], "overrun") if counts["overruns"] else ""
    return (one["name"], one["kind"], rate, counted(counts["cycles"], "cycle"), overruns, ", ".join(one["members"]))


@ctx.command(short_help="Start a context.")
@click.argument("name", metavar="[KERNEL/]NAME")
@click.argument("words", nargs=-1, metavar="[COMPONENT]... [OPTION=VALUE]...")
@click.option("--kind", default="periodic", metavar="KIND", help="periodic, event, thread, ...; periodic by default.")
@click.option("--activate", is_flag=True, help="Have the members active before the first cycle.")
@timeout_option(5.0)
@json_option()
def start(name: str, words: tuple[str, ...], kind: str, activate: bool, timeout: float, as_json: bool) -> int:
    """Start a context with these members, in this order, and the options of its kind: rate=100."""
    options = pairs(tuple(word for word in words if "=" in word))
    kernel, slash, bare = name.rpartition("/")
    with kernels(changing=True) as found:
        members = [word for word in words if "=" not in word]
        running = found.component(members[0]).running if members and not slash else found.kernel(kernel)
        running.client.call(
            "start_context", timeout + 32.0, name=bare, kind=kind, members=found.members(running, members),
            options=options, activate=activate, timeout=timeout,
        )  # fmt: skip
    return say_done([f"{running.name}/{bare}"], as_json=as_json)


@ctx.command(short_help="Stop a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@timeout_option(10.0)
@json_option()
def stop(name: str, timeout: float, as_json: bool) -> int:
    """Stop a context: its members are deactivated and stay, in no context."""
    with kernels(changing=True) as found:
        running, context = _context(found, name)
        running.client.call("stop_context", timeout, context=context)
    return say_done([f"{running.name}/{context}"], as_json=as_json)


@ctx.command(short_help="Change the rate of a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("hz", type=float, metavar="HZ")
@timeout_option(5.0)
@json_option()
def rate(name: str, hz: float, timeout: float, as_json: bool) -> int:
    """Change the rate of a context; it is in force when this returns."""
    with kernels(changing=True) as found:
        running, context = _context(found, name)
        running.client.call("set_rate", timeout + 2.0, context=context, rate=hz, timeout=timeout)
    return say_done([f"{running.name}/{context}"], as_json=as_json)


@ctx.command(short_help="Have components join a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("members", nargs=-1, required=True, metavar="COMPONENT...")
@click.option("--activate", is_flag=True, help="Activate them there.")
@timeout_option(5.0)
@json_option()
def add(name: str, members: tuple[str, ...], activate: bool, timeout: float, as_json: bool) -> int:
    """Have components join a context, at the end of its order."""
    return _change("join_context", name, members, timeout, activate=activate, as_json=as_json)


@ctx.command(short_help="Have components leave a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("members", nargs=-1, required=True, metavar="COMPONENT...")
@timeout_option(5.0)
@json_option()
def drop(name: str, members: tuple[str, ...], timeout: float, as_json: bool) -> int:
    """Have components leave a context: they are deactivated first."""
    return _change("leave_context", name, members, timeout, as_json=as_json)


def _change(
    operation: str, name: str, members: tuple[str, ...], timeout: float, *, as_json: bool, **more: object
) -> int:
    with kernels(changing=True) as found:
        running, context = _context(found, name)
        names = found.members(running, members)
        running.client.call(operation, 2 * timeout + 2.0, context=context, members=names, timeout=timeout, **more)
    return say_done([f"{running.name}/{one}" for one in names], as_json=as_json)


def _context(found: Kernels, word: str) -> tuple[Running, str]:
    """Find the kernel and the name of the context that a word means.

    Raises:
        AbsentError: no context has the name.
        AmbiguousError: several have it.
    """
    if having := found.having("contexts", word):
        return the_one(word, having, [f"{one.name}/{name}" for one, name in having])
    kernel, slash, _ = word.rpartition("/")
    among = (found.kernel(kernel),) if slash else found.running
    there = ", ".join(f"{one.name}/{each}" for one in among for each in one.names["contexts"])
    raise AbsentError(f"{word}: no context that runs has this name; there are {there or 'none'}")
