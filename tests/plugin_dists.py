"""Small distributions, installed for the test: modules and a dist-info folder in a folder that is on the path."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

__all__ = ("COMPONENT", "install", "project")

COMPONENT = "from aiorts import Component\nclass Good(Component):\n    '''A component.'''\n"
"""The text of a module that is in order."""


def install(
    site: Path, name: str, modules: Mapping[str, str], entries: Mapping[str, str], *, version: str = "1.0"
) -> None:
    """Put a distribution into `site`.

    Args:
        modules: text by module name.
        entries: target by "kind/NAME", as in {"components/Good": "good:Good"}.
    """
    site.mkdir(parents=True, exist_ok=True)
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [
        f"[aiorts.{kind}]\n{offered} = {target}\n"
        for kind, _, offered, target in ((*key.partition("/"), value) for key, value in entries.items())
    ]
    (info / "entry_points.txt").write_text(_joined(lines))
    (info / "RECORD").write_text("")


def _joined(sections: list[str]) -> str:
    """Sections with the same head as one."""
    found: dict[str, list[str]] = {}
    for section in sections:
        head, line = section.splitlines()
        found.setdefault(head, []).append(line)
    return "\n".join("\n".join((head, *lines)) for head, lines in found.items()) + "\n"


def project(folder: Path, name: str, modules: Mapping[str, str], entries: Mapping[str, str]) -> Path:
    """Make a plugin that is not installed: a folder with a `pyproject.toml`; `entries` as for `install`."""
    folder.mkdir(parents=True, exist_ok=True)
    for module, text in modules.items():
        (folder / f"{module}.py").write_text(text)
    groups: dict[str, list[str]] = {}
    for key, target in entries.items():
        kind, _, offered = key.partition("/")
        groups.setdefault(kind, []).append(f'"{offered}" = "{target}"\n')
    text = f'[project]\nname = "{name}"\n'
    text += "".join(f'[project.entry-points."aiorts.{kind}"]\n{"".join(lines)}' for kind, lines in groups.items())
    (folder / "pyproject.toml").write_text(text)
    return folder
