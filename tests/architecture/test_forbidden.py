"""What no file of the package may do: run text as code, load pickles, start shells, or swallow every exception."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

import pytest
from test_layers import ROOT, sources

if TYPE_CHECKING:
    from pathlib import Path

MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "jsonpickle", "joblib"}
CALLS = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "os.system",
    "os.popen",
    "yaml.load",
    "yaml.unsafe_load",
    "numpy.load",
    "np.load",
}
ALLOWED = {
    # A baseline of `aiorts bench codec`: it reads nothing but the octets it wrote itself, in memory, a line before.
    "aiorts/bench/codec.py": ["import pickle"],
    # The loop of the original logger, which wrote so: a baseline of `aiorts bench log`; nothing is ever loaded.
    "aiorts/bench/log.py": ["import pickle"],
}
"""What one file may do nevertheless, and why; a new line here needs a reason."""
POSIX_ONLY = {"uvloop", "fcntl", "resource", "termios", "pwd", "grp", "pty", "tty", "syslog"}
LONGEST = 400
TABLES = {"aiorts/types/extended.py": 800, "aiorts/types/interface.py": 800}
"""Files that are one long table of records: nothing in them has to be followed."""

# Where every exception is caught: round a hook (on the loop, in a thread, alone) and round code that others ship (a
# plugin, a component file, an observer, a timer's callback); there it is reported and contained. A new line here needs
# a reason.
BROAD_EXCEPT = {
    # What somebody else's exception says of itself may raise in its turn.
    "aiorts/errors.py:said",
    "aiorts/model/values.py:shown",
    # Round a factory, at a restart: a SystemExit of a constructor is told as an error of the component.
    "aiorts/kernel/standing.py:instance_of",
    "aiorts/kernel/bulkhead.py:_run",
    # `_run` written out for the hooks of a cycle, and for the one that a sample woke.
    "aiorts/kernel/bulkhead.py:_run_one",
    "aiorts/kernel/bulkhead.py:_run_quickly",
    "aiorts/kernel/bus.py:_tell",
    # Round a component's own check of a configuration: whatever it raises refuses the change.
    "aiorts/kernel/commit.py:_asked",
    # A component file that is read anew: what running it does is the file's own fault.
    "aiorts/kernel/fresh_code.py:_run",
    "aiorts/kernel/observers.py:_work",
    # A look at what another thread does, which changes under it: the diagnosis may fail, its thread may not.
    "aiorts/kernel/watcher.py:_ring",
    "aiorts/kernel/plugins.py:load",
    # What an exception of a plugin says of itself may raise in its turn.
    "aiorts/kernel/plugins.py:_text",
    # The constructor is the user's, too: a component that cannot be made is one error that names its class.
    "aiorts/kernel/constructing.py:construct",
    "aiorts/kernel/solo.py:_run",
    # A provider's method is a component's code as a hook is: in a task of its own, in the caller's step, in a thread.
    "aiorts/kernel/service_call.py:_serve",
    "aiorts/kernel/service_proxy.py:run_in_step",
    "aiorts/kernel/service_thread.py:_serve",
    # It goes on to the thread that blocks for it.
    "aiorts/kernel/service_thread.py:run",
    # A restart: what the construction of a component, or its `on_initialize`, raises is its next failure.
    "aiorts/kernel/supervision.py:_help",
    "aiorts/contexts/thread.py:_call",
    # The context's own thread: a fault of the kernel must end the context, not vanish with the thread.
    "aiorts/contexts/thread.py:_run",
    "aiorts/system/load.py:_module",
    # A check constructs components without a kernel: what their constructors raise is a finding.
    "aiorts/system/draft.py:draft",
    "aiorts/timer_heap.py:run_due",
    # Making the codec of a plugin, and trying it on one record: what its own code does.
    "aiorts/wire/codecs.py:codec_of",
    "aiorts/cli/plugin_kinds.py:_codec",
}
FILES = sources("aiorts", "plugins")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def forbidden(tree: ast.Module) -> list[str]:
    faults = []
    for node in ast.walk(tree):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        faults += [f"line {node.lineno}: import {name}" for name in modules if name.split(".")[0] in MODULES]  # type: ignore[attr-defined]
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in CALLS:
            faults.append(f"line {node.lineno}: {called}()")
        faults += [
            f"line {node.lineno}: {keyword.arg}={ast.unparse(keyword.value)}"
            for keyword in node.keywords
            if keyword.arg in ("shell", "allow_pickle") and ast.unparse(keyword.value) != "False"
        ]
    return faults


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_file_keeps_every_rule(path: Path) -> None:
    """It runs no text as code and loads no pickles, catches everything at the borders only, imports POSIX's modules
    guarded, can be read in one sitting, and begins with its rule."""
    name, text = name_of(path), path.read_text(encoding="utf-8")
    tree = ast.parse(text, str(path))
    assert [fault.partition(": ")[2] for fault in forbidden(tree)] == ALLOWED.get(name, [])
    assert [
        f"{name}:{line} in {function}"
        for function, line in broad_handlers(tree)
        if f"{name}:{function}" not in BROAD_EXCEPT
    ] == []
    assert unguarded_posix(tree) == []
    assert len(text.splitlines()) <= TABLES.get(name, LONGEST)
    assert ast.get_docstring(tree) or (path.name == "__init__.py" and not text)


def test_forbidden_things_are_found() -> None:
    tree = ast.parse(
        "import pickle\nfrom marshal import loads\neval('1')\nsubprocess.run('x', shell=True)\n"
        "def f():\n    exec('x')\n    yaml.load('x')\n    np.load('x', allow_pickle=True)\n    re.compile('x')\n"
    )
    assert len(forbidden(tree)) == 8


def broad_handlers(tree: ast.Module) -> list[tuple[str, int]]:
    """(enclosing function, line) of each handler of Exception, BaseException or everything."""
    found: list[tuple[str, int]] = []

    def walk(node: ast.AST, function: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            function = getattr(node, "name", function)
        if isinstance(node, ast.ExceptHandler):
            caught = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            names = {"" if part is None else ast.unparse(part).rpartition(".")[2] for part in caught}
            if names & {"", "Exception", "BaseException"} and not ends_in_raise(node):
                found.append((function, node.lineno))
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] == "suppress":
            names = {ast.unparse(argument).rpartition(".")[2] for argument in node.args}
            if names & {"Exception", "BaseException"}:
                found.append((function, node.lineno))
        for child in ast.iter_child_nodes(node):
            walk(child, function)

    walk(tree, "<module>")
    return found


def ends_in_raise(handler: ast.ExceptHandler) -> bool:
    """A handler that cleans up and passes the exception on swallows nothing."""
    last = handler.body[-1]
    return isinstance(last, ast.Raise) and (last.exc is None or ast.unparse(last.exc) == handler.name)


def test_every_border_in_the_list_is_one() -> None:
    found = {f"{name_of(path)}:{function}" for path in FILES for function, _ in broad_handlers(tree_of(path))}
    assert found >= BROAD_EXCEPT


def test_broad_handlers_are_found_and_re_raising_ones_are_not() -> None:
    tree = ast.parse(
        "def a():\n    try: x()\n    except Exception: pass\n"
        "def b():\n    try: x()\n    except (ValueError, BaseException) as e: log(e)\n"
        "def c():\n    try: x()\n    except: log()\n"
        "def d():\n    with contextlib.suppress(Exception): x()\n"
        "def e():\n    try: x()\n    except BaseException:\n        undo()\n        raise\n"
        "def f():\n    try: x()\n    except ValueError: pass\n"
    )
    assert [function for function, _ in broad_handlers(tree)] == ["a", "b", "c", "d"]


def unguarded_posix(tree: ast.Module) -> list[str]:
    """Imports of POSIX-only modules that are neither late, nor typing-only, nor inside `try` or `if`."""
    found = []
    for node in tree.body:
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        found += [module for module in modules if module.split(".")[0] in POSIX_ONLY]
    return found


def test_unguarded_imports_of_posix_are_found_and_late_ones_are_not() -> None:
    tree = ast.parse("import os, fcntl\ntry:\n    import pwd\nexcept ImportError: pass\ndef f():\n    import grp\n")
    assert unguarded_posix(tree) == ["fcntl"]
