"""`aiorts bench startup`: fresh interpreters that import aiorts, show its help, and run a first system."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from aiorts_bench.harness import child
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import Aim, Case, Measure, Reading
from aiorts_bench.harness.report import Report

TIME: Final = Measure("time", "ms", digits=1)
FORBIDDEN: Final = ("numpy", "uvloop", "click", "msgpack", "asyncio")
"""Modules that `import aiorts` alone must not load."""
_LOADED: Final = f"import sys, aiorts; print(*sorted({{*{FORBIDDEN!r}}} & sys.modules.keys()))"

_KERNEL: Final = "from aiorts import Kernel"
_AIORTS: Final = ("-m", "aiorts")
_COMPONENT: Final = """\
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble


class Source(Component):
    out = OutPort(TimedDouble)

    async def on_execute(self) -> None:
        await self.out.write(TimedDouble(0, 1.0))
        self.finish()


class Sink(Component):
    inp = InPort(TimedDouble)

    async def on_execute(self) -> None:
        print("first sample", self.inp.read_nowait().data, flush=True)
        self.kernel.request_stop()
"""
_SYSTEM: Final = """\
schema = 1
[components.source]
type = "parts.py:Source"
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "source.out"
to = "sink.inp"
[contexts.loop]
kind = "periodic"
rate = 1000.0
members = ["source"]
[contexts.events]
kind = "event"
members = ["sink"]
"""


def _once(words: Sequence[str], wanted: str | None, folder: Path, count: int) -> Reading:
    """Run `count` fresh interpreters one after the other; each has to print `wanted`, unless that is None."""
    total, faults = 0, []
    for _ in range(count):
        try:
            elapsed, output = child.timed(words, cwd=folder)
        except OSError as error:
            return Reading({TIME.name: 0.0}, faults=(str(error),))
        total += elapsed
        if wanted is not None and wanted not in output:
            faults.append(f"python {' '.join(words)[:40]}: expected {wanted!r}, got {output[:60]!r}")
    return Reading({TIME.name: total / count / 1e6}, count, faults=tuple(faults))


def loaded() -> tuple[str, ...]:
    """The modules of `FORBIDDEN` that `import aiorts` loads in a fresh interpreter."""
    return tuple(child.run(["-c", _LOADED], timeout=30.0).split())


def cases(folder: Path) -> tuple[Case, ...]:
    """The cases; writes a small system file into `folder`."""
    (folder / "parts.py").write_text(_COMPONENT, encoding="utf-8")
    (folder / "system.toml").write_text(_SYSTEM, encoding="utf-8")
    click = "import click"
    rows: tuple[tuple[str, str, Sequence[str], str | None, tuple[Aim, ...]], ...] = (
        ("python -c pass", "bare interpreter", ["-c", "pass"], None, ()),
        (click, "the library of the command line", ["-c", "import click"], None, ()),
        ("import asyncio", "what any asyncio program imports", ["-c", "import asyncio"], None, ()),
        ("import aiorts", "names are imported on use", ["-c", "import aiorts"], None, (Aim("python -c pass"),)),
        (_KERNEL, "with the kernel", ["-c", _KERNEL], None, (Aim("import asyncio", factor=1.7),)),
        (
            "aiorts --help",
            "the command",
            [*_AIORTS, "--help"],
            "Components are commands, too",
            (Aim(click, factor=1.3),),
        ),
        ("aiorts --version", "the command", [*_AIORTS, "--version"], "aiorts", (Aim(click, factor=1.3),)),
        (
            *("first sample", "aiorts run of a system file with two components, to its end after one sample"),
            *([*_AIORTS, "run", "system.toml"], "first sample 1.0", (Aim("import asyncio"),)),
        ),
        (
            "filter",
            "aiorts flexiconst -p TimedDouble -c 6.2 --count 1, to its end",
            [*_AIORTS, "flexiconst", "-p", "TimedDouble", "-c", "6.2", "--count", "1"],
            "6.2",
            (Aim("import asyncio", factor=3.5),),
        ),
    )
    return tuple(
        Case(name, what, TIME, partial(_once, words, wanted, folder), 1, aims)
        for name, what, words, wanted, aims in rows
    )


def report(options: Options) -> Report:
    """Measure every start."""
    with tempfile.TemporaryDirectory(prefix="aiorts-bench-") as folder:
        rows = options.rows(cases(Path(folder)))
    found = loaded()
    note = f"import aiorts loads {', '.join(found) if found else 'none of ' + ', '.join(FORBIDDEN)}"
    how = "From the start of a fresh interpreter to its end, compiled modules in place, one after the other."
    return options.report("startup", rows, notes=(note,), how=how)


BENCH: Final = Bench(
    "startup",
    "New interpreters: importing aiorts, its command, and the first sample of a system file.",
    report,
    quick_rounds=9,
    rounds=25,
    full_scale=1.0,
    loops=False,
)
