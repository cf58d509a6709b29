"""Run any component as a Unix filter: `aiorts flexifilter -i TimedDouble ...` reads JSON lines and writes JSON lines.

The options are those of the class attribute `options`, else one for each parameter. In-ports are fed from standard
input and out-ports written to standard output, with back-pressure throughout, so that no line is lost. A component
without in-ports is a source, and runs in the context that fits it.
"""

from __future__ import annotations

import contextlib
import inspect
import shlex
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts import Component, EventContext, InPort, Kernel, declaration_of, exits
from aiorts.cli.console.completion import completer_of
from aiorts.cli.console.output import plain, table
from aiorts.cli.console.report import report, report_error
from aiorts.cli.runtime.alone import (
    DEFAULT_RATE,
    check_rate,
    connect_input,
    connect_live,
    connect_output,
    context_for,
    end_with,
    outs_of,
)
from aiorts.cli.runtime.ends import Ends
from aiorts.cli.runtime.options import Options, checked
from aiorts.cli.runtime.session import Run, execute, log_of
from aiorts.cli.runtime.stopping import Stopper
from aiorts.errors import AbsentError, AiortsError, ComponentError, ConfigurationError, WiringError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.extensions.type_modules import import_types
from aiorts.kernel.service import plan_service
from aiorts.planning import ACTIVE, Setting, setting_alone
from aiorts.system import FrameInput, LiveInput, StandardInput, construct, option_params
from aiorts.types import type_name

if TYPE_CHECKING:
    from aiorts.sessions import Stream

_WORDS: Final = {"in": "in ", "out": "out"}
_STREAMS: Final = ("stdin", "stdout")
_OURS: Final = (
    click.Option(["--count"], type=click.IntRange(min=1), metavar="N", help="End after N samples."),
    click.Option(["--for", "duration"], type=float, metavar="S", help="End after S seconds."),
    click.Option(
        ["--rate"], type=float, metavar="HZ", help=f"Run it periodically; {DEFAULT_RATE:g} when it has no in-port."
    ),
    click.Option(["--name"], metavar="NAME", help="Let other terminals reach it by this name."),
    click.Option(
        ["--connect"], metavar="[KERNEL/]COMPONENT.PORT", help="Take the samples of what runs, and no standard input."
    ),
    click.Option(["--loop"], type=click.Choice(["auto", "uvloop", "asyncio"]), default="auto", help="The event loop."),
    click.Option(["--codec"], metavar="NAME", help="Binary frames of this codec in place of JSON lines."),
    click.Option(["--debug"], is_flag=True, help="Print the component's log, and tracebacks."),
)


def command_of(name: str, cls: type[Component]) -> click.Command:
    """Make the command that runs a component of this class."""
    table = getattr(cls, "options", None)
    own = _from_table(table) if table is not None else [*_from_parameters(cls), *_from_sets(cls)]
    taken = {flag for option in own for flag in option.opts}
    ours = [option for option in _OURS if not taken.intersection(option.opts)]

    def run(**given: Any) -> int:
        common = {option.name: given.pop(str(option.name)) for option in ours}
        return _run(cls, table or (), given, common)

    return _FilterCommand(name, callback=run, params=[*own, *ours], help=_help(cls), no_args_is_help=False)


class _FilterCommand(click.Command):
    """A command that accepts `--loop=-1`: a negative value for an option whose value may be omitted. The error for
    `--set PARAM=VALUE`, an option of `aiorts run`, names the filter's option of that parameter.
    """

    def make_parser(self, ctx: click.Context) -> Any:
        """Wrap click's parser, which would read -1 as an option, and the option before it as one without a value."""
        parser: Any = super().make_parser(ctx)
        parse = parser.parse_args
        beginnings = tuple(f"{flag}=-" for one in self.params if one.callback is _stripped for flag in one.opts)

        def parse_args(args: list[str]) -> Any:
            try:
                return parse([word.replace("=", "= ", 1) if word.startswith(beginnings) else word for word in args])
            except click.NoSuchOption as error:
                if error.option_name != "--set":
                    raise
                raise click.UsageError(f"--set is of `aiorts run`; {self._instead(args)}", ctx) from None

        vars(parser)["parse_args"] = parse_args
        return parser

    def _instead(self, args: list[str]) -> str:
        """The hint that names the option to write in place of `--set PARAM=VALUE`."""
        after = " ".join(args).partition("--set")[2].lstrip(" =").split(" ")[0]
        name, _, value = after.partition("=")
        name = name.rpartition(".")[2]
        flags = [flag for one in self.params for flag in one.opts if str(one.name).startswith(("param_", "option"))]
        if _flag(name) in flags:
            return f"write {_flag(name)} {shlex.quote(value) if value else 'VALUE'}"
        return f"its parameters are options: {', '.join(flags) or 'it has none'}"


def _stripped(_ctx: click.Context, _option: click.Parameter, values: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(value.strip() for value in values)


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
    """A table of the class's declared ports, and the names of the in-ports."""
    ports = [port for port in declaration_of(cls).ports if port.direction in _WORDS]
    rows = [(_WORDS[port.direction], port.name, port.type, port.unit or "", port.doc) for port in ports]
    return f"\b\nPorts:\n{table(rows) or '  none'}", [port.name for port in ports if port.direction == "in"]


# -- options -----------------------------------------------------------------------------------------------------------


def _from_table(table: Iterable[Any]) -> list[click.Option]:
    return [
        click.Option(
            [*option.flags, f"option{number}"],
            multiple=option.kind != "flag",  # so that an option given twice is refused; click would take the last value
            required=option.required,
            help=option.help,
            shell_complete=completer_of(option.flags),
            metavar=None if option.kind == "flag" else "TEXT" if option.kind != "number" else "NUMBER",
            **_without_value(option),
        )
        for number, option in enumerate(table)
    ]


def _without_value(option: Any) -> dict[str, Any]:
    """The keyword arguments of a click option that has no value, or may have none."""
    if bare := getattr(option, "bare", ""):
        return {"is_flag": False, "flag_value": bare, "callback": _stripped}
    # None, not False: with False click reads a value that begins with "-" as the next option.
    return {"is_flag": True if option.kind == "flag" else None}


def _from_parameters(cls: type[Component]) -> list[click.Option]:
    return [
        click.Option([_flag(name), f"param_{name}"], help=_described(parameter.spec), metavar="VALUE")
        for name, parameter in construct(cls, "draft").params.items()
    ]


def _from_sets(cls: type[Component]) -> list[click.Option]:
    """Make `--active` for a component that declares configuration sets and has no parameter of that name."""
    declared = declarations(cls).configuration
    if len(declared.sets) == 1 or ACTIVE in declared.specs:
        return []
    text = f"The configuration set that is active: {', '.join(declared.sets)}."
    return [
        click.Option(
            [_flag(ACTIVE), f"param_{ACTIVE}"], type=click.Choice(list(declared.sets)), metavar="SET", help=text
        )
    ]


def _described(spec: Any) -> str:
    """The help of a parameter: its text, type, default and range."""
    default = plain(spec.default)
    unit = f" {spec.unit}" if spec.unit else ""
    rules = (spec.type_text, f"default {default if default != '' else repr(default)}{unit}", str(spec.constraint))
    return f"{spec.doc} [{'; '.join(filter(None, rules))}]".strip()


def _chosen(table: Iterable[Any], given: Mapping[str, Any]) -> tuple[dict[str, Any], list[Any], str]:
    """Read the given options; returns parameters, actions that replace a run, and modules that define types."""
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
        check_rate(common.get("rate"))
        setting = _checked(cls, table, params)
        for option in actions:
            click.echo(getattr(cls, option.action)(**params))
        if actions:
            return exits.DONE
    except AiortsError as error:
        report_error(error, verbose=False)
        return exits.FAILED if isinstance(error, ComponentError) else exits.REFUSED
    ends = Ends(common.get("codec"))
    try:
        stream = _tap(common.get("connect"))
    except AiortsError as error:
        report_error(error, verbose=False)
        return exits.of_error(error)
    filter_ = _Filter(cls, setting, common.get("count"), common.get("rate"), ends, stream, common.get("name"))
    debug = common["debug"]
    options = checked(
        Options(common.get("loop", "auto"), common.get("duration"), verbose=debug, debug=debug, tell_drops=True)
    )
    stopper = Stopper()
    stopper.last_words.append(ends.report_rest)
    try:
        with stopper.signals(), log_of(options, stopper) as log:
            return execute(Run(filter_.make, 1, options, stopper, log, streams=_STREAMS)) or filter_.status
    finally:
        ends.report_rest()
        if stream is not None:
            stream.client.close()
            if stream.missed:
                what = f"{stream.began['port']}: {stream.missed} samples were dropped on the way to this process"
                report("W-DROPPED", what)


def _tap(word: str | None) -> Stream | None:
    """Open the stream of the out-port that `--connect` names, in a session of its own."""
    if word is None:
        return None
    from aiorts.cli.commands.live.target import kernels
    from aiorts.sessions import Client

    with kernels() as found:
        one = found.find(word)
        if not one.component or not one.port:
            raise AbsentError(f"--connect {word}: name an out-port, as in COMPONENT.PORT; `aiorts ls -R` has all")
        entry = one.client.entry
    client = Client.open(entry, right="view")
    try:
        stream = client.stream("tap", port=one.path, frames=True)
        client.read_ahead()
        return stream
    except BaseException:
        client.close()
        raise


def _checked(cls: type[Component], table: Iterable[Any], params: Mapping[str, Any]) -> Setting:
    """Check the parameters that the options set; ConfigurationError names the option where a value is refused."""
    flags = {option.param: option.flags[-1] for option in table}
    draft = construct(cls, "draft")
    for name, value in params.items():
        try:
            setting_alone(draft, {name: value})
        except ConfigurationError as error:
            cause = str(error).removeprefix(f"draft.{name} = ")
            cause = cause.rpartition("; ")[0] if cause.endswith(" kept") else cause
            raise ConfigurationError(f"{flags.get(name, _flag(name))} {cause}") from None
    return setting_alone(draft, params)


def _flag(parameter: str) -> str:
    return f"--{parameter.replace('_', '-')}"


class _Filter:
    """A system of one component, standard input and standard output."""

    def __init__(
        self,
        cls: type[Component],
        setting: Setting,
        count: int | None,
        rate: float | None,
        ends: Ends,
        stream: Stream | None,
        name: str | None,
    ) -> None:
        self._cls = cls
        self._rate = rate
        self._ends = ends
        self._setting = setting
        self._count = count
        self._stream = stream
        self._name = name
        self._input: StandardInput | FrameInput | LiveInput | None = None

    @property
    def status(self) -> int:
        """The exit status: 1 after a bad line."""
        return exits.FAILED if self._input is not None and self._input.bad > 0 else exits.DONE

    async def make(self, kernel: Kernel) -> None:
        """Create the components and connect them, readers before writers."""
        if self._name is not None:
            plan_service(kernel.plugins, "control", {"name": self._name}).attach(kernel)
        component = await self._setting.create(kernel, self._cls)
        ins = {port.name: port.type for port in component.ports.values() if isinstance(port, InPort)}
        outs = outs_of(component)
        parts: list[Component] = [component]
        if outs:
            sink = self._ends.sink(outs, count=self._count, done=kernel.request_stop)
            await connect_output(kernel, component, sink)
            parts.insert(0, sink)
        if ins:
            count = None if outs else self._count
            if self._stream is not None:
                self._input = await connect_live(kernel, component, self._ends, self._stream, count=count)
            else:
                self._input = await connect_input(kernel, component, self._ends, count=count)
                _hint_terminal(ins)
            parts.append(self._input)
        elif self._stream is not None:
            raise WiringError(f"--connect: {component.name} has no in-port that samples could come to")
        fit = context_for(component, kernel.plugins, self._rate)
        for part in parts:
            with contextlib.suppress(ComponentError):  # the component is in error, as it would be after a later failure
                await kernel.start(fit if part is component else EventContext(), part, activate=True)
        end_with(kernel, component, self._input)


def _hint_terminal(ins: Mapping[str, type]) -> None:
    if sys.stdin is not None and sys.stdin.isatty():
        ports = ", ".join(f"{name} ({type_name(cls)})" for name, cls in ins.items())
        click.echo(f"aiorts: reading JSON lines for {ports} from this terminal; Ctrl-D ends", err=True)
