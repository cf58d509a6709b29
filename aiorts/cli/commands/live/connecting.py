"""`aiorts connect` and `disconnect`: connectors of what runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.components import absolute
from aiorts.cli.commands.live.target import Found, Kernels, Running, complete, kernels
from aiorts.cli.console.output import say, say_json
from aiorts.errors import AmbiguousError, ControlError
from aiorts.model.options import OWN_KEYS

_OF_THE_WRITER: Final = ("dataflow", "subscription", "push", "push_rate", "skip", "out_length", "stamp", "convert")
_OF_THE_READER: Final = ("length", "full", "timeout", "empty", "keep_last", "lifespan", "max_gap", "measure")
_TIMEOUT: Final = click.Option(
    ["--wait"], type=click.FloatRange(min=0.001), default=5.0, metavar="S", help="Wait S seconds for the answer."
)
_JSON: Final = click.Option(["--json", "as_json"], is_flag=True, help="One JSON document.")


def _options() -> list[click.Parameter]:
    """An option of the command for each option of `Kernel.connect`."""
    found: list[click.Parameter] = []
    for key in (*OWN_KEYS, "strict"):
        flag = f"--{key.replace('_', '-')}"
        found.append(click.Option([flag, key], metavar="X", help=f"The same as {key}=X."))
    return found


def _connect(words: tuple[str, ...], wait: float, as_json: bool, **given: str | None) -> int:
    paths, options = _split(words)
    for key, value in given.items():
        if value is not None:
            if key in options:
                raise click.UsageError(f"{key} is given twice; give it once")
            options[key] = value
    if len(paths) < 2 and options:
        raise click.UsageError("options need two ports at least")
    if "convert" in options:
        options["convert"] = absolute(options["convert"])
    with kernels() as found:
        if len(paths) < 2:
            return _list(found, paths, as_json=as_json)
        ports = [port_of(found, path) for path in paths]
        running = _one_kernel(ports)
        made = running.client.call("connect", wait, ports=[one.path for one in ports], options=options)
        if as_json:
            say_json(made)
        else:
            for one in made:
                say(_text(one, ledger=False))
    return exits.DONE


def _disconnect(words: tuple[str, ...], wait: float, as_json: bool) -> int:
    with kernels() as found:
        named = [one for one in found.running if len(words) == 1 and _name(words[0], one) in one.names["connectors"]]
        if len(named) > 1:
            raise AmbiguousError(
                f"{words[0]}: {len(named)} kernels have a connector of this name; write the kernel first"
            )
        if named:
            ended = named[0].client.call("disconnect", wait, names=[_name(words[0], named[0])])
        else:
            ports = [port_of(found, word, whole=True) for word in words]
            ended = _one_kernel(ports).client.call("disconnect", wait, at=[one.path for one in ports])
        if as_json:
            say_json({"disconnected": ended})
    return exits.DONE


def port_of(found: Kernels, word: str, *, whole: bool = False) -> Found:
    """The port that a word means; with `whole` a component is one as well.

    Raises:
        ControlError: it means something else.
    """
    one = found.find(word)
    if not one.component or not (one.port or whole):
        raise ControlError(f"{word}: expected COMPONENT.PORT")
    return one


def _one_kernel(ports: list[Found]) -> Running:
    if len({one.running.name for one in ports}) > 1:
        raise ControlError(f"{' and '.join(one.full for one in ports)}: are of several kernels; a connector is in one")
    return ports[0].running


def _name(word: str, running: Running) -> str:
    """The name of a connector in a kernel, where the word may mean one of that kernel."""
    kernel, slash, name = word.rpartition("/")
    return name if not slash or kernel in (running.name, running.client.entry.address) else ""


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


def _list(found: Kernels, paths: list[str], *, as_json: bool) -> int:
    meant: list[tuple[Running, list[str]]]
    if paths:
        one = found.find(paths[0])
        meant = [(one.running, [one.path] if one.path else [])]
    else:
        meant = [(one, []) for one in found.running]
    listed = {one.name: one.client.call("connectors", at=at) for one, at in meant}
    if as_json:
        say_json(listed)
        return exits.DONE
    for kernel, connectors in listed.items():
        say(f"{kernel}/")
        for each in connectors:
            say("\n".join(f"  {line}" for line in _text(each, ledger=True).split("\n")))
    return exits.DONE


def _text(one: Mapping[str, Any], *, ledger: bool) -> str:
    if one["service"] is not None:
        lines = [f"  {required} -> {provided}" for required, provided in one["service"]["mapping"]]
        counts = f"    {one['calls']['calls']} calls, {one['calls']['failures']} failed" if ledger else ""
        return "\n".join([f"{one['name']}", *lines, *([counts] if counts else [])])
    options = one["options"]
    text = [
        f"{one['name']}",
        f"  {one['ports'][0]}: {_said(options, _OF_THE_WRITER)}",
        f"  {one['ports'][1]}: {_said(options, _OF_THE_READER)}",
    ]
    if ledger:
        counts = one["ledger"]
        lost = ", ".join(f"{count} {reason}" for reason, count in counts["dropped"].items())
        text.append(
            f"  written {counts['written']}, delivered {counts['delivered']}, waiting {counts['buffered']}, "
            f"dropped {lost or '0'}"
        )
    return "\n".join(text)


def _said(options: Mapping[str, Any], keys: tuple[str, ...]) -> str:
    """The options of one end that are in force, in words."""
    return ", ".join(
        f"{key} {str(options[key]).lower() if isinstance(options[key], bool) else options[key]}"
        for key in keys
        if options[key] not in (None, False, "") and not (key in ("skip", "measure") and not options[key])
    )


connect = click.Command(
    "connect",
    callback=_connect,
    params=[
        click.Argument(["words"], nargs=-1, metavar="[PORT PORT...] [KEY=VALUE...]", shell_complete=complete),
        _TIMEOUT,
        _JSON,
        *_options(),
    ],
    short_help="Connect ports of what runs; list connectors.",
    help="Connect ports: COMPONENT.PORT COMPONENT.PORT, and the options of Kernel.connect as KEY=VALUE or --KEY VALUE. "
    "It prints the options in force at both ends. Without ports, or with one, or a component or a kernel with a slash, "
    "it lists the connectors that are there, with their ledger.",
)
disconnect = click.Command(
    "disconnect",
    callback=_disconnect,
    params=[
        click.Argument(
            ["words"], nargs=-1, required=True, metavar="CONNECTOR | PORT [PORT] | COMPONENT", shell_complete=complete
        ),
        _TIMEOUT,
        _JSON,
    ],
    short_help="End connectors of what runs.",
    help="End connectors: one by its name, or those between two ports or components, or all at one port or component.",
)
