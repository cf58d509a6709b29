"""`aiorts ctx`: execution contexts of what runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.components import pairs
from aiorts.cli.commands.live.target import Kernels, Running, kernels
from aiorts.cli.console.output import say, say_json, table
from aiorts.errors import AbsentError


def complete_contexts(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Completes names of contexts that run."""
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
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@click.pass_context
def ctx(context: click.Context, as_json: bool) -> int:
    """List the execution contexts of what runs, or change them.

    Alone it lists them: kind, rate, cycles, overruns, members in order of execution.
    """
    if context.invoked_subcommand is not None:
        return exits.DONE
    with kernels() as found:
        listed = {one.name: one.client.call("contexts") for one in found.running}
    if as_json:
        say_json(listed)
        return exits.DONE
    for kernel, contexts in listed.items():
        say(f"{kernel}/")
        if contexts:
            say(table([_row(name, one) for name, one in contexts.items()]))
    return exits.DONE


def _row(name: str, one: Mapping[str, Any]) -> tuple[str, ...]:
    counts = one["statistics"]
    rate = "" if one["rate"] is None else f"{one['rate']:g} Hz"
    overruns = f"{counts['overruns']} overruns" if counts["overruns"] else ""
    return (name, one["kind"], rate, f"{counts['cycles']} cycles", overruns, ", ".join(one["members"]))


@ctx.command(short_help="Start a context.")
@click.argument("name", metavar="[KERNEL/]NAME")
@click.argument("words", nargs=-1, metavar="[COMPONENT]... [OPTION=VALUE]...")
@click.option("--kind", default="periodic", metavar="KIND", help="periodic, event, thread, ...; periodic by default.")
@click.option("--activate", is_flag=True, help="Have the members active before the first cycle.")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds.")
def start(name: str, words: tuple[str, ...], kind: str, activate: bool, timeout: float) -> int:
    """Start a context with these members, in this order, and the options of its kind: rate=100."""
    options = pairs(tuple(word for word in words if "=" in word))
    kernel, slash, bare = name.rpartition("/")
    with kernels() as found:
        members = [found.component(word) for word in words if "=" not in word]
        running = members[0].running if members and not slash else found.kernel(kernel if slash else "")
        _same(running, [one.running for one in members])
        running.client.call(
            "start_context", timeout + 32.0, name=bare, kind=kind, members=[one.component for one in members],
            options=options, activate=activate, timeout=timeout,
        )  # fmt: skip
    return exits.DONE


@ctx.command(short_help="Stop a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.option("--timeout", type=click.FloatRange(min=0.001), default=10.0, metavar="S", help="Wait S seconds.")
def stop(name: str, timeout: float) -> int:
    """Stop a context: its members are deactivated and stay, in no context."""
    with kernels() as found:
        running, context = _context(found, name)
        running.client.call("stop_context", timeout, context=context)
    return exits.DONE


@ctx.command(short_help="Change the rate of a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("hz", type=float, metavar="HZ")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds.")
def rate(name: str, hz: float, timeout: float) -> int:
    """Change the rate of a context; it is in force when this returns."""
    with kernels() as found:
        running, context = _context(found, name)
        running.client.call("set_rate", timeout + 2.0, context=context, rate=hz, timeout=timeout)
    return exits.DONE


@ctx.command(short_help="Have components join a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("members", nargs=-1, required=True, metavar="COMPONENT...")
@click.option("--activate", is_flag=True, help="Activate them there.")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds.")
def add(name: str, members: tuple[str, ...], activate: bool, timeout: float) -> int:
    """Have components join a context, at the end of its order."""
    return _change("join_context", name, members, timeout, activate=activate)


@ctx.command(short_help="Have components leave a context.")
@click.argument("name", metavar="[KERNEL/]NAME", shell_complete=complete_contexts)
@click.argument("members", nargs=-1, required=True, metavar="COMPONENT...")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds.")
def drop(name: str, members: tuple[str, ...], timeout: float) -> int:
    """Have components leave a context: they are deactivated first."""
    return _change("leave_context", name, members, timeout)


def _change(operation: str, name: str, members: tuple[str, ...], timeout: float, **more: object) -> int:
    with kernels() as found:
        running, context = _context(found, name)
        names = [word.rpartition("/")[2] for word in members]
        running.client.call(operation, 2 * timeout + 2.0, context=context, members=names, timeout=timeout, **more)
    return exits.DONE


def _context(found: Kernels, word: str) -> tuple[Running, str]:
    """The kernel and the name of the context that a word means.

    Raises:
        AbsentError: nothing has the name, or several have.
    """
    kernel, slash, name = word.rpartition("/")
    among = (found.kernel(kernel),) if slash else found.running
    having = [one for one in among if name in one.names["contexts"]]
    if len(having) == 1:
        return having[0], name
    if having:
        shown = ", ".join(f"{one.name}/{name}" for one in having)
        raise AbsentError(f"{word}: {len(having)} contexts have this name: {shown}; write the kernel before it")
    there = ", ".join(f"{one.name}/{each}" for one in among for each in one.names["contexts"])
    raise AbsentError(f"{word}: no context that runs has this name; there are {there or 'none'}")


def _same(running: Running, others: list[Running]) -> None:
    if strangers := [one.name for one in others if one is not running]:
        raise AbsentError(f"the context is in {running.name}, and a component in {strangers[0]}")
