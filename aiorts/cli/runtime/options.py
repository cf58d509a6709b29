"""How a system is run, as values: what the command line says, checked before anything is loaded."""

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
    """How a system is run."""

    loop: str = "auto"
    duration: float | None = None
    """Seconds of the system's time after which it ends."""
    verbose: bool = False
    """Short for the log level info."""
    debug: bool = False
    """Tracebacks, and a kernel that checks threads and copies samples."""
    simulate: bool = False
    speed: float | None = None
    lenient: bool = False
    """A component that ended in error does not make the exit status 3."""
    log_level: str = ""
    """As `levels_of` reads it."""
    log_file: Path | None = None
    log_format: str = "text"
    """"text" or "json"."""
    tell_drops: bool = False
    """Tell of every sample that a connection was to deliver and did not."""
    post_mortem: bool = False
    """With `debug`: a debugger where a component failed, where a person sits at a terminal."""
    status: bool = False
    """Show what the system does in one line, where standard error is a terminal."""


@dataclass(frozen=True, slots=True)
class Levels:
    """From which level on a line of the log is shown: as logging counts them, 10 is debug and 50 critical."""

    default: int
    components: Mapping[str, int]

    @property
    def lowest(self) -> int:
        """What somebody may want to see."""
        return min((self.default, *self.components.values()))

    def of(self, component: str) -> int:
        """The level of a component; of everything else for ""."""
        return self.components.get(component, self.default)

    def check(self, known: Collection[str]) -> None:
        """Click's error for a component that the system does not have."""
        for name in self.components:
            if name not in known:
                raise _bad(f"no component {name[:60]!r} in this system; {suggestion(name, known)}")


def checked(options: Options) -> Options:
    """The options, or click's error for one that has no meaning."""
    for name, flag in (("speed", "--speed"), ("duration", "--for")):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise click.BadParameter(f"{value!r}: expected a number above 0", param_hint=flag)
    if options.simulate and options.speed is not None:
        raise click.UsageError("--speed has no meaning with --simulate, which runs as fast as it can")
    levels_of(options)
    return options


def levels_of(options: Options) -> Levels:
    """What `--log-level warning,pid0=debug`, `-v` and `--debug` ask for; click's error for any other word."""
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
    """The options with the clock of a system file, where the command line says nothing of it."""
    if options.simulate or options.speed is not None:
        return options
    return replace(options, simulate=clock.kind == "simulated", speed=clock.speed)
