"""The marks of tests, read from their sources; nothing is imported or run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from tiers import ALONE, FIRST
from trees import parse

TESTS = Path(__file__).parent
REPORTS = TESTS.parent / "build" / "reports"
"""Where tables that are made of marks are written; git does not see it."""


def _marks_of(node: ast.AST, kind: str) -> list[Any]:
    """What stands in the marks of a kind in one expression: `row(1, 2)`."""
    found: list[Any] = []
    for part in ast.walk(node):
        if isinstance(part, ast.Call) and isinstance(part.func, ast.Attribute) and part.func.attr == kind:
            found += [argument.value for argument in part.args if isinstance(argument, ast.Constant)]
    return found


def _tests(body: list[ast.stmt], inherited: list[ast.expr], prefix: str) -> Iterator[tuple[str, list[ast.expr]]]:
    """Each test and the expressions in which its marks stand: its own, those of its class and of its module."""
    assigned = [(statement.targets[0], statement.value) for statement in body if isinstance(statement, ast.Assign)]
    named = [(target.id, value) for target, value in assigned if isinstance(target, ast.Name)]
    inherited = inherited + [value for name, value in named if name == "pytestmark"]
    for statement in body:
        if isinstance(statement, ast.ClassDef) and statement.name.startswith("Test"):
            yield from _tests(statement.body, inherited + statement.decorator_list, f"{prefix}{statement.name}::")
        elif isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef) and statement.name.startswith("test"):
            yield f"{prefix}{statement.name}", inherited + statement.decorator_list
    of_machines = {ast.unparse(target): value for target, value in assigned if isinstance(target, ast.Attribute)}
    for name, _ in named:
        if name.startswith("Test"):  # a state machine of hypothesis
            own = of_machines.get(f"{name}.pytestmark")
            yield f"{prefix}{name}::runTest", inherited if own is None else [*inherited, own]


@cache
def defined(folder: Path) -> dict[str, list[ast.expr]]:
    """Every test, in the order of files and lines, and the expressions in which its marks stand."""
    return {
        name: marks
        for path in sorted(folder.rglob("test_*.py"))
        for name, marks in _tests(parse(path).body, [], f"{path.relative_to(folder).as_posix()}::")
    }


def collect(kind: str, folder: Path = TESTS) -> dict[Any, list[str]]:
    """What is marked -> tests with that mark."""
    shown: dict[Any, list[str]] = {}
    for name, marks in defined(folder).items():
        for mark in dict.fromkeys(mark for expression in marks for mark in _marks_of(expression, kind)):
            shown.setdefault(mark, []).append(name)
    return shown


def keeper_of(marks: list[ast.expr], file: str) -> str | None:
    """What keeps the promise of a test in the quick tier, by its nearest mark `slow`; None of a test without one."""
    alone = [part for mark in marks for part in (mark.elts if isinstance(mark, ast.List) else [mark])]
    for mark in reversed(alone):
        if isinstance(mark, ast.Attribute) and mark.attr == "slow":
            return ALONE
        if isinstance(mark, ast.Call) and isinstance(mark.func, ast.Attribute) and mark.func.attr == "slow":
            keeper = str(ast.literal_eval(mark.keywords[0].value))
            return keeper if keeper == FIRST or ".py::" in keeper else f"{file}::{keeper}"
    return None


@cache
def slow(folder: Path = TESTS) -> dict[str, str]:
    """Each slow test -> the quick one that keeps its promise, FIRST or ALONE."""
    found = {name: keeper_of(marks, name.partition("::")[0]) for name, marks in defined(folder).items()}
    return {name: keeper for name, keeper in found.items() if keeper is not None}


def is_slow(name: str) -> bool:
    """Whether no case of a test is run with the quick ones."""
    return slow().get(name, FIRST) != FIRST


def write(name: str, text: str) -> Path:
    """Write a table into the folder of reports; returns its path."""
    REPORTS.mkdir(parents=True, exist_ok=True)
    path = REPORTS / name
    path.write_text(text, encoding="utf-8")
    return path
