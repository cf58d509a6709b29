"""The options of `aiorts run` that services offer; services are imported only for help and for an unknown option."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import click

from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.cli.runtime.target import is_file
from aiorts.errors import AiortsError
from aiorts.kernel.extensions.arguments import OPTION_TYPES, flags_of, option_flag
from aiorts.kernel.service import load_service
from aiorts.model.declared import Option, options_of
from aiorts.system import Choices, load

_KEY: Final = "aiorts.service options"
"""The key under which a click context keeps the options by service, once they were looked up."""
_ARGS: Final = "aiorts.arguments"
"""The key under which a click context keeps the arguments of the command line, which lead to plugins."""


class RunCommand(click.Command):
    """A command with the options of services, which are looked up for its help or for an unknown option."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The command's own parameters, and those of services that were looked up."""
        found: Mapping[str, list[click.Option]] = ctx.meta.get(_KEY, {})
        return [*super().get_params(ctx), *(option for options in found.values() for option in options)]

    def make_parser(self, ctx: click.Context) -> Any:
        """Wrap click's parser: an option that it does not know may be a service's."""
        parser: Any = super().make_parser(ctx)
        parse = parser.parse_args

        def parse_args(args: list[str]) -> Any:
            ctx.meta[_ARGS] = tuple(args)
            try:
                return parse(list(args))
            except click.NoSuchOption:
                ctx.meta[_KEY], faults = _found(args, super(RunCommand, self).get_params(ctx))
            try:
                return super(RunCommand, self).make_parser(ctx).parse_args(args)
            except click.NoSuchOption as error:
                if fault := faults.get(error.option_name):
                    raise click.UsageError(fault, ctx) from None
                raise

        vars(parser)["parse_args"] = parse_args
        return parser

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the command's own options, and those of each service under the service's name."""
        ctx.meta.pop(_KEY, None)
        super().format_options(ctx, formatter)
        found, faults = _found(ctx.meta.get(_ARGS, ()), super().get_params(ctx))
        for name, options in found.items():
            rows = [row for option in options if (row := option.get_help_record(ctx)) is not None]
            with formatter.section(f"Options of the service {name}"):
                formatter.write_dl(rows)
        if faults:
            with formatter.section("Options of services that cannot be used"):
                formatter.write_dl(list(faults.items()))


def chosen(given: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Take the settings of services out of the given parameters; returns them by service."""
    found: dict[str, dict[str, Any]] = {}
    for word in [word for word in given if "." in word]:
        value = given.pop(word)
        if value not in (None, ()):
            service, _, key = word.partition(".")
            found.setdefault(service, {})[key] = value
    return found


def option_faults(service: str, settings: type, own: Iterable[click.Parameter]) -> dict[str, str]:
    """The faults, by flag, of a service's options that cannot be options of a command with the options `own`."""
    return _sorted_out({service: settings}, own)[1]


def _found(args: Iterable[str], own: Iterable[click.Parameter]) -> tuple[dict[str, list[click.Option]], dict[str, str]]:
    """The options of each service that has some, and the faults of unusable options by flag.

    The services are those of installed packages, and of the folders that `args` lead to.
    """
    catalogue = catalogue_of(_folders(list(args)))
    settings = {}
    for name in catalogue.extensions("services"):
        try:
            settings[name] = load_service(catalogue.find("services", name)).settings
        except AiortsError:
            continue  # `aiorts plugins --check` reports its fault
    return _sorted_out(settings, own)


def _sorted_out(
    settings: Mapping[str, type], own: Iterable[click.Parameter]
) -> tuple[dict[str, list[click.Option]], dict[str, str]]:
    """The usable options by service, and the faults of the others by flag."""
    owners = {flag: ["`aiorts run` itself"] for option in own for flag in _flags(option)}
    faults: dict[str, str] = {}
    made: dict[str, list[click.Option]] = {}
    for service, cls in settings.items():
        kinds = flags_of(cls)
        for name, kind in kinds.items():
            one = options_of(cls)[name]
            if kind is None:
                flag = option_flag(service, name, one)
                faults[flag] = f"{flag}: {name} of the service {service} cannot be an option: use {OPTION_TYPES}"
                continue
            option = _option(service, name, one, kind)
            made.setdefault(service, []).append(option)
            for flag in _flags(option):
                owners.setdefault(flag, []).append(f"{name} of the service {service}")
    twice = {flag: f"{flag} is of {' and of '.join(who)}; rename one" for flag, who in owners.items() if len(who) > 1}
    usable = {
        service: left
        for service, options in made.items()
        if (left := [option for option in options if not twice.keys() & {*_flags(option)}])
    }
    return usable, {**faults, **twice}


def _flags(option: click.Parameter) -> tuple[str, ...]:
    return (*option.opts, *option.secondary_opts) if isinstance(option, click.Option) else ()


def _folders(args: Sequence[str]) -> list[Path]:
    """The plugin folders of a command line: those after --plugins, and those of a system file."""
    folders = [Path(word) for word in _after("--plugins", args)]
    for word in args:
        if is_file(word):
            try:
                folders += load(word, (), Choices(tuple(_after("--var", args)))).plugin_paths
            except AiortsError:
                continue  # the run reports its errors
    return folders


def _after(option: str, args: Sequence[str]) -> Iterator[str]:
    """The values of an option, written as "--option VALUE" or "--option=VALUE"."""
    yield from (after for word, after in pairwise(args) if word == option)
    yield from (word.removeprefix(f"{option}=") for word in args if word.startswith(f"{option}="))


def _option(service: str, name: str, one: Option, kind: Any) -> click.Option:
    flag, several = option_flag(service, name, one), kind is tuple
    if isinstance(kind, tuple):
        kind = click.Choice(kind)
    elif kind is bool:
        flag, kind = f"{flag}/--no-{flag[2:]}", None
    elif several:
        kind = str
    option = click.Option([flag], type=kind, multiple=several, help=one.described, default=None)
    option.name = f"{service}.{name}"  # not the name of an argument: `chosen` takes it out
    return option
