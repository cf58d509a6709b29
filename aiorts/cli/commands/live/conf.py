"""`aiorts conf`: shows and changes parameters and configuration sets in running kernels."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.components import right_for
from aiorts.cli.commands.live.showing import json_option, say_done, timeout_option
from aiorts.cli.commands.live.target import Found, Kernels, complete, complete_changes, kernels
from aiorts.cli.console.output import say_either, table
from aiorts.errors import AbsentError, ConfigurationError
from aiorts.spelling import suggestion

_LONGEST: Final = 4 * 1024 * 1024
_PART: Final = 16_000
"""Characters of a file that are sent as one text."""
_FILE: Final = click.Path(dir_okay=False, allow_dash=True)


@click.command(short_help="Show and change parameters and sets of what runs.")
@click.argument("name", default="", metavar="[KERNEL/][COMPONENT]", shell_complete=complete)
@click.argument("changes", nargs=-1, metavar="[PARAM]... | [[SET.]PARAM=VALUE]...", shell_complete=complete_changes)
@click.option("--activate", metavar="SET", help="Make this set the active one.")
@click.option("--add", multiple=True, metavar="SET", help="Add a set; repeatable.")
@click.option("--remove", multiple=True, metavar="SET", help="Remove a set; repeatable.")
@click.option("--dump", type=_FILE, metavar="FILE", help="Write the configuration to FILE, or - for standard output.")
@click.option("--load", type=_FILE, metavar="FILE", help="Put FILE in force, or - for standard input; all or nothing.")
@click.option("-l", "--long", "long", is_flag=True, help="With types, units and what is allowed.")
@timeout_option(8.0)
@json_option()
def conf(
    name: str,
    changes: tuple[str, ...],
    activate: str | None,
    add: tuple[str, ...],
    remove: tuple[str, ...],
    dump: str | None,
    load: str | None,
    long: bool,
    timeout: float,
    as_json: bool,
) -> int:
    """Show the parameters of COMPONENT, or PARAM alone, or change them.

    PARAM=VALUE is for the active set, SET.PARAM=VALUE for another. All changes of one command are put in force between
    two cycles, together or not at all; when it returns they are in force, and --json prints the configuration. A value
    is read by the parameter's type, as --set of aiorts run does. --dump and --load are for a component or for a kernel,
    the only one without a name: the file is that of Kernel.save_configuration.
    """
    plain = not any("=" in one for one in changes) and not (activate or add or remove or dump or load)
    wanted = changes if plain else ()
    values = {} if plain else _values(changes)
    changing = bool(values or activate or add or remove)
    if (dump is not None) + (load is not None) + changing > 1:
        raise click.UsageError("--dump, --load and changes each need a command of their own")
    texts = (value for of_set in values.values() for value in of_set.values())
    right = right_for(texts, code=load is not None) if changing or load is not None else "view"
    with kernels(changing=right != "view", right=right) as found:
        if dump is not None or load is not None:
            return _file(found, name, dump, load, timeout, as_json=as_json)
        if not name:
            raise click.UsageError("say which component; aiorts ls shows which there are")
        one = found.component(name)
        if changing:
            one.client.call(
                "configure", timeout, component=one.component, values=values, add=add, remove=remove, activate=activate
            )
            if not as_json:
                return exits.DONE
        shown = one.client.call("configuration", timeout, component=one.component)
        if wanted:
            shown = {**shown, "parameters": _chosen(one, shown["parameters"], wanted)}
        say_either(shown, lambda: _shown(one, shown, long=long), as_json=as_json)
    return exits.DONE


def _chosen(one: Found, parameters: Sequence[Any], wanted: Sequence[str]) -> list[Any]:
    """The parameters of the wanted names, in that order. AbsentError: a name is unknown."""
    known = {param["name"]: param for param in parameters}
    for name in wanted:
        if name not in known:
            hint = suggestion(name, known, shown=str)
            raise AbsentError(f"{name:.80}: {one.component} has no such parameter; {hint}")
    return [known[name] for name in wanted]


def _values(changes: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """The values of the changes by set; "" is the active set."""
    values: dict[str, dict[str, str]] = {}
    for change in changes:
        key, sign, text = change.partition("=")
        set_, _, param = key.strip().rpartition(".")
        if not sign or not param:
            raise click.UsageError(f"{change[:80]}: expected PARAM=VALUE or SET.PARAM=VALUE")
        if param in values.setdefault(set_, {}):
            raise click.UsageError(f"{key.strip()}: is given twice; give it once")
        values[set_][param] = text
    return values


def _file(found: Kernels, name: str, dump: str | None, load: str | None, timeout: float, *, as_json: bool) -> int:
    one = found.find(name, bare=True) if name else Found(found.kernel(), "")
    one.check("component", "kernel")
    running = one.running
    if dump is not None:
        chosen = [one.component] if one.component else []
        text = running.client.call("dump_configuration", timeout, components=chosen)["text"]
        if dump == "-":
            from aiorts.system import standard_output  # late: it imports asyncio, which the client does without

            standard_output().write(text)
        else:
            from pathlib import Path

            from aiorts.configuration import replace_text

            replace_text(Path(dump), text)
    elif load is not None:
        text = text_of(load)
        parts = [text[at : at + _PART] for at in range(0, len(text), _PART)]
        running.client.call("load_configuration", timeout, parts=parts, name=load)
    return say_done([] if dump == "-" else [one.full], as_json=as_json and dump != "-")


def text_of(file: str) -> str:
    """The text of a small file, or of standard input for "-".

    Raises:
        ConfigurationError: the file cannot be read, or is too long.
    """
    from pathlib import Path

    from aiorts.configuration import read_text

    if file != "-":
        return read_text(Path(file), _LONGEST)
    text = sys.stdin.read(_LONGEST + 1)
    if len(text) > _LONGEST:
        raise ConfigurationError(f"standard input: longer than {_LONGEST} characters")
    return text


def _shown(one: Found, shown: Mapping[str, Any], *, long: bool) -> str:
    others = {name: values for name, values in shown["sets"].items() if name != "default"}
    head = f"{one.full}  set {shown['active']}{' of default, ' + ', '.join(others) if others else ''}"
    rows = []
    for param in shown["parameters"]:
        name = param["name"]
        within = [f"{other}: {_text(values[name])}" for other, values in others.items() if name in values]
        about = (param["type"], param["unit"], param["constraint"], param["doc"]) if long else (param["unit"],)
        rows.append((name, _text(param["value"]), *about, "; ".join(within)))
    return f"{head}\n{table(rows) or '  no parameters'}"


def _text(value: Any) -> str:
    from json import dumps

    return value if isinstance(value, str) else dumps(value)
