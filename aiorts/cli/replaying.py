"""`aiorts replay FILE [SYSTEM]`: replays a recording in place of components of a system, or alone.

It is the same as `aiorts run SYSTEM --replay FILE`, or as the filter `aiorts flexilogger -o -l FILE`.
"""

from __future__ import annotations

import math
from typing import Any

import click

from aiorts.cli.commands.offered import filter_named
from aiorts.cli.commands.run import run
from aiorts.cli.console.completion import targets
from aiorts.cli.console.plugins_option import catalogue_of
from aiorts.cli.group import strict


def _speed(text: str) -> float:
    number = math.inf if text == "max" else float(text)
    if not (0.1 <= number <= 1000.0 or number == math.inf):
        raise ValueError(text)
    return number


@click.command(short_help="Replay a recording, alone or in a system.")
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.argument("system", metavar="[SYSTEM.toml]", required=False, shell_complete=targets)
@click.option(
    "--port",
    "ports",
    multiple=True,
    metavar="PORT",
    help="Replay this port; repeatable. By default all; in SYSTEM all of components whose out-ports were all recorded.",
)
@click.option("--start", default="", metavar="T", help="From +SECONDS after its first sample, or seconds since 1970.")
@click.option("--end", default="", metavar="T", help="Up to there, without it.")
@click.option("--speed", type=_speed, metavar="X", help="0.1 to 1000 times as fast, or max.")
@click.option("--rate", type=click.FloatRange(min=0, min_open=True), metavar="HZ", help="Samples in a second.")
@click.option("--loop", type=click.IntRange(min=0), metavar="N", help="N times; 0 is without end.")
@click.option(
    "--max-gap", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Wait so long at most in a gap."
)
@click.option("--absolute", is_flag=True, help="Time stamps as recorded, in place of the time now.")
@click.option("--for", "duration", type=float, metavar="S", help="End after S seconds.")
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="With SYSTEM: set a parameter.")
@click.option("--print", "printed", multiple=True, metavar="PORT", help="With SYSTEM: print samples of this out-port.")
@click.option("--simulate", is_flag=True, help="With SYSTEM: run in virtual time.")
@click.option("--name", metavar="NAME", help="Without SYSTEM: let other terminals reach it by this name.")
def replay(
    file: str,
    system: str | None,
    ports: tuple[str, ...],
    changes: tuple[str, ...],
    printed: tuple[str, ...],
    duration: float | None,
    simulate: bool,
    absolute: bool,
    name: str | None,
    **given: Any,
) -> Any:
    """Replay a recording, in the place of the components of SYSTEM that sent it, or alone.

    In SYSTEM a component whose out-ports were all recorded is not started: its samples are sent in its place, and none
    of its hooks runs, nor a method of its services. Others run, and answer. --port names COMPONENT.PORT, with * and ?:
    these alone are replayed, also where the component has others, which then send nothing. It ends when every sample is
    read, and at the latest 60 s after the recording, or as long after it as it took. `aiorts run SYSTEM --replay FILE`
    is the same, with all options of a run.

    Alone it prints the samples as JSON lines, which go into filters, and other terminals see its ports with --name:
    `aiorts flexilogger -o` is the same.

    \b
      aiorts replay run.mcap system.toml --port "tank.*"
      aiorts replay run.mcap --speed 10 | aiorts flexidump -p TimedDouble
    """
    if name is not None and system is not None:
        raise click.UsageError("--name is for a replay alone; a system is reached by the name of its file")
    if system is None and (changes or printed or simulate):
        raise click.UsageError("--set, --print and --simulate need a SYSTEM to run; name its file after the recording")
    given = {key.replace("_", "-"): value for key, value in given.items() if value not in (None, "")}
    common = [] if duration is None else [f"--for={duration!r}"]
    ctx = click.get_current_context()
    parent = ctx.parent or ctx
    if system is not None:
        words = [system, f"--replay={file}", *common, *(f"--set={one}" for one in changes)]
        words += [*(f"--print={one}" for one in printed), *(f"--replay-port={one}" for one in ports)]
        words += ["--replay-absolute"] * absolute + ["--simulate"] * simulate
        words += [f"--replay-{key}={value}" for key, value in given.items()]
        with strict(run).make_context("run", words, parent=parent) as inner:
            return run.invoke(inner)
    command = filter_named("flexilogger", catalogue_of())
    if command is None:
        raise click.UsageError("the component FlexiLogger, which replays, is not installed")
    if given.get("speed") == math.inf:
        given["speed"] = "max"
    words = ["-o", "-l", file, *common, *(f"--{key}={value}" for key, value in given.items())]
    words += [f"--ports={','.join(ports)}"] * bool(ports) + ["--absolute"] * absolute
    words += [] if name is None else [f"--name={name}"]
    with strict(command).make_context("replay", words, parent=parent) as inner:
        return command.invoke(inner)
