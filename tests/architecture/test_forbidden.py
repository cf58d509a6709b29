"""What no file of the package may do: run text as code, load pickles, start shells, or swallow every exception."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

import pytest
from test_layers import ROOT, sources

from trees import dotted, many_objects, nodes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Trees = Callable[[str], dict[str, ast.Module]]

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
    # The code of the face that calls it, no text: the imports at its top once more, where none imports anything.
    "aiorts/late.py": ["exec()"],
    # Constructors and codecs written out for a number of fields: text of ours, numbers and `repr` alone.
    "aiorts/types/generated.py": ["exec()"],
    # A baseline of `aiorts bench codec`: it reads nothing but the bytes it wrote itself, in memory, a line before.
    "plugins/aiorts_bench/cases/codec.py": ["import pickle"],
    # The loop of the original logger, which wrote so: a baseline of `aiorts bench log`; nothing is ever loaded.
    "plugins/aiorts_bench/cases/log.py": ["import pickle"],
}
"""What one file may do nevertheless, and why; a new line here needs a reason."""
POSIX_ONLY = {"uvloop", "fcntl", "resource", "termios", "pwd", "grp", "pty", "tty", "syslog"}
LONGEST = 700
TABLES = {"aiorts/types/extended.py": 800, "aiorts/types/interface.py": 800}
"""Files that are one long table of records: nothing in them has to be followed."""

# Where every exception is caught: round a hook (on the loop, in a thread, alone) and round code that others ship (a
# plugin, a component file, an observer, a timer's callback); there it is reported and contained. A new line here needs
# a reason.
BROAD_EXCEPT = {
    # Round standard output, which may be an application's own: whatever it fails with is the failure of who prints.
    "aiorts/isolation/printing.py:_write",
    # Round what a kernel asks of the process of a component: whatever it fails with is the answer.
    "aiorts/cli/runtime/component_process.py:_operate",
    # Round a plugin's transport while it is made.
    "aiorts/links/reaching.py:find_transport",
    # Round a question that a transport carries, and round the channels of one, which a plugin may offer: a link that
    # is not tried again is lost.
    "aiorts/links/connecting.py:ask",
    "aiorts/links/ends.py:_asked",
    "aiorts/links/ends.py:_opened",
    # Round a sample of another kernel: its class may check values in its own way, and the next ones still come.
    "aiorts/links/call_values.py:restored",
    "aiorts/links/reader_link.py:_deliver",
    "aiorts/links/reader_link.py:_deliver_all",
    "aiorts/links/reader_link.py:on_frames",
    # Round a recorded sample, as above: the others are replayed, and the run ends.
    "plugins/aiorts_log/playing/read_ahead.py:_read",
    # Round the answer to another kernel, which must not wait for its time-out because of a fault here.
    "aiorts/links/transport.py:answer_of",
    # Round what cuts off a name that was revoked: the other links of it, and the other names, are cut off all the same.
    "plugins/aiorts_zenoh/neighbours.py:_deny",
    # Round what is done in a thread for a coroutine, which is told of it: also of a panic of the engine.
    "plugins/aiorts_zenoh/engine.py:run",
    # Round the end of a session at the end of the interpreter: nobody is left to be told.
    "plugins/aiorts_zenoh/engine.py:_leave",
    # What a plan did is taken back step by step: what one of these fails with is said, and the next follows.
    "aiorts/planning/applying.py:back",
    # What somebody else's exception says of itself may raise in its turn.
    "aiorts/errors.py:format_error",
    "aiorts/model/values.py:shown",
    "aiorts/kernel/loop/exceptions.py:presentable",
    "aiorts/kernel/loop/origins.py:origin_of",
    # Round everything that records: an exception, a handler, a filter, a text of the application's, standard error.
    "aiorts/kernel/loop/guarded.py:guarded",
    "aiorts/kernel/loop/guarded.py:contain",
    "aiorts/kernel/loop/guarded.py:_log",
    "aiorts/kernel/loop/guarded.py:line_of",
    "aiorts/kernel/loop/log.py:_log",
    # Looking up a hook is the component's own code, too.
    "aiorts/kernel/execution/member.py:hook_of",
    # The kernel's own faults: the other members go on, and the end is gone through to its end.
    "aiorts/kernel/execution/task_driver.py:_drive",
    "aiorts/composites/parallel.py:_drive",
    "aiorts/kernel/execution/cycle.py:_contained",
    "aiorts/kernel/registry.py:through",
    "aiorts/contexts/thread.py:_go_on",
    "aiorts/contexts/thread.py:_carry_out",
    # Round a factory, at a restart: a SystemExit of a constructor is told as an error of the component.
    "aiorts/supervision/component_place.py:instance_of",
    "aiorts/kernel/execution/task_driver.py:_run",
    # `_run` written out for the hooks of a cycle, and for the one that a sample woke.
    "aiorts/kernel/execution/task_driver.py:_run_one",
    "aiorts/kernel/execution/task_driver.py:_run_quickly",
    "aiorts/kernel/loop/bus.py:_notify",
    # Round a component's own check of a configuration: whatever it raises refuses the change.
    "aiorts/kernel/commit.py:_call_own",
    # A component file that is read anew: what running it does is the file's own fault.
    "aiorts/reload/fresh_code.py:_run",
    "aiorts/kernel/loop/observers.py:_work",
    # A look at what another thread does, which changes under it: the diagnosis may fail, its thread may not.
    "aiorts/diagnostics/monitor_thread.py:_ring",
    "aiorts/kernel/extensions/loading.py:load",
    # Round the settings of a plugin's service, and round its methods: the kernel and the other services go on.
    "aiorts/kernel/extensions/arguments.py:_refused",
    "aiorts/kernel/connections.py:contained",
    # Round what a client asked for, and round the thread that serves clients: the system goes on without them.
    "aiorts/control/session.py:begin",
    # Round what a user's on_initialize raises: the answer of who had the component created.
    "aiorts/control/operations/components.py:_create",
    "aiorts/control/session.py:end",
    "aiorts/control/server/listener.py:_guarded",
    "aiorts/control/server/listener.py:_serve",
    "aiorts/control/server/listener.py:_deliver",
    "aiorts/kernel/service.py:linger",
    "aiorts/kernel/service.py:notify",
    "aiorts/kernel/service.py:reports",
    # What an exception of a plugin says of itself may raise in its turn.
    "aiorts/kernel/extensions/loading.py:_text",
    # The constructor is the user's, too: a component that cannot be made is one error that names its class.
    "aiorts/kernel/component.py:construct",
    "aiorts/kernel/detached_hook.py:_run",
    # A provider's method is a component's code as a hook is: in a task of its own, in the caller's step, in a thread.
    "aiorts/services/service_call.py:_serve",
    "aiorts/services/service_proxy.py:run_in_step",
    "aiorts/services/service_thread.py:_serve",
    # It goes on to the thread that blocks for it.
    "aiorts/services/service_thread.py:run",
    "aiorts/kernel/loop/calls.py:run",
    # A restart: what the construction of a component, or its `on_initialize`, raises is its next failure.
    "aiorts/supervision/supervisor.py:_helped",
    "aiorts/contexts/thread.py:_call",
    # The context's own thread: a fault of the kernel must end the context, not vanish with the thread.
    "aiorts/contexts/thread.py:_run",
    # A check constructs components without a kernel: what their constructors raise is a finding.
    "aiorts/system/checks/draft.py:draft",
    "aiorts/timer_heap.py:run_due",
    # Whatever ends a check of a conformance suite is its result.
    "aiorts/testing/conformance.py:run",
    # Making the codec of a plugin, and trying it on one record: what its own code does.
    "aiorts/wire/codecs.py:codec_of",
    "aiorts/cli/commands/plugin_kinds.py:_codec",
    # A converter is the application's function: its sample is dropped, and what its annotations say may not be had.
    "aiorts/kernel/quality/conversion.py:of",
    "aiorts/model/converter.py:_annotation_fault",
    # Making one of a text: what a plugin's code does.
    "aiorts/model/converter.py:_made",
    "aiorts/cli/commands/record_types.py:example_of",
}
FILES = sources("aiorts", "plugins")
SUSPECT = rf"(?<![.\w])({'|'.join(map(re.escape, CALLS))})\s*\(|\b({'|'.join(MODULES)}|shell|allow_pickle)\b"
"""What stands in every file that could do what is forbidden, and in some that only speak of it."""


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Every file, by its name."""
    return {name_of(path): path.read_text(encoding="utf-8") for path in FILES}


@pytest.fixture
def trees(texts: dict[str, str]) -> Iterator[Callable[[str], dict[str, ast.Module]]]:
    """The files that have a word, a regular expression, as trees: parsing all of them for each rule takes long."""
    with many_objects():
        yield lambda word: {name: ast.parse(text) for name, text in texts.items() if re.search(word, text)}


def forbidden(tree: ast.Module) -> list[str]:
    faults = []
    for node in nodes(tree):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        faults += [f"line {node.lineno}: import {name}" for name in modules if name.split(".")[0] in MODULES]  # type: ignore[attr-defined]
        if not isinstance(node, ast.Call):
            continue
        called = dotted(node.func)
        if called in CALLS:
            faults.append(f"line {node.lineno}: {called}()")
        faults += [
            f"line {node.lineno}: {keyword.arg}={ast.unparse(keyword.value)}"
            for keyword in node.keywords
            if keyword.arg in ("shell", "allow_pickle") and ast.unparse(keyword.value) != "False"
        ]
    return faults


def test_no_file_runs_text_as_code_loads_pickles_or_starts_a_shell(trees: Trees) -> None:
    found = {name: [fault.partition(": ")[2] for fault in forbidden(tree)] for name, tree in trees(SUSPECT).items()}
    assert {name: faults for name, faults in found.items() if faults} == ALLOWED


def test_no_file_changes_the_class_of_a_live_object(trees: Trees) -> None:
    changed = [
        f"{name}:{node.lineno}"
        for name, tree in trees("__class__").items()
        for node in nodes(tree)
        if isinstance(node, ast.Attribute) and node.attr == "__class__" and isinstance(node.ctx, ast.Store)
    ]
    assert changed == []


def test_near_words_are_looked_for_in_one_place(trees: Trees) -> None:
    assert list(trees(r"get_close_matches|import difflib")) == ["aiorts/spelling.py"]


def test_everything_is_caught_at_the_borders_in_the_list_and_nowhere_else(trees: Trees) -> None:
    broad = trees(r"except\s*\*?\s*:|Exception\b")
    found = {f"{name}:{function}": line for name, tree in broad.items() for function, line in broad_handlers(tree)}
    assert {border: line for border, line in found.items() if border not in BROAD_EXCEPT} == {}
    assert sorted(BROAD_EXCEPT - found.keys()) == [], "in the list, but no border any more"


def test_no_file_needs_a_module_that_only_posix_has(trees: Trees) -> None:
    some = trees(rf"\b({'|'.join(POSIX_ONLY)})\b")
    assert {name: modules for name, tree in some.items() if (modules := unguarded_posix(tree))} == {}


def test_every_file_can_be_read_in_one_sitting() -> None:
    lines = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert {name: count for name, count in lines.items() if count > TABLES.get(name, LONGEST)} == {}


def test_every_file_begins_with_its_rule(trees: Trees) -> None:
    """An empty `__init__` has nothing to say."""
    other = trees(r'\A(?!"""\S)')
    assert [name for name, tree in other.items() if tree.body and not ast.get_docstring(tree)] == []


def test_the_kernels_own_log_is_the_guarded_one() -> None:
    """A handler of the application may raise: whoever logs for the kernel asks `KernelLog`, which contains it."""
    ours = ("aiorts/cli/", "aiorts/kernel/loop/guarded.py")
    plain = [name_of(path) for path in FILES if 'getLogger("aiorts.kernel")' in path.read_text(encoding="utf-8")]
    assert [name for name in plain if not name.startswith(ours)] == []


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
        if isinstance(node, ast.Call) and dotted(node.func).rpartition(".")[2] == "suppress":
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
