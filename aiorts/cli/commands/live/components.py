"""`aiorts comp` and `exit`: components of what runs are created, removed, made members of composites."""

from __future__ import annotations

import click

from aiorts import exits
from aiorts.cli.commands.live.target import complete, kernels
from aiorts.cli.console.output import say, say_json


@click.group(short_help="Create and remove components; members of composites.")
def comp() -> None:
    """Create and remove components of what runs, and change which are members of a composite."""


@comp.command(short_help="Create a component.")
@click.argument("type_", metavar="TYPE")
@click.argument("name", default="", metavar="[[KERNEL/]NAME]")
@click.argument("params", nargs=-1, metavar="[PARAM=VALUE]...")
@click.option("--context", metavar="NAME", help="Let it join this context.")
@click.option("--activate", is_flag=True, help="Activate it there.")
@click.option("--timeout", type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def create(
    type_: str, name: str, params: tuple[str, ...], context: str | None, activate: bool, timeout: float, as_json: bool
) -> int:
    """Create a component of TYPE: a name that a plugin offers, package.module:Class or FILE.py:Class.

    FILE.py is counted from the current folder, and read by the kernel. Code is taken over the local socket only.
    Without a name it gets one made from its type's, in the only kernel that runs.
    """
    if "=" in name:
        name, params = "", (name, *params)
    kernel, slash, bare = name.rpartition("/")
    with kernels() as found:
        running = found.kernel(kernel if slash else "")
        done = running.client.call(
            "create", 30.0 + 2 * timeout, type=absolute(type_), name=bare, params=pairs(params), context=context,
            activate=activate, timeout=timeout,
        )  # fmt: skip
        if as_json:
            say_json({"component": done["text"]})
        else:
            say(f"{running.name}/{done['text']}")
    return exits.DONE


def _members(name: str, operation: str, text: str) -> click.Command:
    def run(composite: str, members: tuple[str, ...], timeout: float) -> int:
        with kernels() as found:
            one = found.component(composite)
            chosen = [found.component(f"{one.running.name}/{word.rpartition('/')[2]}") for word in members]
            one.client.call(
                operation, timeout + 2.0, composite=one.component, members=[member.component for member in chosen],
                timeout=timeout,
            )  # fmt: skip
        return exits.DONE

    params: list[click.Parameter] = [
        click.Argument(["composite"], metavar="COMPOSITE", shell_complete=complete),
        click.Argument(["members"], nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete),
        click.Option(["--timeout"], type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds."),
    ]
    return click.Command(name, callback=run, params=params, short_help=text, help=text)


def _take_out(names: tuple[str, ...], wait: float) -> int:
    with kernels() as found:
        for one in found.components(names):
            one.client.call("remove", wait, components=[one.component])
    return exits.DONE


def _removing(name: str) -> click.Command:
    return click.Command(
        name,
        callback=_take_out,
        params=[
            click.Argument(["names"], nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete),
            click.Option(
                ["--timeout", "wait"], type=click.FloatRange(min=0.001), default=10.0, metavar="S",
                help="Wait S seconds.",
            ),
        ],
        short_help="Remove components that run.",
        help="Take components out of their kernel: deactivated, disconnected, finalised. * and ? in quotes stand for "
        "several.",
    )  # fmt: skip


comp.add_command(_members("add", "add_members", "Make components members of a composite."))
comp.add_command(_members("drop", "remove_members", "Take members out of a composite."))
comp.add_command(_removing("remove"))
exit_ = _removing("exit")


def absolute(kind: str) -> str:
    """A type as text, its file counted from the current folder: that of the kernel may be another."""
    file, sign, name = kind.rpartition(":")
    file = file if sign else name
    if not file.endswith(".py"):
        return kind
    from os.path import abspath, expanduser

    return f"{abspath(expanduser(file))}:{name}" if sign else abspath(expanduser(file))


def pairs(words: tuple[str, ...]) -> dict[str, str]:
    """NAME=VALUE words by name."""
    found: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or not name.strip():
            raise click.UsageError(f"{word[:80]}: expected NAME=VALUE")
        if name.strip() in found:
            raise click.UsageError(f"{name.strip()}: is given twice; give it once")
        found[name.strip()] = value
    return found
