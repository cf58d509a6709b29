"""Completion of words on the command line, by click's protocol: what is offered for which word, and shell scripts.

It is asked at every press of a key: nothing is imported beyond what the word needs, and whatever is wrong offers
nothing and says nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import click
from click.shell_completion import CompletionItem, get_completion_class

from aiorts.cli.output import say

__all__ = ("completer_of", "completes", "completion", "items", "subjects", "targets", "type_names")

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
SHELLS: Final = ("bash", "zsh", "fish")
_VARIABLE: Final = "_AIORTS_COMPLETE"
_OF_TYPES: Final = frozenset(("-i", "-o", "-p", "--inputport", "--outputport", "--port", "--selection-type"))
"""Options of components that take a record type, or one with a number behind it."""
_WHERE: Final = {
    "bash": 'eval "$(aiorts completion bash)" in ~/.bashrc',
    "zsh": 'eval "$(aiorts completion zsh)" in ~/.zshrc, after compinit',
    "fish": "aiorts completion fish > ~/.config/fish/completions/aiorts.fish",
}


def items(words: Iterable[str] | Mapping[str, Any], incomplete: str) -> list[CompletionItem]:
    """Those of the words that begin so."""
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


def type_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Record types."""
    from aiorts.types import all_types

    return items(dict.fromkeys(full.rpartition(".")[2] for full in all_types()), incomplete)


def subjects(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Components by name, record types, and files where neither begins so."""
    from aiorts import Catalogue

    found = items(Catalogue.default().extensions("components"), incomplete) + type_names(ctx, param, incomplete)
    return found or [CompletionItem(incomplete, type="file")]


def targets(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Components by name, and files where none begins so."""
    from aiorts import Catalogue

    found = items(Catalogue.default().extensions("components"), incomplete) if incomplete else []
    return found or [CompletionItem(incomplete, type="file")]


def completer_of(flags: Iterable[str]) -> Complete | None:
    """What completes the value of a component's option with these flags; None is what click does of itself."""
    return type_names if _OF_TYPES.intersection(flags) else None


def completes() -> bool:
    """Whether a shell asks for completions, and no command is to be run."""
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
    return 0
