"""Running systems for commands that otherwise take a file or a type: their names, profiles and parts."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from aiorts.cli.commands.live.look.named import Named, named
from aiorts.cli.commands.live.target import is_file, kernels, the_one
from aiorts.errors import AbsentError, AiortsError, AmbiguousError, NoAnswerError
from aiorts.sessions import entries

if TYPE_CHECKING:
    from aiorts.observe import SystemProfile

BETWEEN: Final = 0.5
"""Seconds between the two profiles from which rates are computed."""


def is_live(word: str) -> bool:
    """Whether a word that may be a file means a running kernel."""
    return (
        not is_file(word)
        and not word.startswith(".")
        and (word.endswith("/") or not Path(word).exists() or Path(word).is_dir())
    )


def profiles_of(word: str, count: int = 1) -> tuple[str, list[SystemProfile]]:
    """The name of the kernel that a word means, and `count` profiles of it, `BETWEEN` seconds apart.

    Raises:
        AbsentError: nothing that runs has the name, or the name means a part of a kernel.
        AmbiguousError: several things have it.
        NoAnswerError: the kernel does not answer.
    """
    from aiorts.observe import SystemProfile, profile_from_plain

    profiles: list[SystemProfile] = []
    with kernels() as found:
        try:
            one = _one(word, named(found, word))
        except AbsentError as error:
            raise type(error)(f"{error}; a file is written as ./{word} or with its ending") from None
        if one.kind != "kernel":
            raise AbsentError(f"{word}: is a {one.kind}, and no system; write its kernel: {one.running.name}/")
        for number in range(count):
            if number:
                time.sleep(BETWEEN)
            profiles.append(profile_from_plain(SystemProfile, one.running.client.call("profile")))
    return one.full, profiles


def report_of(word: str) -> tuple[Named, Mapping[str, Any]] | None:
    """Find the running thing that a word means; returns it with its report, or None where nothing has the name.

    Raises:
        AmbiguousError: several things have the name.
        AbsentError: the word names a kernel, which has no such thing.
        NoAnswerError: the word names a kernel that does not answer.
    """
    kernel = word.rpartition("/")[0] or word
    if is_file(word) or ":" in word or not (there := entries()):
        return None
    with kernels() as found:
        try:
            one = _one(word, named(found, word))
        except (AbsentError, NoAnswerError) as error:
            if isinstance(error, AmbiguousError) or kernel in {
                name for each in there for name in (each.name, each.address)
            }:
                raise
            return None
        return one, one.report()


def tell_of(word: str, command: str) -> None:
    """Print on standard error that a running thing also has the name, and which command shows that thing."""
    if is_file(word) or not entries():
        return
    with kernels() as found:
        try:
            there = named(found, word)
        except AiortsError:
            return
    click.echo(f"aiorts: {there[0].full} runs, too: `aiorts {command} {there[0].full}` shows it", err=True)


def _one(word: str, found: tuple[Named, ...]) -> Named:
    return the_one(word, found, [each.full for each in found])
