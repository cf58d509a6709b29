"""Completion of words for running kernels on the command line; `aiorts.sessions` resolves the words."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import Any

import click

from aiorts import sessions
from aiorts.sessions import (
    FILES,
    PATIENCE,
    Entry,
    Found,
    Kernels,
    RightName,
    Running,
    fitting,
    is_file,
    is_glob,
    likely,
    offered,
    outlines,
    sharing,
    the_one,
)

__all__ = (
    "FILES",
    "Found",
    "Kernels",
    "Running",
    "complete",
    "complete_changes",
    "complete_fitting",
    "complete_kernels",
    "complete_params",
    "complete_systems",
    "complete_types",
    "is_file",
    "is_glob",
    "kernels",
    "sharing",
    "the_one",
)


def kernels(
    timeout: float = 1.0,
    select: Callable[[Entry], bool] | None = None,
    *,
    changing: bool = False,
    right: RightName = "",
) -> AbstractContextManager[Kernels]:
    """Open sessions as `aiorts.sessions.kernels`; the default right is "operate" with `changing`, else "view"."""
    wanted = right or ("operate" if changing else "view")
    return sessions.kernels(timeout, select, changing=changing, right=wanted)


def complete(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete names of what runs: components, their ports after a dot, kernels with a slash."""
    return _items(likely(incomplete), incomplete)


def complete_fitting(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete the ports that fit the port typed before; where none fits, any port, since links may reach others."""
    before = [word for word in ctx.params.get(param.name or "") or () if "=" not in word]
    return _items((before and fitting(before[0], incomplete)) or likely(incomplete), incomplete)


def complete_types(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete types of components that running kernels can create, and files where no type fits."""
    from click.shell_completion import CompletionItem

    return _items(offered(), incomplete) or [CompletionItem(incomplete, type="file")]


def complete_params(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete PARAM= for the type that the command names."""
    return _items((f"{name}=" for name in offered().get(str(ctx.params.get("type_")), ())), incomplete)


def complete_kernels(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete names of kernels."""
    with kernels(PATIENCE) as found:
        return _items((one.name for one in found.running), incomplete)


def complete_systems(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete names of kernels, and files where no kernel fits."""
    from click.shell_completion import CompletionItem

    return complete_kernels(ctx, param, incomplete) or [CompletionItem(incomplete, type="file")]


def complete_changes(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
    """Complete PARAM= for the component that the command names."""
    with kernels(PATIENCE) as found:
        said = outlines(found, str(ctx.params.get("name") or ""))
        return _items((f"{name}=" for one in said for name in one["params"]), incomplete)


def _items(words: Iterable[str], incomplete: str) -> list[Any]:
    from aiorts.cli.console.completion import items

    return items(dict.fromkeys(words), incomplete)
