"""Describes the machine of a table of figures: commit, Python, processor, load. None means unknown."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from aiorts import __version__

_FOLDER = Path(__file__).resolve().parent


def describe() -> dict[str, Any]:
    """The computer and the software on it, as plain data."""
    return {
        "commit": _commit(),
        "aiorts": __version__,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()}",
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "load": _load(),
        "packages": {name: _version(name) for name in ("anyio", "uvloop")},
    }


def line(machine: Mapping[str, Any]) -> str:
    """The description that `describe` gave, in one line."""
    load = machine["load"]
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items() if number)
    parts = (
        f"aiorts {machine['aiorts']}, commit {machine['commit'] or 'unknown'}",
        machine["python"],
        packages,
        f"{machine['cpu'] or 'unknown processor'}, {machine['cores']} cores",
        machine["system"],
        f"load {' '.join(f'{number:.2f}' for number in load)}" if load else "load unknown",
    )
    return "; ".join(part for part in parts if part)


def _commit() -> str | None:
    """The commit that this file belongs to; None for a copy installed inside another repository."""
    if _git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return None
    return _git("describe", "--always", "--dirty", "--abbrev=12")


def _git(*words: str) -> str | None:
    try:
        # safe.directory: git refuses the checkout of another user, as in a container.
        done = subprocess.run(  # noqa: S603 - fixed words, no shell
            ["git", "-c", "safe.directory=*", *words],  # noqa: S607 - the user's own git; only reads
            cwd=_FOLDER,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _cpu() -> str | None:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or None
    for entry in text.splitlines():
        key, _, value = entry.partition(":")
        if key.strip() in ("model name", "Model"):
            return value.strip()
    return platform.machine() or None


def _load() -> list[float] | None:
    try:
        return [round(number, 2) for number in os.getloadavg()]
    except (OSError, AttributeError):
        return None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
