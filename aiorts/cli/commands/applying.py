"""`aiorts apply`: changes a running system into that of a file, whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.showing import json_option, timeout_option
from aiorts.cli.commands.live.target import Running, complete_kernels, is_file, kernels
from aiorts.cli.commands.planning import check_steps, parts_of, say_planned, say_steps, wanted_of
from aiorts.cli.console.choices_option import choices_options
from aiorts.cli.console.output import say, say_json
from aiorts.errors import SystemFileError
from aiorts.sessions import change_all
from aiorts.system import Choices

if TYPE_CHECKING:
    from aiorts.model.wanted.entries import Wanted

_SHOWN: Final = 10
_LEFT_OFF: Final = (
    "interrupted: a change that has not begun is given up, one that has begun goes on; "
    "`aiorts plan {file} --live KERNEL` shows which"
)


@click.command(short_help="Change a system that runs into that of a file.")
@click.argument("words", metavar="[KERNEL=]SYSTEM.toml...", nargs=-1, required=True)
@click.option(
    "--live", default="", metavar="KERNEL", help="The kernel, where several run.", shell_complete=complete_kernels
)
@click.option(
    "--window",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="S",
    help="Measure S seconds before the change and S after it; it must not do worse.",
)
@click.option("--dry-run", is_flag=True, help="Print the steps and change nothing, as aiorts plan --live.")
@click.option("--force", is_flag=True, help="Also where the file has none of the kernel's components: all are removed.")
@click.option("--set", "changes", multiple=True, metavar="COMPONENT.PARAM=VALUE", help="Set a parameter of the file.")
@choices_options
@timeout_option(30.0, "Wait S seconds, and twice the window")
@json_option("One JSON document: the steps, and what became of them.")
def apply(
    words: tuple[str, ...],
    live: str,
    window: float,
    dry_run: bool,
    force: bool,
    changes: tuple[str, ...],
    choices: Choices,
    timeout: float,
    as_json: bool,
) -> int:
    """Change the system that runs in KERNEL into that of SYSTEM.toml, whole or not at all.

    What is equal in both is not touched. A step that fails is taken back with those before it. With --window all is
    taken back when the system does worse afterwards: a component in error, overruns or drops more than before, rates
    lower; the figure is named. Exit status: 0 when the system is that of the file, 1 when it was taken back, 2 when it
    was refused and nothing was done. With --dry-run it is that of aiorts plan.

    Several words KERNEL=SYSTEM.toml change several kernels, all or none: they are kept when each has changed. A kernel
    that is lost while all are asked to keep it is named, and what was kept in the others.
    """
    pairs = [_pair(word, live) for word in words]
    if len(pairs) > 1:
        if window or dry_run or changes:
            raise click.UsageError("with several kernels there is no --window, --dry-run and --set")
        return _together(pairs, choices, timeout, force=force, as_json=as_json)
    ((live, file),) = pairs
    wanted = wanted_of(file, changes, choices)
    parts = parts_of(wanted)
    with kernels(changing=not dry_run, right="code") as found:
        running = found.kernel(live.rstrip("/"))
        client = running.client
        planned = client.call("plan", timeout, wanted=parts)
        check_steps(planned["steps"], file, changes, choices)
        if dry_run or planned["refused"]:
            return say_planned(planned, as_json=as_json)
        if not force:
            _check_meant(running, file, wanted, planned["steps"])
        if window and planned["steps"]:
            click.echo(f"aiorts: measured for {window:g} s before the change, and after it", err=True)
        try:
            done = client.call("apply", timeout + 2 * window, wanted=parts, window=window)
        except KeyboardInterrupt:
            click.echo(f"aiorts: {_LEFT_OFF.format(file=file)}", err=True)
            raise
    if as_json:
        say_json(done)
    else:
        say_steps(done["steps"])
        for note in done["notes"]:
            say(f"not as it was: {note}")
        say(_outcome(done["steps"], done["rolled_back"], window))
    return exits.DONE if done["done"] else exits.FAILED


def _check_meant(running: Running, file: Path, wanted: Wanted, steps: Iterable[Mapping[str, Any]]) -> None:
    """Raise SystemFileError where the file has none of the kernel's components: it may be meant for another kernel."""
    gone = [step["component"]["name"] for step in steps if step["step"] == "Remove"]
    if gone and wanted.components.keys().isdisjoint(running.names["components"]):
        shown = ", ".join(gone[:_SHOWN]) + (", ..." if gone[_SHOWN:] else "")
        raise SystemFileError(
            f"{file}: has none of the components of {running.name} (process {running.client.entry.pid}), and would "
            f"remove all of them: {shown}; if it is meant for this kernel, give --force"
        )


def _pair(word: str, live: str) -> tuple[str, Path]:
    """The kernel and the file in a word KERNEL=FILE; a word without "=", or with a file before it, is a file."""
    kernel, equals, file = word.partition("=")
    if not equals or is_file(kernel):
        return live, Path(word)
    if live:
        raise click.UsageError(f"--live {live}: {word} names its kernel")
    return kernel, Path(file)


def _together(pairs: list[tuple[str, Path]], choices: Choices, timeout: float, *, force: bool, as_json: bool) -> int:
    if unnamed := [str(file) for kernel, file in pairs if not kernel]:
        raise click.UsageError(f"{unnamed[0]}: of several files each needs its kernel: KERNEL={unnamed[0]}")
    wanted = [(kernel, file, wanted_of(file, (), choices)) for kernel, file in pairs]
    with kernels(changing=True, right="code") as found:
        meant = [(found.kernel(kernel.rstrip("/")), parts_of(one)) for kernel, _, one in wanted]
        if len({id(one) for one, _ in meant}) < len(meant):
            raise click.UsageError("a kernel is named twice")
        for (one, parts), (_, file, entries) in zip(meant, wanted, strict=True):
            planned = one.client.call("plan", timeout, wanted=parts)
            check_steps(planned["steps"], file, (), choices)
            if planned["refused"]:
                raise SystemFileError(f"{one.name}: {'; '.join(planned['refused'])}")
            if not force:
                _check_meant(one, file, entries, planned["steps"])
        try:
            outcome = change_all(meant, timeout)
        except KeyboardInterrupt:
            names = ", ".join(one.name for one, _ in meant)
            click.echo(f"aiorts: interrupted: each of {names} has its system of before or the new one, whole", err=True)
            raise
    if as_json:
        kept = {name: list(steps) for name, steps in outcome.kept.items()}
        say_json({"kept": kept, "failed": outcome.failed, "why": outcome.why, "unsure": list(outcome.unsure)})
    else:
        for name, steps in outcome.kept.items():
            for step in steps:
                say(f"{name}: {step['sign']} {step['text']}")
        say(outcome.text)
    return exits.FAILED if outcome.failed else exits.DONE


def _outcome(steps: list[object], rolled_back: str, window: float) -> str:
    if rolled_back:
        return f"taken back: {rolled_back}"
    if not steps:
        return "no difference"
    return f"kept after {window:g} s" if window else "done"
