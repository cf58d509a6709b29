"""`aiorts help`: the help of a command, the meaning of an error code, or a page of the guide."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path
from shutil import get_terminal_size
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.console.codes import CODES
from aiorts.cli.console.output import say, table
from aiorts.cli.console.report import has_colours
from aiorts.spelling import suggestion

_SHOWN: Final = 5
"""The number of places that a search shows."""
_LONGEST_LINE: Final = 90
_NAMES: Final = ("api", "record-types", "flexi")
"""Pages whose headings are public names."""


def _topics(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    from aiorts.cli.console.completion import items
    from aiorts.guide import SECTIONS, pages

    words = ctx.params.get("topic") or ()
    if tuple(words[:1]) == ("errors",):
        return items(CODES, incomplete)
    group = ctx.find_root().command
    names = group.list_commands(ctx) if isinstance(group, click.Group) else []
    return items((*names, "commands", "errors", *SECTIONS, *(page.name for page in pages())), incomplete)


@click.command("help", short_help="Help for a command, an error code or a topic; the guide.")
@click.argument(
    "topic", nargs=-1, metavar="[COMMAND | commands | errors [E-CODE] | TOPIC [HEADING] | NAME]", shell_complete=_topics
)
@click.option("--list", "listed", is_flag=True, help="List the pages of the guide.")
@click.option("--search", metavar="WORDS", help="Find the pages that answer a question.")
@click.option(
    "--save", metavar="FOLDER", type=click.Path(path_type=Path), help="Write the files of the page TOPIC there."
)
@click.option("--serve", is_flag=True, help="Show the guide in a browser, on this machine only.")
@click.option(
    "--port",
    metavar="N",
    type=click.IntRange(0, 65535),
    default=8765,
    show_default=True,
    help="The port that --serve listens on.",
)
@click.pass_context
def help_(
    ctx: click.Context,
    topic: tuple[str, ...],
    listed: bool,
    search: str | None,
    save: Path | None,
    serve: bool,
    port: int,
) -> int:
    """Show the help of COMMAND or the list of all commands, the meaning of an error code, the page TOPIC of the guide
    or a part of it, or what a public NAME of aiorts is.

    \b
    aiorts help run
    aiorts help commands
    aiorts help errors E-LINE
    aiorts help tutorial
    aiorts help policies
    aiorts help policies "full policy"
    aiorts help Rig
    aiorts help --search "slow consumer"
    """
    if search is not None:
        return _search(" ".join([search, *topic]))
    if listed:
        say(_contents())
        return exits.DONE
    if serve:
        from aiorts.guide.server import serve as serve_guide

        return serve_guide(port, say)
    if save is not None:
        return _save(ctx, topic, save)
    root = ctx.find_root()
    if topic and (topic[0] == "errors" or topic[0].upper().startswith(("E-", "W-", "N-"))):
        codes = topic[1:] if topic[0] == "errors" else topic
        say("\n\n".join(_explained(code) for code in codes) if codes else _all_codes())
        return exits.DONE
    command: click.Command = root.command
    if topic == ("commands",):
        return _all_commands(root)
    if topic and isinstance(command, click.Group) and topic[0] not in command.list_commands(ctx):
        return _show(ctx, topic[0], " ".join(topic[1:]))
    context = root
    for name in topic:
        if not isinstance(command, click.Group):
            raise click.UsageError(f"{context.command_path} has no commands below it", ctx)
        found_name, found, _ = command.resolve_command(context, [name])
        if found is None:
            raise click.UsageError(f"no command {name[:60]!r}", ctx)
        context = click.Context(found, parent=context, info_name=found_name)
        command = found
    say(command.get_help(context))
    return exits.DONE


def _all_commands(root: click.Context) -> int:
    group: Any = root.command
    formatter = root.make_formatter()
    group.format_all(formatter)
    say(formatter.getvalue().strip("\n"))
    return exits.DONE


def _show(ctx: click.Context, name: str, heading: str) -> int:
    """Print the page of this name or its part below a heading, the contents of a section, or a public name's entry.

    Raises:
        UsageError: nothing has this name or heading.
    """
    from aiorts.guide import SECTIONS, entries, headings, page, pages, rendered

    if name.lower() in SECTIONS and not heading:
        say(_contents(name.lower()))
        return exits.DONE
    found = page(name)
    if found is not None:
        shown = entries(found.text, heading) if heading else [found.text]
        names = headings(found.text)
        otherwise = f"aiorts help {found.name} shows the page"
    else:
        named = [one for one in pages() if one.name in _NAMES]
        shown = next((below for one in named if (below := entries(one.text, " ".join([name, heading]).strip()))), [])
        root = ctx.find_root().command
        commands = root.list_commands(ctx) if isinstance(root, click.Group) else []
        names = dict.fromkeys([*commands, *(one.name for one in pages()), *headings(named[0].text)], "")
        otherwise = "aiorts help commands lists commands, aiorts help --list topics"
    if not shown:
        wanted = heading if found else name
        known = {one.lower(): one for full in reversed(names) for one in (full, full.rpartition(".")[2])}
        hint = suggestion(wanted.lower(), known, otherwise, shown=known.__getitem__)
        what = f"{found.name} has no heading" if found else "no command, error code, topic or public name"
        raise click.UsageError(f"{what} {wanted[:60]!r}; {hint}", ctx)
    coloured = has_colours(sys.stdout)
    width = get_terminal_size().columns
    click.echo("\n\n".join(rendered(text, width, bold=coloured) for text in shown), color=coloured)
    return exits.DONE


def _contents(*only: str) -> str:
    from aiorts.guide import SECTIONS, pages

    parts = []
    for section in only or SECTIONS:
        title, _ = SECTIONS[section]
        rows = [(page.name, page.title) for page in pages() if page.section == section]
        parts.append(f"{title}\n{table(rows)}")
    return "\n\n".join(
        [*parts, "aiorts help TOPIC shows a page; --search WORDS finds, --serve shows all in a browser."]
    )


def _search(question: str) -> int:
    from aiorts.guide import search

    hits = search(question)
    if not hits:
        raise click.UsageError(f"no page has a word of {question[:60]!r}; aiorts help --list shows all pages")
    for hit in [hit for hit in hits if 2 * hit.score >= hits[0].score][:_SHOWN]:
        line = hit.line if len(hit.line) <= _LONGEST_LINE else f"{hit.line[: _LONGEST_LINE - 3]}..."
        place = hit.page.title if hit.heading == hit.page.title else f"{hit.page.title}: {hit.heading}"
        say(f"aiorts help {hit.page.name}   {place}\n    {line}")
    return exits.DONE


def _save(ctx: click.Context, topic: tuple[str, ...], folder: Path) -> int:
    from aiorts.guide import blocks, page

    found = page(topic[0]) if len(topic) == 1 else None
    if found is None:
        raise click.UsageError("--save FOLDER writes the files of one page: aiorts help TOPIC --save FOLDER", ctx)
    files = {block.title: block.text for block in blocks(found.text) if block.title}
    if not files:
        raise click.UsageError(f"the page {found.name} has no files", ctx)
    there = [name for name in files if (folder / name).exists()]
    if there:
        raise click.UsageError(f"{folder / there[0]} exists already; nothing was written", ctx)
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
        say(str(folder / name))
    return exits.DONE


def _all_codes() -> str:
    wide = max(map(len, CODES)) + 2
    width = max(get_terminal_size().columns, wide + 30)
    lines = [
        textwrap.fill(one.meaning, width, initial_indent=f"{code:{wide}}", subsequent_indent=" " * wide)
        for code, one in sorted(CODES.items())
    ]
    return "\n".join(lines) + ("\n\naiorts help errors E-CODE shows its usual cause and what to do.")


def _explained(code: str) -> str:
    one = CODES.get(code.upper())
    if one is None:
        hint = suggestion(code.upper(), CODES, "aiorts help errors lists them", shown=str)
        raise click.UsageError(f"no error code {code[:60]!r}; {hint}")
    return f"{code.upper()}: {one.meaning}\n  cause   {one.cause}\n  remedy  {one.remedy}"
