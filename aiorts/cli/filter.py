"""Any component as a Unix filter: `aiorts flexifilter -i TimedDouble ...` reads JSON lines and writes JSON lines.

Its options are those the class states in `options`, else one for each parameter. In-ports are fed from standard input,
out-ports written to standard output; back-pressure goes all the way, so that no line is lost.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Mapping
from typing import Any, Final

import click

from aiorts import Catalogue, Component, EventContext, InPort, Kernel, LifeCycleState, OutPort, declaration_of
from aiorts.cli.completion import completer_of
from aiorts.cli.ends import Ends
from aiorts.cli.output import plain, table
from aiorts.cli.report import report, report_error
from aiorts.cli.session import Options, checked, execute
from aiorts.cli.stopping import Stopper
from aiorts.cli.type_modules import import_types
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.events import StateChanged
from aiorts.system import FrameInput, StandardInput, construct, option_params
from aiorts.types import type_name

__all__ = ("command_of", "load_component")

_WAYS: Final = {"length": 1000, "full": "block", "timeout": None}
_WORDS: Final = {"in": "in ", "out": "out"}
_LONGEST: Final = 1_000_000
_OURS: Final = (
    click.Option(["--count"], type=click.IntRange(min=1), metavar="N", help="End after N samples."),
    click.Option(["--for", "duration"], type=float, metavar="S", help="End after S seconds."),
    click.Option(["--loop"], type=click.Choice(["auto", "uvloop", "asyncio"]), default="auto", help="The event loop."),
    click.Option(["--codec"], metavar="NAME", help="Binary frames of this codec in place of JSON lines."),
    click.Option(["--debug"], is_flag=True, help="Say what the component says, and show tracebacks."),
)


def load_component(name: str) -> type[Component]:
    """The class that is offered under this name. PluginError when it cannot be had."""
    return Catalogue.default().find("components", name).load_class(Component)


def command_of(name: str, cls: type[Component]) -> click.Command:
    """The command that runs a component of this class."""
    table = getattr(cls, "options", None)
    own = _from_table(table) if table is not None else _from_parameters(cls)
    taken = {flag for option in own for flag in option.opts}
    ours = [option for option in _OURS if not taken.intersection(option.opts)]

    def run(**given: Any) -> int:
        common = {option.name: given.pop(str(option.name)) for option in ours}
        return _run(cls, table or (), given, common)

    return click.Command(name, callback=run, params=[*own, *ours], help=_help(cls), no_args_is_help=False)


def _help(cls: type[Component]) -> str:
    first = inspect.cleandoc(cls.__doc__ or cls.__name__)
    more = inspect.cleandoc(getattr(cls, "help_text", ""))
    if interface := getattr(cls, "interface", "").replace("`", ""):
        ports, names = f"Ports: {interface}", ["input0"]
    else:
        ports, names = _ports_of(cls)
    line = (
        f'A line in: {{"port": "{names[0]}", "data": ...}}, or the bare data where there is one in-port.'
        if names
        else ""
    )
    return "\n\n".join(part for part in (first, more, line, ports) if part)


def _ports_of(cls: type[Component]) -> tuple[str, list[str]]:
    """A table of the ports that the class declares, and the names of the in-ports."""
    ports = [port for port in declaration_of(cls).ports if port.direction in _WORDS]
    rows = [(_WORDS[port.direction], port.name, port.type, port.unit or "", port.doc) for port in ports]
    return f"\b\nPorts:\n{table(rows) or '  none'}", [port.name for port in ports if port.direction == "in"]


# -- options -----------------------------------------------------------------------------------------------------------


def _from_table(table: Iterable[Any]) -> list[click.Option]:
    return [
        click.Option(
            [*option.flags, f"option{number}"],
            multiple=option.kind != "flag",  # one that stands there twice is refused, and not half of it forgotten
            required=option.required,
            help=option.help,
            shell_complete=completer_of(option.flags),
            metavar=None if option.kind == "flag" else "TEXT" if option.kind != "number" else "NUMBER",
            **_without_value(option),
        )
        for number, option in enumerate(table)
    ]


def _without_value(option: Any) -> dict[str, Any]:
    """For click: whether an option has a value, or may have one."""
    if bare := getattr(option, "bare", ""):
        return {"is_flag": False, "flag_value": bare}
    # None, not False: with False click takes a value that begins with "-" for the next option.
    return {"is_flag": True if option.kind == "flag" else None}


def _from_parameters(cls: type[Component]) -> list[click.Option]:
    return [
        click.Option([_flag(name), f"param_{name}"], help=_told(parameter.spec), metavar="VALUE")
        for name, parameter in construct(cls, "draft").params.items()
    ]


def _told(spec: Any) -> str:
    """What a parameter is, its type, default and range."""
    default = plain(spec.default)
    unit = f" {spec.unit}" if spec.unit else ""
    rules = (spec.type_text, f"default {default if default != '' else repr(default)}{unit}", str(spec.constraint))
    return f"{spec.doc} [{'; '.join(filter(None, rules))}]".strip()


def _chosen(table: Iterable[Any], given: Mapping[str, Any]) -> tuple[dict[str, Any], list[Any], str]:
    """Parameters, actions to do instead of running, and the modules that define types."""
    values: dict[int, Any] = {}
    actions, modules = [], ""
    for number, option in enumerate(table):
        value = given[f"option{number}"]
        if value in (None, False, ()):
            continue
        if option.kind not in ("flag", "repeat"):
            if len(value) > 1:
                raise ConfigurationError(f"{option.flags[-1]}: given {len(value)} times; give it once")
            value = value[0]
        if option.action:
            actions.append(option)
        elif option.param:
            values[number] = value
        elif "--type-mod" in option.flags:
            modules = value
    params = option_params(table, values)
    params |= {
        name.removeprefix("param_"): value
        for name, value in given.items()
        if value is not None and name.startswith("param_")
    }
    return params, actions, modules


# -- running -----------------------------------------------------------------------------------------------------------


def _run(cls: type[Component], table: Iterable[Any], given: Mapping[str, Any], common: Mapping[str, Any]) -> int:
    try:
        params, actions, modules = _chosen(table, given)
        import_types(modules)
        _check(cls, table, params)
        for option in actions:
            click.echo(getattr(cls, option.action)(**params))
        if actions:
            return 0
    except AiortsError as error:
        report_error(error, verbose=False)
        return 2
    filter_ = _Filter(cls, params, common.get("count"), Ends(common.get("codec")))
    debug = common["debug"]
    options = checked(
        Options(common.get("loop", "auto"), common.get("duration"), verbose=debug, debug=debug, tell_drops=True)
    )
    stopper = Stopper()
    with stopper.signals():
        return execute(filter_.make, 1, options, stopper) or filter_.status


def _check(cls: type[Component], table: Iterable[Any], params: Mapping[str, Any]) -> None:
    """ConfigurationError names the option whose value its parameter does not take."""
    flags = {option.param: option.flags[-1] for option in table}
    draft = construct(cls, "draft")
    for name, value in params.items():
        try:
            draft.params.check({name: value})
        except ConfigurationError as error:
            cause = str(error).removeprefix(f"draft.{name} = ")
            cause = cause.rpartition("; ")[0] if cause.endswith(" kept") else cause
            raise ConfigurationError(f"{flags.get(name, _flag(name))} {cause}") from None


def _flag(parameter: str) -> str:
    return f"--{parameter.replace('_', '-')}"


class _Filter:
    """The system of one component, standard input and standard output."""

    def __init__(self, cls: type[Component], params: Mapping[str, Any], count: int | None, ends: Ends) -> None:
        self._cls = cls
        self._ends = ends
        self._params = params
        self._count = count
        self._input: StandardInput | FrameInput | None = None
        self._failed = False

    @property
    def status(self) -> int:
        """1 when a line was bad or the component went to error."""
        return int(self._failed or (self._input is not None and self._input.bad > 0))

    async def make(self, kernel: Kernel) -> None:
        """Build it, readers before writers."""
        component = await kernel.create(self._cls, **self._params)
        ins = {port.name: port.type for port in component.ports.values() if isinstance(port, InPort)}
        outs = {port.name: port.type for port in component.ports.values() if isinstance(port, OutPort)}
        kernel.bus.subscribe(StateChanged, lambda event: self._watch(kernel, event, component.name))
        parts: list[Component] = [component]
        if outs:
            sink = await kernel.add(self._ends.sink(outs, count=self._count, done=kernel.request_stop))
            for name in outs:
                await kernel.connect(component.ports[name], sink.ports[name], **_WAYS)
            parts.insert(0, sink)
        if ins:
            count = None if outs else self._count
            ordered = bool(getattr(component, "in_line_order", False))
            shown = [port for port in component.ports.values() if isinstance(port, OutPort)]

            def held_up() -> bool:
                return any(connector.unread for port in shown for connector in port.connectors)

            how = {"count": count, "ordered": ordered, "held_up": held_up}
            self._input = await kernel.add(self._ends.source(ins, _complain, **how))
            # One that takes what it can pair leaves the rest, and must not keep us from reading what that waits for.
            ways = _WAYS if ordered or len(ins) == 1 else {**_WAYS, "length": _LONGEST}
            for name in ins:
                await kernel.connect(self._input.ports[name], component.ports[name], **ways)
            if (skip_bad := getattr(component, "skip_bad", None)) is not None:
                skip_bad(self._input.refused)
            parts.append(self._input)
            _tell_terminal(ins)
        for part in parts:
            await kernel.start(EventContext(), part, activate=True)

    def _watch(self, kernel: Kernel, event: StateChanged, name: str) -> None:
        if event.component in (name, "stdin", "stdout") and event.new is LifeCycleState.ERROR:
            self._failed = True
            kernel.request_stop()


def _complain(number: int, why: str) -> None:
    report("E-LINE", f"standard input, line {number}: {why}")


def _tell_terminal(ins: Mapping[str, type]) -> None:
    if sys.stdin is not None and sys.stdin.isatty():
        ports = ", ".join(f"{name} ({type_name(cls)})" for name, cls in ins.items())
        click.echo(f"aiorts: reading JSON lines for {ports} from this terminal; Ctrl-D ends", err=True)
