"""Files of Python as syntax trees, for tests that read them."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def many_objects() -> Iterator[None]:
    """Look for no garbage while trees are made and gone through: there is none, and looking takes most of the time."""
    looked = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if looked:
            gc.enable()


def parse(path: Path) -> ast.Module:
    """The tree of a file."""
    with many_objects():
        return ast.parse(path.read_text(encoding="utf-8"), str(path))


def nodes(tree: ast.AST) -> list[ast.AST]:
    """All nodes of a tree, as `ast.walk` gives them; a second time they are at hand."""
    found: list[ast.AST] | None = getattr(tree, "all_nodes", None)
    if found is None:
        found = [tree]
        with many_objects():
            for node in found:
                for value in vars(node).values():
                    if isinstance(value, ast.AST):
                        found.append(value)
                    elif isinstance(value, list):
                        found += [one for one in value if isinstance(one, ast.AST)]
        tree.all_nodes = found  # type: ignore[attr-defined]
    return found


def statements(tree: ast.AST) -> list[ast.stmt]:
    """All statements of a tree, wherever they stand: far fewer than its nodes."""
    inside = [
        child for name in ("body", "orelse", "finalbody", "handlers", "cases") for child in getattr(tree, name, ())
    ]
    found: list[ast.stmt] = []
    for node in inside:
        if isinstance(node, ast.stmt):
            found.append(node)
        found += statements(node)
    return found


def dotted(node: ast.AST) -> str:
    """`a.b.c` as text; of what is no such name its last part, with a point before it."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""
