"""A component's command-line options as parameters: on a command line and under `options` in a system file alike.

A class lists its flags in a table `options`; each entry has the attributes `flags`, `param`, `kind` ("text",
"number", "repeat" or "flag"), `value`, `action` and `required`, and may have `words`, values that words stand for, and
`bare`, the value where none is given. A class without a table has one option for each parameter: `--rate-limit` sets
`rate_limit`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from aiorts.errors import ConfigurationError
from aiorts.kernel.declarations import declarations
from aiorts.spelling import suggestion


def parse_options(cls: type[Any], arguments: Sequence[str]) -> dict[str, Any]:
    """The parameters that these arguments set, as a command line would: `-i TYPE`, `--map=TEXT`, `-n`, `--`.

    Raises:
        ConfigurationError: an option does not exist (near ones are named), has no value, or is for a command line
            only.
    """
    table = _table(cls)
    flags = {flag: option for option in table for flag in option.flags}
    given: dict[int, Any] = {}
    rest = list(reversed(arguments))
    while rest:
        argument = rest.pop()
        flag, value = _taken_apart(argument, flags)
        option = flags.get(flag)
        if option is None:
            raise ConfigurationError(_unknown(argument, flags))
        if option.action or not option.param:
            raise ConfigurationError(f"{flag}: is for a command line and has no meaning in a system file; take it away")
        number = table.index(option)
        if option.kind == "flag":
            if value is not None:
                raise ConfigurationError(f"{flag}: takes no value, got {value[:60]!r}; take the value away")
            given[number] = True
            continue
        bare = getattr(option, "bare", "")
        if value is None and bare and (not rest or rest[-1].startswith("-")):
            value = bare
        if value is None:
            if not rest:
                raise ConfigurationError(f"{flag}: its value is missing; write {flag} VALUE")
            value = rest.pop()
        given[number] = (*given.get(number, ()), value) if option.kind == "repeat" else value
    return option_params(table, given)


def flag_of(cls: type[Any], param: str) -> str:
    """The first flag that sets a parameter, "" where none does."""
    return next((str(option.flags[0]) for option in _table(cls) if option.param == param), "")


def option_params(table: Iterable[Any], given: Mapping[int, Any]) -> dict[str, Any]:
    """The parameters that options set; `given` has the values of options by their place in the table."""
    params: dict[str, Any] = {}
    for number, option in enumerate(table):
        value = given.get(number)
        if value is None or value is False or value == () or not option.param:
            continue
        words = getattr(option, "words", {}) if isinstance(value, str) else {}
        params[option.param] = option.value if option.kind == "flag" else words.get(value, value)
    return params


class _Plain:
    """The option of a parameter of a class that has no table of options."""

    kind, action, value, required = "text", "", True, False

    def __init__(self, param: str) -> None:
        self.param = param
        self.flags = (f"--{param.replace('_', '-')}",)


def _table(cls: type[Any]) -> Sequence[Any]:
    table: Sequence[Any] | None = getattr(cls, "options", None)
    return [_Plain(name) for name in declarations(cls).parameters] if table is None else table


def _taken_apart(argument: str, flags: Mapping[str, Any]) -> tuple[str, str | None]:
    """Split `--map=0>0` and `-m0>0` into the flag and its value."""
    if argument in flags:
        return argument, None
    if argument.startswith("--"):
        flag, equals, value = argument.partition("=")
        return flag, value if equals else None
    return (argument[:2], argument[2:]) if argument[:2] in flags else (argument, None)


def _unknown(argument: str, flags: Mapping[str, Any]) -> str:
    if not argument.startswith("-"):
        return f"{argument[:60]!r}: expected an option such as {next(iter(flags), '--name')}"
    return f"no option {argument[:60]!r}; {suggestion(argument.partition('=')[0], flags, shown=str)}"
