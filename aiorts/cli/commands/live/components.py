"""`aiorts comp` and `exit`: create and remove components of running kernels, and change members of composites."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.showing import json_option, say_done, timeout_option
from aiorts.cli.commands.live.target import complete, complete_params, complete_types, kernels
from aiorts.cli.console.output import say_either
from aiorts.control import is_code
from aiorts.sessions import RightName

_NO_TEXT: Final = re.compile(r"[-+0-9.,e_\s\[\]()]*|true|false|yes|no|on|off|none|null|[-+]?(nan|inf)", re.IGNORECASE)


@click.group(short_help="Create and remove components; members of composites.")
def comp() -> None:
    """Create and remove components of what runs, and change which are members of a composite."""


@comp.command(short_help="Create a component.")
@click.argument("type_", metavar="TYPE", shell_complete=complete_types)
@click.argument("name", default="", metavar="[[KERNEL/]NAME]")
@click.argument("params", nargs=-1, metavar="[PARAM=VALUE]...", shell_complete=complete_params)
@click.option("--context", metavar="NAME", help="Let it join this context.")
@click.option("--activate", is_flag=True, help="Activate it there.")
@timeout_option(5.0)
@json_option()
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
    values = pairs(params)
    with kernels(changing=True, right=right_for(values.values(), code=is_code(type_))) as found:
        running = found.kernel(kernel if slash else "")
        done = running.client.call(
            "create", 30.0 + 2 * timeout, type=absolute(type_), name=bare, params=values, context=context,
            activate=activate, timeout=timeout,
        )  # fmt: skip
        full = f"{running.name}/{done['text']}"
        say_either({"done": [{"name": full}]}, lambda: full, as_json=as_json)
    return exits.DONE


def _members(name: str, operation: str, text: str) -> click.Command:
    @click.command(name, short_help=text, help=text)
    @click.argument("composite", metavar="COMPOSITE", shell_complete=complete)
    @click.argument("members", nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete)
    @timeout_option(5.0)
    @json_option()
    def run(composite: str, members: tuple[str, ...], timeout: float, as_json: bool) -> int:
        with kernels(changing=True) as found:
            one = found.component(composite)
            chosen = found.members(one.running, members)
            one.client.call(operation, timeout + 2.0, composite=one.component, members=chosen, timeout=timeout)
        return say_done((f"{one.running.name}/{member}" for member in chosen), as_json=as_json)

    return run


def _removing(name: str) -> click.Command:
    @click.command(name, short_help="Remove components that run.")
    @click.argument("names", nargs=-1, required=True, metavar="COMPONENT...", shell_complete=complete)
    @timeout_option(10.0)
    @json_option()
    def run(names: tuple[str, ...], timeout: float, as_json: bool) -> int:
        """Take components out of their kernel: deactivated, disconnected, finalised. * and ? in quotes stand for
        several.
        """
        with kernels(changing=True) as found:
            meant = found.components(names)
            for one in meant:
                one.client.call("remove", timeout, components=[one.component])
        return say_done((one.full for one in meant), as_json=as_json)

    return run


comp.add_command(_members("add", "add_members", "Make components members of a composite."))
comp.add_command(_members("drop", "remove_members", "Take members out of a composite."))
comp.add_command(_removing("remove"))
exit_ = _removing("exit")


def absolute(kind: str) -> str:
    """A type with its file as an absolute path, since the kernel's current folder may be another."""
    file, sign, name = kind.rpartition(":")
    file = file if sign else name
    if not file.endswith(".py"):
        return kind
    from os.path import abspath, expanduser

    return f"{abspath(expanduser(file))}:{name}" if sign else abspath(expanduser(file))


def right_for(values: Iterable[str], *, code: bool = False) -> RightName:
    """The right for a call with values of a user: "code" if a value is a text, since a text may name a file.

    Args:
        code: whether the call names code anyway.
    """
    return "code" if code or any(map(_has_text, values)) else "operate"


def _has_text(value: str) -> bool:
    """Whether a value is a text, or JSON that contains one."""
    if _NO_TEXT.fullmatch(value):
        return False
    if not value.lstrip().startswith(("{", "[")):
        return True
    from json import loads

    try:
        return not all(_NO_TEXT.fullmatch(text) for text in _texts(loads(value)))
    except (ValueError, RecursionError):
        return True


def _texts(value: Any) -> Iterator[str]:
    """The texts in a JSON value; also keys that cannot be the name of a parameter or field."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        yield from chain.from_iterable(map(_texts, value))
    elif isinstance(value, dict):
        yield from (key for key in value if not key.isidentifier())
        yield from chain.from_iterable(map(_texts, value.values()))


def pairs(words: tuple[str, ...]) -> dict[str, str]:
    """The values of NAME=VALUE words by name."""
    found: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not sign or not name.strip():
            raise click.UsageError(f"{word[:80]}: expected NAME=VALUE")
        if name.strip() in found:
            raise click.UsageError(f"{name.strip()}: is given twice; give it once")
        found[name.strip()] = value
    return found
