"""Write tests/ROWS.md: which tests show which row of the feature comparison. Run: python tests/rows.py

The marks `@pytest.mark.row(n)` of tests, classes and modules (`pytestmark`) are read from the source; nothing is run.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from trees import parse

TESTS = Path(__file__).parent
TARGET = TESTS / "ROWS.md"

FEATURES = {
    2: "Runs on the Pythons of today (3.11 and later)",
    3: "One pip install; no broker, no interface compiler",
    4: "Works without a name server",
    5: "Components are coroutines on asyncio",
    6: "The public interface is typed for mypy and pyright",
    7: "A component can be tested in its own process, with a rig",
    8: "Runs on Linux; run on Windows and macOS, or said not to be",
    9: "Real-time threads: scheduling class, exact wake-up, resident memory",
    10: "Lifecycle state for each pair of component and context",
    11: "All twelve hooks of a component",
    12: "A cycle runs in passes: transitions, execute, state update",
    13: "A hook that raises moves its component to error, with diagnostics",
    14: "The cause of an error can be asked for",
    15: "A failure of a participant in another kernel is detected, as an error",
    18: "Modes and participants of state machines: their hooks are run",
    16: "A hook that does not return is detected; a watchdog names what blocks the loop",
    17: "Supervision: reset or restart with back-off and a budget",
    19: "Several contexts for a component; added and removed while running",
    20: "Observers of every hook, before and after",
    21: "Ports added and removed at run time",
    22: "The number of instances of a type is limited",
    23: "Hot reload of component code, with state handed over",
    24: "Periodic context, without drift",
    25: "A context ticked from outside, no tick lost",
    26: "A tick that returns when its cycle is complete",
    27: "Transitions take effect without waiting for a tick",
    28: "Event context: runs on data",
    29: "Virtual time, for stamps too",
    30: "Groups of members run side by side in one cycle",
    31: "Real-time scheduling, processor affinity and priority of a context",
    32: "What happens on overrun is chosen: skip or catch up",
    33: "Counts of overruns, lateness and execution time",
    34: "Transitions are awaited, and tell whether they succeeded",
    35: "Rate and context changed while running",
    36: "Push: the writer sends",
    37: "Pull: the reader asks, and knows whether there is news",
    38: "A write and a read meet: the write is done when its sample was taken",
    39: "Subscriptions flush, new and periodic",
    40: "Push policies all, fifo, skip and new",
    41: "Buffer length, and what happens when it is full or empty",
    42: "A buffer for each connector",
    43: "The reader knows where a sample came from",
    44: "A writer can wait for a slow reader",
    45: "Reads are awaited; ports are iterated",
    46: "Unread data can be asked for by connector",
    47: "Listeners of connectors: all 17 kinds fire, and cost nothing where nobody listens",
    48: "Time stamps at write, send, receive or read",
    50: "In-process transport without copies that anyone could change",
    51: "Transport between processes of one host; large arrays through shared memory",
    54: "Codecs and transports by name: ours, and those of plugins",
    56: "A connector goes on by itself after a loss of the link or a restart of either end, with the loss counted",
    55: "Types are compared when ports are connected",
    57: "Connections of more than two ports",
    58: "Limits on connections; duplicates refused",
    60: "Counters and latency of each connector",
    61: "When and how long a publisher sends, measured",
    62: "The basic, extended and interface record types",
    63: "64-bit integers, n-dimensional arrays, maps",
    64: "A user's own record types without generated code",
    65: "Values checked for range; conversions say what happens on overflow",
    66: "Fields reached by path",
    67: "Service ports: provided and required interfaces, many in one port",
    68: "Who answers whom can be said; what is left unbound is an error unless it may be",
    69: "Every call has a deadline and can be cancelled",
    71: "Calls and hooks of a component never run at once",
    118: "The documentation of a component is generated from it",
    119: "The skeleton of a component is generated, and runs at once",
    122: "Shell completion",
    116: "Replay: range, seek, step, speed, fixed rate, passes; while it runs, too",
    72: "Configuration sets, one of them active, changed while running",
    73: "Constraints enforced in the core, on every way to a value",
    74: "Types, units and allowed values of parameters can be asked for",
    75: "Several parameters changed in one step, all or none",
    76: "When a value takes effect is defined; changes are told",
    77: "Changes made while running are saved and read back",
    102: "Components that are hierarchical state machines",
    103: "Timers, guards, history and regions of a state machine, declared",
    104: "What a state machine is and does can be seen: the table that runs, every moment of it",
    90: "Names of instances by a policy",
    92: "Orderly shutdown, in the reverse order",
    106: "The log of a component is read from elsewhere, and its level set",
    113: "A system is drawn as a graph: of its file, and as it runs",
    114: "Samples are printed and injected while a system runs",
    121: "Commands have JSON output, and are carried out in a batch",
    107: "A system is saved as an RtsProfile, XML or YAML",
    89: "Components, connections and activations that a manager's configuration asks for",
    59: "Ports are connected by rules, as components come and go",
    108: "A saved system is restored, connections and configuration, whole or not at all",
    109: "Components that are missing are created when a system is restored",
    110: "What runs is compared with its file",
    112: "A change can be looked at before it is made",
    111: "Ordered start and stop with conditions",
    98: "Composites: shared context and order, exported ports",
    99: "Members of a composite change while it runs: all or nothing",
    100: "What a member's error means for its composite is chosen",
    101: "A composite has members in other kernels, all or none of them",
    78: "A system file has a schema, and is checked whole before anything is made",
    79: "Profiles of components, ports, contexts and connectors",
    81: "Chosen values are monitored at a rate, without an effect",
    84: "Changes are told, as they happen, to whoever watches",
    85: "The whole system in one document, with a schema",
    87: "Components loaded, made and ended by name while the process runs",
    88: "What went wrong when loading is told to who asked",
    94: "Whoever manages the process is told of every step",
    95: "Logging by component, with levels and several sinks",
    105: "Observers with typed events; a slow one holds nobody up",
    115: "Recordings are made by a component",
    117: "A recording's format is versioned and safe: checked, readable after a crash, nothing in it is run",
    123: "Add, select, duplicate, dump, const, filter as components",
    124: "A component's interface changes while it runs",
    125: "Constants are literals: nothing is evaluated",
    126: "Scale and offset, clamp, several sources for a pin",
    127: "What happens on overflow and NaN is chosen",
    128: "A whole system simulated with the same result every time",
    130: "Written guarantees of order, delivery and lifecycle",
    82: "A component has its place in a hierarchy of names: domain, host, kernel, name",
    83: "What was killed or is cut off goes out of every list by itself",
    91: "Kernels of many processes and hosts are operated from one place; programs in other languages take part",
    97: "Who may look, operate or be linked is decided by certificates",
    # From 201 on: what no other system of the comparison offers, and so has no row there.
    201: "The interface of a running component changes and everyone sees it",
    202: "A missed deadline names who held the loop",
}
"""Number of the row in the comparison and what it is about: each needs a test."""
NOT_FULFILLED = {
    94: "loading a plugin is no event: its failure is told to who asked, its success is seen by the component it makes",
}
"""What of a row is not so."""


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
    for name, _ in named:
        if name.startswith("Test"):
            yield f"{prefix}{name}::runTest", inherited  # a state machine of hypothesis


@cache
def defined(folder: Path = TESTS) -> dict[str, list[ast.expr]]:
    """Every test, in the order of files and lines, and the expressions in which its marks stand."""
    return {
        name: marks
        for path in sorted(folder.rglob("test_*.py"))
        for name, marks in _tests(parse(path).body, [], f"{path.relative_to(folder).as_posix()}::")
    }


def collect(kind: str = "row", folder: Path = TESTS) -> dict[Any, list[str]]:
    """What is marked -> tests with that mark."""
    shown: dict[Any, list[str]] = {}
    for name, marks in defined(folder).items():
        for mark in dict.fromkeys(mark for expression in marks for mark in _marks_of(expression, kind)):
            shown.setdefault(mark, []).append(name)
    return shown


def render(shown: dict[int, list[str]]) -> str:
    """The text of ROWS.md."""
    lines = [
        "# Rows of the feature comparison and the tests that show them",
        "",
        "Written by `python tests/rows.py` from the marks `@pytest.mark.row(number)`; a test fails when it is stale.",
        "",
        "| Row | Feature | Tests |",
        "|---|---|---|",
    ]
    for row in sorted(FEATURES.keys() | shown.keys()):
        tests = "<br>".join(f"`{name}`" for name in shown.get(row, [])) or "none yet"
        feature = FEATURES.get(row, "not in the list of rows.py")
        lacking = f"<br>**Not fulfilled:** {NOT_FULFILLED[row]}" if row in NOT_FULFILLED else ""
        lines.append(f"| {row} | {feature}{lacking} | {tests} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    TARGET.write_text(render(collect()), encoding="utf-8")
    print(f"{TARGET}: {len(collect())} rows")
