"""Completion of words on the command line, by click's protocol, and the shell scripts for it.

It runs at each press of the Tab key: it imports only what the word needs, and offers nothing after any error.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import click
from click.shell_completion import CompletionItem, get_completion_class

from aiorts import exits
from aiorts.cli.console.output import say

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
SHELLS: Final = ("bash", "zsh", "fish")
_VARIABLE: Final = "_AIORTS_COMPLETE"
_OF_TYPES: Final = frozenset(("-i", "-o", "-p", "--inputport", "--outputport", "--port", "--selection-type"))
"""Options of components that take a record type, also with a number after it."""
_WHERE: Final = {
    "bash": 'eval "$(aiorts completion bash)" in ~/.bashrc',
    "zsh": 'eval "$(aiorts completion zsh)" in ~/.zshrc, after compinit',
    "fish": "aiorts completion fish > ~/.config/fish/completions/aiorts.fish",
}


def items(words: Iterable[str] | Mapping[str, Any], incomplete: str) -> list[CompletionItem]:
    """The completions: the words that begin with the incomplete one."""
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def type_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete record types."""
    import aiorts.types.ros  # noqa: F401 - loaded late
    from aiorts.kernel.extensions.finders import declared_types
    from aiorts.types import all_types

    names = (*all_types(), *declared_types())
    return items(dict.fromkeys(full.rpartition(".")[2] for full in names), incomplete)


def subjects(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete components by name, record types, and files where neither fits."""
    from aiorts import Catalogue

    found = items(Catalogue.default().extensions("components"), incomplete) + type_names(ctx, param, incomplete)
    return found or [CompletionItem(incomplete, type="file")]


def targets(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete components by name, and files where none fits."""
    from aiorts import Catalogue

    found = items(Catalogue.default().extensions("components"), incomplete) if incomplete else []
    return found or [CompletionItem(incomplete, type="file")]


def completer_of(flags: Iterable[str]) -> Complete | None:
    """The completion function for the value of a component's option with these flags; None is click's own."""
    return type_names if _OF_TYPES.intersection(flags) else None


def completes() -> bool:
    """Whether a shell asks for completions, so that no command runs."""
    return _VARIABLE in os.environ


@click.command(short_help="Print the script that completes words in your shell.")
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> int:
    """Print the script with which SHELL completes aiorts's commands, components, options, types and files.

    \b
    bash: eval "$(aiorts completion bash)" in ~/.bashrc
    zsh:  eval "$(aiorts completion zsh)" in ~/.zshrc, after compinit
    fish: aiorts completion fish > ~/.config/fish/completions/aiorts.fish
    """
    found = get_completion_class(shell)
    assert found is not None  # noqa: S101 - one of SHELLS, which click has
    complete = found(click.Command("aiorts"), {}, "aiorts", _VARIABLE)
    say(f"# {_WHERE[shell]}\n{complete.source_template % complete.source_vars()}")
    return exits.DONE
