"""The state of a link has one owner and is assigned in one place; who drives it is small, and waits for events."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import aiorts.links
from aiorts.kernel.service import KernelService
from aiorts.links import Links
from trees import nodes, parse

ROOM = Path(aiorts.links.__file__).parent
MODEL = ROOM.parent / "model" / "links" / "negotiation.py"
MOST = 25
"""Methods of `Links`, without those of every service."""
LOOKUPS = {
    "Ends.writers": "by connector",
    "Ends.readers": "by connector",
    "Ends._there": "by the kernel and the component at the other end",
    "Ends._by_ports": "by the ports at both ends",
    "Ends.by_epoch": "by its epoch",
    "NamedEnds._ends": "by names of two parts",
}
"""Collections of ends: what each is looked up by."""
LOOKS = {"ends.py": 2, "calls.py": 1}
"""Files that call back later by themselves, and how often: a connector at which nobody may listen is looked at until it
was read empty; a kernel that was started anew may connect again by itself before it is offered to; a kernel that did
not bind an interface is asked again."""
PAUSES = ["calls.py", "kernels.py", "reaching.py"]
"""Files with pauses between tries: of what a kernel did not take that is there, and to open a transport."""


def attributes(path: Path) -> Iterator[tuple[str, str]]:
    """Each annotated attribute of a class's instances, with its annotation."""
    for kind in (node for node in nodes(parse(path)) if isinstance(node, ast.ClassDef)):
        for node in nodes(kind):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Attribute):
                yield f"{kind.name}.{node.target.attr}", ast.unparse(node.annotation)


def assigned(path: Path, name: str) -> list[int]:
    """The lines in which an attribute of this name is assigned, or set by its name as text."""
    found = []
    for node in nodes(parse(path)):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign | ast.AugAssign):
            targets = [node.target]
        each = [one for target in targets for one in ast.walk(target)]
        found += [node.lineno for one in each if isinstance(one, ast.Attribute) and one.attr == name]  # type: ignore[attr-defined]
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("setattr", "object.__setattr__"):
            found += [node.lineno for one in node.args if isinstance(one, ast.Constant) and one.value == name]
    return found


@pytest.mark.slow
def test_the_state_of_a_link_is_assigned_in_one_place() -> None:
    lines = [(path.name, line) for path in (*ROOM.glob("*.py"), MODEL) for line in assigned(path, "state")]
    assert [name for name, _ in lines] == [MODEL.name]
    on = next(node for node in nodes(parse(MODEL)) if isinstance(node, ast.FunctionDef) and node.name == "on")
    assert lines[0][1] in range(on.lineno, (on.end_lineno or 0) + 1)
    made = [path.name for path in ROOM.glob("*.py") if re.search(r"\bNegotiation\(", path.read_text(encoding="utf-8"))]
    assert made == ["ends.py"]


@pytest.mark.slow
def test_no_collection_holds_links_by_their_state() -> None:
    held = re.compile(r"(?:set|dict|list|deque|Counter|defaultdict|tuple)\[.*\b(?:LinkEnd|WriterLink|ReaderLink)\b")
    found = {name for path in ROOM.glob("*.py") for name, kind in attributes(path) if held.search(kind)}
    assert found == set(LOOKUPS)


def test_links_has_few_methods() -> None:
    own = {
        name
        for kind in Links.__mro__
        if kind not in KernelService.__mro__
        for name, value in vars(kind).items()
        if callable(value) or isinstance(value, property | staticmethod | classmethod)
    }
    found = sorted(own - {*dir(KernelService)})
    assert len(found) <= MOST, found


@pytest.mark.slow
def test_nothing_looks_again_and_again_whether_something_has_happened() -> None:
    sleeps, later = [], {}
    for path in (*ROOM.glob("*.py"), MODEL):
        calls = [ast.unparse(node.func) for node in nodes(parse(path)) if isinstance(node, ast.Call)]
        sleeps += [path.name for call in calls if re.search(r"(?:^|\.)sleep$", call)]
        if many := sum(call.endswith("kernel.call_later") for call in calls):
            later[path.name] = many
    assert sorted({*sleeps}) == PAUSES
    assert later == {**LOOKS, "ends.py": LOOKS["ends.py"] + 1}  # and the pause of a negotiation
