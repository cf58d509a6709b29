"""Runs the notebook beside it without Jupyter, cell by cell, and prints what each shows; a cell that fails ends it.

Run: python examples/notebook/run.py
"""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import os
import sys
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parent / "heading.ipynb"


def code_cells(notebook: Path) -> list[str]:
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


async def run_cell(source: str, name: str, namespace: dict[str, Any]) -> Any:
    """Run one cell as Jupyter does, `await` and all; its value is that of the expression it ends with, or None."""
    tree = ast.parse(source, name)
    last = tree.body[-1] if tree.body else None
    if not isinstance(last, ast.Expr):
        return await _run(tree, name, namespace, "exec")
    del tree.body[-1]
    await _run(tree, name, namespace, "exec")
    return await _run(ast.Expression(last.value), name, namespace, "eval")


async def _run(tree: Any, name: str, namespace: dict[str, Any], mode: str) -> Any:
    value = eval(compile(tree, name, mode, flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT), namespace)
    return await value if inspect.iscoroutine(value) else value


async def run_notebook(notebook: Path) -> list[Any]:
    """The value of each code cell, all run in one event loop."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    values = []
    for number, source in enumerate(code_cells(notebook), start=1):
        value = await run_cell(source, f"{notebook.name}, cell {number}", namespace)
        values.append(value)
        if value is not None:
            print(f"[{number}] {value!r}")
    return values


if __name__ == "__main__":
    os.chdir(NOTEBOOK.parent)
    asyncio.run(run_notebook(Path(sys.argv[1]) if len(sys.argv) > 1 else NOTEBOOK))
