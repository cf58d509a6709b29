"""The options of a run as values: from the command line, checked before anything is loaded."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

import click

from aiorts.late import dataclass
from aiorts.spelling import suggestion
from aiorts.system import ClockEntry

_NAMES: Final = ("debug", "info", "warning", "error", "critical")
_LEVELS: Final[Mapping[str, int]] = {name: getattr(logging, name.upper()) for name in _NAMES}


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a run."""

    loop: str = "auto"
    duration: float | None = None
    """Seconds of the system's time after which the run ends."""
    verbose: bool = False
    """Whether the log level is info, where none is given."""
    debug: bool = False
    """Whether tracebacks are printed, and the kernel checks threads and copies samples."""
    simulate: bool = False
    speed: float | None = None
    lenient: bool = False
    """Whether a component that ended in error leaves the exit status as it is, not 3."""
    log_level: str = ""
    """The levels in the form that `levels_of` reads."""
    log_file: Path | None = None
    log_format: str = "text"
    """"text" or "json"."""
    tell_drops: bool = False
    """Whether each sample is reported that a connection should have delivered and did not."""
    post_mortem: bool = False
    """Whether `debug` opens a debugger where a component failed, if a person sits at a terminal."""
    status: bool = False
    """Whether a status line is shown, where standard error is a terminal."""


@dataclass(frozen=True, slots=True)
class Levels:
    """The lowest levels of shown log lines, in the numbers of logging: 10 is debug and 50 critical."""

    default: int
    components: Mapping[str, int]

    @property
    def lowest(self) -> int:
        """The lowest level of all."""
        return min((self.default, *self.components.values()))

    def of(self, component: str) -> int:
        """The level of a component; "" is everything else."""
        return self.components.get(component, self.default)

    def check(self, known: Collection[str]) -> None:
        """Raise click's error for a component that the system does not have."""
        for name in self.components:
            if name not in known:
                raise _bad(f"no component {name[:60]!r} in this system; {suggestion(name, known)}")


def checked(options: Options) -> Options:
    """Check the options; click's error for one that has no meaning."""
    for name, flag in (("speed", "--speed"), ("duration", "--for")):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise click.BadParameter(f"{value!r}: expected a number above 0", param_hint=flag)
    if options.simulate and options.speed is not None:
        raise click.UsageError("--speed has no meaning with --simulate, which runs as fast as it can")
    levels_of(options)
    return options


def levels_of(options: Options) -> Levels:
    """The levels of `--log-level warning,pid0=debug`, `-v` and `--debug`; click's error for any other word."""
    default = logging.DEBUG if options.debug else logging.INFO if options.verbose else logging.WARNING
    components = {}
    stated = False
    for part in filter(None, (part.strip() for part in options.log_level.split(","))):
        name, equals, word = (text.strip() for text in part.rpartition("="))
        level = _LEVELS.get(word.lower())
        if level is None:
            raise _bad(f"no level {word[:60]!r}; {suggestion(word.lower(), _LEVELS)}")
        if not equals:
            if stated:
                raise _bad(f"{part!r} is a second level for all; write COMPONENT={word} for one component")
            default, stated = level, True
        elif not name or name in components:
            why = "stands there twice" if name else "is missing"
            raise _bad(f"{part!r}: the component's name {why}; write COMPONENT=LEVEL, such as pid0=debug")
        else:
            components[name] = level
    return Levels(default, MappingProxyType(components))


def _bad(what: str) -> click.BadParameter:
    return click.BadParameter(what, param_hint="--log-level")


def with_clock(options: Options, clock: ClockEntry) -> Options:
    """The options with the clock of a system file, where the command line gives none."""
    if options.simulate or options.speed is not None:
        return options
    return replace(options, simulate=clock.kind == "simulated", speed=clock.speed)
