"""The target of `aiorts run`: a system file, or one component alone in a context that fits it.

The target is loaded and checked here, before a kernel is opened.
"""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import click

from aiorts import Catalogue, Component, EventContext, Kernel
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.cli.runtime.alone import (
    check_rate,
    connect_input,
    connect_output,
    context_for,
    end_with,
    outs_of,
    takes_data,
)
from aiorts.cli.runtime.ends import Ends
from aiorts.errors import AiortsError, ComponentError, ConfigurationError, SystemFileError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.extensions.type_names import extension_of
from aiorts.kernel.extensions.type_names import shown as in_quotes
from aiorts.kernel.extensions.uninstalled import named_in_project
from aiorts.kernel.service import attach_services, plan_service
from aiorts.late import dataclass
from aiorts.model.options import doubts
from aiorts.planning import Setting, setting_alone
from aiorts.spelling import suggestion
from aiorts.system import (
    AS_WRITTEN,
    Blueprint,
    Choices,
    ClockEntry,
    Finding,
    StandardOutput,
    SystemFile,
    build,
    construct,
    load,
    prepare,
)
from aiorts.system.checks.whole import NOTHING_RUNS
from aiorts.system.text.places import Key

Settings: TypeAlias = Mapping[str, Mapping[str, Any]]
"""The settings of services, by the service's name and the setting's."""
_SYSTEM_CLOCK: Final = ClockEntry()
_INPUT: Final = "stdin"
_OUTPUT: Final = "stdout"
"""The names of the components that read and write the samples of a component alone."""


@dataclass(frozen=True, slots=True)
class Target:
    """A checked target; `make` makes it in a kernel."""

    names: tuple[str, ...]
    """The names of the components."""
    catalogue: Catalogue
    make: Callable[[Kernel], Any]
    clock: ClockEntry = _SYSTEM_CLOCK
    unfed: str = ""
    """The advice for a component alone that waits for data which cannot come."""
    doubts: tuple[str, ...] = ()
    """The warnings about options of a system file that do nothing."""
    streams: tuple[str, ...] = ()
    """The names of the components by which the command feeds and prints a component run alone."""
    ends: Ends | None = None
    """The ends of a component alone that standard input feeds; they report bad lines at the end."""
    plan: Blueprint | None = None
    """The blueprint of a system file; None for a component alone."""
    read: Callable[[], Blueprint] | None = None
    """The function that reads the system file again; None for a component alone."""


def find_target(
    text: str,
    changes: Sequence[str],
    rate: float | None,
    services: Settings,
    choices: Choices = AS_WRITTEN,
    *,
    quiet: bool = True,
    fed: bool = False,
    count: int | None = None,
) -> Target:
    """Load and check the system file or component that `text` names.

    Args:
        changes: parameters as "component.param=value"; for a component alone also "param=value".
        rate: Hz, for a component alone.
        quiet: whether the samples of a component alone are not written to standard output.
        services: the settings from options, by service.
        choices: variables of a system file, and replacements of ports.
        fed: whether a component alone reads standard input.
        count: samples of a component alone after which the run ends: those printed, else those read.

    Raises:
        AiortsError: the target is wrong; the text says how. click.UsageError: options that do not go together.
    """
    if text.endswith(".py") and Path(text).is_file():
        raise ConfigurationError(f"{text}: no system file; {_give_class(Path(text))}")
    if is_file(text):
        if rate is not None:
            raise click.UsageError("--rate is for a component alone; a system file has rate under [contexts.NAME]")
        if count is not None:
            raise click.UsageError("--count is for a component alone; a system file ends with its sources, or by --for")
        return _system(text, changes, services, choices)
    if choices != AS_WRITTEN:
        raise click.UsageError("--var and --remap are for a system file, not for a component alone")
    catalogue = catalogue_of()
    if ":" not in text and text not in catalogue.extensions("components"):
        raise ConfigurationError(f"{in_quotes(text)}: {_no_such(text, catalogue)}")
    cls = extension_of(text, catalogue).load_class(Component)
    return _alone(
        cls, changes, catalogue, rate, _fed_by(text, catalogue.folders), services, shown=not quiet, fed=fed, count=count
    )


def _fed_by(text: str, folders: Sequence[Path]) -> str:
    """The advice how this component gets data."""
    plugins = "".join(f"--plugins {shlex.quote(str(folder))} " for folder in folders)
    return f"feed it JSON lines: ... | aiorts run {plugins}{shlex.quote(text)}"


def is_file(text: str) -> bool:
    """Whether a word of the command line is a system file."""
    if text.endswith(".toml") or not text:
        return True
    try:
        return ":" not in text and Path(text).is_file()
    except (OSError, ValueError):
        return False


def _give_class(path: Path) -> str:
    names = [one.name for one in Catalogue((path.parent,)).defined_in(path)]
    if not names:
        return f"give {path}:CLASS; it has no component"
    return f"give {path}:{names[0] if len(names) == 1 else 'CLASS'}; it has {', '.join(names[:10])}"


def _no_such(text: str, catalogue: Catalogue) -> str:
    components = catalogue.extensions("components")
    try:
        files = [path.name for path in Path().iterdir() if path.suffix == ".toml" and path.name != text]
    except OSError:
        files = []
    # `pid` is also for `pid.toml`, and `flexiconst` for `FlexiConst`.
    alike = (one for one in (*files, *components) if one.lower().removesuffix(".toml") == text.lower())
    hint = named_in_project(text, "components") or suggestion(
        next(alike, text), [*files, *components], "give SYSTEM.toml, FILE.py:Class or package.module:Class"
    )
    return f"no system file and no installed component; {hint}"


def _system(text: str, changes: Sequence[str], services: Settings, choices: Choices) -> Target:
    def read() -> Blueprint:
        return _prepared(text, changes, services, choices)

    plan = read()
    system = plan.system
    return Target(
        (*system.components, *system.composites),
        plan.catalogue,
        lambda kernel: build(kernel, plan),
        system.clock,
        doubts=tuple(f"{system.at(*key, of_key=True)}: {text}" for key, text in _doubts(system)),
        plan=plan,
        read=read,
    )


def _prepared(text: str, changes: Sequence[str], services: Settings, choices: Choices) -> Blueprint:
    try:
        system = load(text, changes, choices)
    except SystemFileError as error:
        if str(error).startswith(f"{text}: --"):
            raise ConfigurationError(str(error)).like(error) from None
        raise
    catalogue = catalogue_of(system.plugin_paths)
    plan = prepare(system, catalogue, _settings(_activated(system), *_program(system), system.services, services))
    if not (system.components or system.composites):
        raise SystemFileError(
            f"{text}: there are no components, and nothing to run; write [components.NAME] with a type"
        )
    if not any(context.members for context in system.contexts.values()):
        raise SystemFileError(f"{system.path}: {NOTHING_RUNS}")
    return plan


def errors_of(
    text: str,
    changes: Sequence[str],
    choices: Choices = AS_WRITTEN,
    *,
    running: bool = False,
) -> tuple[Finding, ...]:
    """Find all errors of the system file that `text` names; none where it is no system file.

    Args:
        running: whether a system runs meanwhile, which owns standard output.
    """
    if not is_file(text) or text.endswith(".py"):
        return ()
    from aiorts.system import check  # late: only a file that cannot run is looked at in this way

    # Components may print when they are made again.
    with contextlib.nullcontext() if running else contextlib.redirect_stdout(sys.stderr):
        found = check(text, changes, catalogue_of().folders, choices)
    wrong = [one for one in found if one.severity == "error"]
    # A mistake on the command line is not reported as an error of the file.
    return tuple(replace(one, code=ConfigurationError.code) if one.where.startswith("--") else one for one in wrong)


def _doubts(system: SystemFile) -> Iterator[tuple[Key, str]]:
    for connection in system.connections:
        for option, text in doubts(connection.options):
            yield ("connections", connection.number - 1, *option.split(".")), f"{connection.place}: {text}"


def _activated(system: SystemFile) -> Sequence[str]:
    """The components that become active when the system is built; where there are none, all members of contexts."""
    members = [(name, context.activate) for context in system.contexts.values() for name in context.members]
    started = [entry.name for entry in system.components.values() if entry.start is not None]
    active = [name for name, activate in members if activate]
    return list(dict.fromkeys((*active, *started))) or [name for name, _ in members]


def _settings(ready: Sequence[str], program: str, runs: str, file: Settings, options: Settings) -> Settings:
    """The settings of services besides those of the file: those of every run, and those from options."""
    always: Settings = {
        "watch_loop": {},
        "supervision": {"ready": ready},
        "control": {"program": program, "runs": runs},
    }
    return {
        name: {key: value for key, value in always.get(name, {}).items() if key not in file.get(name, {})}
        | dict(options.get(name, {}))
        for name in (*always, *options)
    }


def _program(system: SystemFile) -> tuple[str, str]:
    """The default name of a run, and the path of its file.

    The name is that of the file without its ending, or of the folder where the file is called system.toml.
    """
    path = Path(system.path).absolute()
    return path.stem if path.stem != "system" else path.parent.name or path.stem, str(path)


# -- one component -----------------------------------------------------------------------------------------------------


def _alone(
    cls: type[Component],
    changes: Iterable[str],
    catalogue: Catalogue,
    rate: float | None,
    unfed: str,
    services: Settings,
    *,
    shown: bool,
    fed: bool,
    count: int | None,
) -> Target:
    name = cls.__name__.lower()
    draft = construct(cls, name)
    setting = _setting(draft, changes)
    later = "ports_for" in declarations(cls).overrides  # ports that exist once its parameters are set
    sends = outs_of(draft) or later
    fed = fed and (takes_data(draft) or later)
    shown = shown and bool(sends) and (fed or not takes_data(draft))
    if count is not None and not (shown or fed):
        if takes_data(draft):
            raise ConfigurationError(
                f"--count: {name} has in-ports, and standard input is not read (a terminal, /dev/null, or --simulate), "
                "so that no samples are counted; pipe samples into it, or use --for"
            )
        raise ConfigurationError("--count: no samples are printed and none are read; use --for")
    ends = Ends(None) if fed else None
    check_rate(rate)
    plans = [plan_service(catalogue, *one) for one in _settings((name,), name, _runs(cls), {}, services).items()]

    async def make(kernel: Kernel) -> None:
        attach_services(kernel, plans)
        try:
            component = await setting.create(kernel, cls, name)
        except BaseException as error:
            if not (isinstance(error, AiortsError) and str(error).startswith(f"{name}:")):
                error.add_note(name)
            raise
        for service in kernel.services:
            await service.starting()
        context = context_for(component, catalogue, rate)
        if shown and (outs := outs_of(component)):
            sink = StandardOutput(_OUTPUT, outs, count=count, done=kernel.request_stop)
            await connect_output(kernel, component, sink)
            await kernel.start(EventContext(), sink, activate=True)
        source = None
        if ends is not None and takes_data(component):
            read = None if shown and outs_of(component) else count
            source = await connect_input(kernel, component, ends, optional=context.kind != "event", count=read)
        with contextlib.suppress(ComponentError):  # on_activated failed: the component is in error
            await kernel.start(context, component, activate=True)
        if source is not None:
            await kernel.start(EventContext(), source, activate=True)
            end_with(kernel, component, source)

    streams = (*((_INPUT,) if fed else ()), *((_OUTPUT,) if shown else ()))
    return Target((name,), catalogue, make, unfed="" if fed else unfed, streams=streams, ends=ends)


def _runs(cls: type[Component]) -> str:
    """The file and class of a component that runs alone, as the setting `runs` of control names them."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None) or cls.__module__
    return f"{file}:{cls.__qualname__}"


def _setting(draft: Component, changes: Iterable[str]) -> Setting:
    """Check the parameters of `--set` for a component; ConfigurationError names every mistake."""
    params: dict[str, Any] = {}
    name = draft.name
    for text in changes:
        where, equals, value = text.partition("=")
        component, dot, param = where.strip().rpartition(".")
        if not equals or not param:
            raise ConfigurationError(f"--set {text[:80]!r}: expected PARAM=VALUE, such as gain=2.0")
        if dot and component != name:
            raise ConfigurationError(f"--set {text[:80]!r}: the component is called {name!r}; write {param}=VALUE")
        params[param] = value
    return setting_alone(draft, params)
