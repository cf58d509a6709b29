"""`aiorts doctor`: checks whether this computer can run systems, and prints remedies.

Each finding is "ok", a "note" (it works and could be better) or a "problem" (something will not work). The checks
really use what they check: they wait for timers, request scheduling classes and write files.
"""

from __future__ import annotations

import os
import platform
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib import metadata
from typing import Final

import click

from aiorts import Catalogue, ExternalContext, Kernel, RealtimeContext, __version__, exits, run
from aiorts.cli.console.output import say, say_json, table
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.errors import AiortsError
from aiorts.late import dataclass
from aiorts.sessions import kernels

OK, NOTE, PROBLEM = "ok", "note", "problem"
_SLEEPS: Final = 100
_SLEEP: Final = 0.002
_GOOD: Final = 0.0005
"""Seconds of lateness beyond which a period of 2 ms is not kept."""
_ANSWERS: Final = 5.0
"""Seconds that a kernel, which may be busy, has to answer."""
_TRIED: Final = ((3, 11), (3, 13))
_LEAST_DESCRIPTORS: Final = 256
_FOR_DEVELOPERS: Final = ("test", "dev", "all")


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the output. `verdict` is "ok", "note" or "problem"; `remedy` is "" where there is nothing to do."""

    what: str
    verdict: str
    found: str
    remedy: str = ""


@click.command(short_help="Check this computer, and print remedies.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
def doctor(as_json: bool) -> int:
    """Look at Python, the event loop, kernels that run, timers, real-time privileges, extras, plugins and limits.

    Each line is ok, a note (it works and could be better) or a problem. Exit status 1 when there is a problem.
    """
    found = list(findings())
    problems = sum(one.verdict == PROBLEM for one in found)
    if as_json:
        say_json({"aiorts": __version__, "findings": [asdict(one) for one in found], "problems": problems})
        return exits.FAILED if problems else exits.DONE
    rows = []
    for one in found:
        rows.append((one.verdict, one.what, one.found))
        if one.remedy:
            rows.append(("", "", f"-> {one.remedy}"))
    say(table(rows, indent=""))
    notes = sum(one.verdict == NOTE for one in found)
    say(f"\n{_count(problems, 'problem')}, {_count(notes, 'note')}; aiorts {__version__}")
    return exits.FAILED if problems else exits.DONE


def findings() -> Iterator[Finding]:
    """All findings, in the order of the lines."""
    for look in _LOOKS:
        yield from look()
    yield from _plugins()


def _count(number: int, what: str) -> str:
    return f"{number or 'no'} {what}{'' if number == 1 else 's'}"


# -- the interpreter and what is installed -----------------------------------------------------------------------------


def _python() -> Iterator[Finding]:
    low, high = _TRIED
    version = f"{platform.python_implementation()} {platform.python_version()}"
    tried = f"aiorts is tested on CPython {low[0]}.{low[1]} to {high[0]}.{high[1]}"
    if sys.version_info[:2] < low:
        yield Finding("Python", PROBLEM, version, f"{tried}; install one of them")
    elif sys.version_info[:2] > high or platform.python_implementation() != "CPython":
        yield Finding("Python", NOTE, version, tried)
    else:
        yield Finding("Python", OK, version)
    found = f"{platform.system()} {platform.release()} {platform.machine()}, {_processors()} processors"
    yield Finding("system", *((OK, found) if sys.platform == "linux" else (NOTE, found, "aiorts is tested on Linux")))


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except (AttributeError, OSError):
        return os.cpu_count() or 1


def _packages() -> Iterator[Finding]:
    """Check dependencies and extras, from the package metadata of aiorts."""
    try:
        wanted = metadata.requires("aiorts") or []
    except metadata.PackageNotFoundError:
        yield Finding("package", NOTE, "aiorts is run from its sources, without metadata", "pip install -e .")
        return
    extras: dict[str, list[str]] = {}
    for requirement in wanted:
        name = re.split(r"[^A-Za-z0-9_.-]", requirement, maxsplit=1)[0]
        marked = re.search(r"extra *== *['\"]([^'\"]+)['\"]", requirement)
        if marked is None:
            if name != "uvloop":
                yield _dependency(name)
        elif name != "aiorts":
            extras.setdefault(marked[1], []).append(name)
    for extra, names in sorted(extras.items()):
        if extra in _FOR_DEVELOPERS:
            continue
        missing = [name for name in names if _version(name) is None]
        if missing:
            found = f"without {', '.join(missing)}"
            yield Finding(f"extra {extra}", NOTE, found, f'pip install "aiorts[{extra}]", if you want it')
        else:
            yield Finding(f"extra {extra}", OK, ", ".join(f"{name} {_version(name)}" for name in names))


def _dependency(name: str) -> Finding:
    version = _version(name)
    if version is None:
        return Finding(name, PROBLEM, "is not installed", f"pip install {name}")
    return Finding(name, OK, version)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _plugins() -> Iterator[Finding]:
    catalogue = catalogue_of()
    count = 0
    clashes = []
    for kind in Catalogue.KINDS:
        for name, offers in catalogue.extensions(kind).items():
            count += 1
            if len(offers) > 1:
                sources = " and ".join(one.source for one in offers)
                clashes.append(Finding("plugins", PROBLEM, f"{kind.removesuffix('s')} {name}: {sources}", "remove one"))
    yield Finding("plugins", OK, f"{count} extensions; aiorts plugins --check imports each")
    yield from clashes
    for problem in catalogue.problems:
        yield Finding("plugins", PROBLEM, f"{problem.source}: {problem.reason}", "repair or remove it")


# -- time --------------------------------------------------------------------------------------------------------------


def _loop() -> Iterator[Finding]:
    version = _version("uvloop")
    try:
        import uvloop  # noqa: F401 - whether it can be

        yield Finding("event loop", OK, f"uvloop {version}")
    except ImportError as error:
        found = "asyncio" if version is None else f"asyncio; uvloop {version} cannot be loaded: {error}"
        yield Finding("event loop", NOTE, found, "pip install uvloop: wake-ups take half the time")


def _timers() -> Iterator[Finding]:
    lateness = run(_sleep_often)
    median, worst = statistics.median(lateness), max(lateness)
    found = f"{_SLEEPS} sleeps of 2 ms ended {median * 1e6:.0f} us late (median), {worst * 1e3:.2f} ms at worst"
    if median <= _GOOD:
        yield Finding("timers", OK, found)
    else:
        yield Finding("timers", NOTE, found, "periods below 10 ms will not be kept; is this computer busy or virtual?")


async def _sleep_often() -> list[float]:
    """Measure the lateness of many sleeps on a kernel's clock, in seconds."""
    lateness = []
    async with Kernel() as kernel:
        for _ in range(_SLEEPS):
            began = time.perf_counter()
            await kernel.sleep(_SLEEP)
            lateness.append(time.perf_counter() - began - _SLEEP)
    return lateness


def _realtime() -> Iterator[Finding]:
    """Check the real-time privileges by requesting them for a context, as a running system does."""
    try:
        priority, locked, denied = run(_request_realtime)
    except (AiortsError, OSError) as error:
        yield Finding("real time", NOTE, f"no real-time context can run: {error}", "use PeriodicContext")
        return
    if priority is not None:
        yield Finding("real time", OK, f"SCHED_FIFO {priority} is granted")
    if locked:
        yield Finding("memory lock", OK, "memory can be kept resident")
    names = {"priority": "real time", "memory lock": "memory lock"}
    for what, reason in denied.items():
        cause, _, remedy = reason.partition("; ")
        yield Finding(names.get(what, "real time"), NOTE, cause, remedy)


async def _request_realtime() -> tuple[int | None, bool, dict[str, str]]:
    async with Kernel() as kernel:
        context = RealtimeContext(rate=100.0)
        await kernel.start(context)
        granted = context.granted
        return granted.priority, granted.locked, dict(granted.denied)


def _cycle() -> Iterator[Finding]:
    """Check that a kernel opens, ticks a context and closes, as every system does."""
    try:
        run(_tick_once)
    except (AiortsError, OSError) as error:
        yield Finding("kernel", PROBLEM, f"cannot run: {type(error).__name__}: {error}", "see aiorts help errors")
    else:
        yield Finding("kernel", OK, "opens, ticks a context and closes")


async def _tick_once() -> None:
    async with Kernel() as kernel:
        context = ExternalContext()
        await kernel.start(context)
        await context.tick()


def _running() -> Iterator[Finding]:
    """List the risks that the running kernels of this user report."""
    try:
        with kernels(_ANSWERS, right="view") as found:
            for one in found.running:
                for said in one.names.get("risks", ()):
                    risk, _, remedy = said.partition("; ")
                    yield Finding(f"kernel {one.name}", NOTE, risk, remedy)
    except AiortsError as error:
        yield Finding("kernels", NOTE, f"those that run cannot be asked: {error}", "aiorts ls")


# -- terminal and limits -----------------------------------------------------------------------------------------------


def _terminal() -> Iterator[Finding]:
    encoding = getattr(sys.stdout, "encoding", None) or "none"
    where = "a terminal" if sys.stdout is not None and sys.stdout.isatty() else "no terminal"
    found = f"standard output is {where}, encoding {encoding}, TERM={os.environ.get('TERM', '') or '(not set)'}"
    if encoding.lower().replace("-", "").replace("_", "") in ("utf8", "cp65001"):
        yield Finding("terminal", OK, found)
    else:
        yield Finding("terminal", NOTE, found, "export PYTHONUTF8=1; until then other letters are printed as numbers")


def _limits() -> Iterator[Finding]:
    try:
        import resource
    except ImportError:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    found = f"{_limit(soft)} of at most {_limit(hard)} may be open"
    if soft != resource.RLIM_INFINITY and soft < _LEAST_DESCRIPTORS:
        yield Finding("files", NOTE, found, "ulimit -n 4096: every process, pipe and socket takes one")
    else:
        yield Finding("files", OK, found)


def _limit(number: int) -> str:
    return "any number" if number < 0 or number >= 1 << 62 else str(number)


def _folder() -> Iterator[Finding]:
    try:
        with tempfile.TemporaryFile() as file:
            file.write(b"aiorts")
            file.flush()
        yield Finding("temp folder", OK, tempfile.gettempdir())
    except OSError as error:
        found = f"cannot be written to: {error.strerror or error}"
        yield Finding("temp folder", PROBLEM, found, "make room, or set TMPDIR to a folder that can be written to")


_LOOKS: Final[tuple[Callable[[], Iterator[Finding]], ...]] = (
    _python,
    _packages,
    _loop,
    _cycle,
    _running,
    _timers,
    _realtime,
    _terminal,
    _limits,
    _folder,
)
