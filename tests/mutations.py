"""Break the sources in some sixty places, each in turn, and run the quick tests that concern it: they are to fail.

    python tests/mutations.py [NUMBER ...]     all of them, or those of the table by their numbers from 1 on

It works in a copy; nothing here is changed. A place is found by its text, wherever that has moved to. At the end stand
the survivors (which no quick test found), and the places that are not there any more, to be replaced by others. This
takes minutes, and no ordinary run does it. Status: 0 all found, 1 some survived or are gone.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", ".nox", ".*_cache", ".hypothesis", "__pycache__")
LONGEST = 240.0  # seconds: a mutation that makes tests hang is found, too


class Mutation(NamedTuple):
    """One place, what stands there instead, and the tests (folders or files) that are to find it."""

    was: str
    becomes: str
    tests: str


MUTATIONS = [
    # model
    Mutation("_STORE if buffered < length else", "_STORE if buffered <= length else", "model ports"),
    Mutation("number % (skip + 1) == 0", "number % (skip + 2) == 0", "model ports"),
    Mutation(
        '(_A, Event.DEACTIVATE): Transition(("on_deactivated",), _I)',
        "(_A, Event.DEACTIVATE): Transition((), _I)",
        "model",
    ),
    Mutation("isinstance(name, str) and _NAME.fullmatch(name)", "isinstance(name, str) and _NAME.match(name)", "model"),
    Mutation("if not low <= number <= high:  # also refuses NaN", "if not low < number <= high:", "model"),
    Mutation("all(a == b or -1 in (a, b)", "all(a == b or 1 in (a, b)", "ports"),
    Mutation("for component, before, after in reversed(done):", "for component, before, after in ():", "configuration"),
    Mutation('while self._kind == "word" and self._now == "and":', "if False:", "model"),
    # types, wire
    Mutation("(low is not None and not low <= value <= high)", "(low is not None and not low <= value)", "types"),
    Mutation("if finite and math.isinf(result):", "if False:", "types flexi"),
    Mutation('if overflow != "saturate" or limits is None:', 'if overflow == "wrap" or limits is None:', "types flexi"),
    Mutation("elif not (flags.owndata or _of_bytes(array)):", "elif False:", "types"),
    Mutation("if len(open_until) > MAX_DEPTH:", "if len(open_until) > 4 * MAX_DEPTH:", "wire"),
    Mutation("if size > self._uncounted:", "if False:", "wire"),
    # clock, timers, log, bus
    Mutation("while entries and entries[0][0] <= now_ns:", "while entries and entries[0][0] < now_ns:", "time loop"),
    Mutation("if monotonic_ns < self.now_ns:", "if False:", "time"),
    Mutation("self._armed is None or deadline_ns < self._armed", "self._armed is None", "loop time"),
    Mutation("if folded is not None and now - folded.emitted_ns < _SECOND_NS:", "if False:", "loop"),
    Mutation("if self._telling or self._later:", "if self._telling:", "loop"),
    # ports
    Mutation("if not issubclass(out.type, in_.type):", "if not issubclass(in_.type, out.type):", "ports"),
    Mutation("if (out, in_) in seen or _connected(out, in_):", "if _connected(out, in_):", "ports"),
    Mutation("return sole if sole is not None and sole.queue else None", "return sole", "ports"),
    Mutation(
        "return self.push is not _NEW and self.connector.profile.full is _BLOCK",
        "return self.connector.profile.full is _BLOCK",
        "ports",
    ),
    Mutation("if len(queue) >= room:", "if len(queue) > room:", "ports"),
    Mutation(
        "if len(outs) + len(ins) != len(ports) or not outs or not ins:", "if not outs or not ins:", "ports services"
    ),
    # execution
    Mutation("if before is None and leads_to is not Failure.RECORD:", "if before is None:", "execution"),
    Mutation(
        'return "on_state_update" if member.updates and member.active and not member.left else ""',
        'return "on_state_update" if member.updates else ""',
        "execution contexts",
    ),
    Mutation(
        "return self.inside is None and not self.waiting", "return self.inside is None", "execution services contexts"
    ),
    Mutation("return self._long >= _TWICE", "return self._long > _TWICE", "execution ports"),
    Mutation(
        "for member in reversed(self._context._members):",
        "for member in list(self._context._members):",
        "execution kernel",
    ),
    # kernel
    Mutation("if count >= limit:", "if count > limit:", "kernel observe"),
    Mutation(
        "if name not in old.values or old.values[name] is not value:",
        "if name not in old.values:",
        "configuration kernel",
    ),
    Mutation('if not _overrides(component, "check_configuration"):', "if True:", "configuration"),
    Mutation("if (project := _project(name)) in seen:", "if False:", "extensions"),
    Mutation("if len(names) > 1:  # a circle of calls has no first", "if False:  # a circle", "kernel/test_ending.py"),
    Mutation(
        "for resume in paused:\n            resume()",
        "for resume in paused:\n            pass",
        "kernel/test_ending.py",
    ),
    Mutation(
        "context.runner.retire(tuple(those), budget)",
        "context.runner.retire(tuple(those)[:1], budget)",
        "kernel/test_ending.py",
    ),
    # contexts
    Mutation("_RATE._replace(high=highest)", "_RATE", "contexts"),
    Mutation('if self.overrun == "catch_up":', 'if self.overrun != "catch_up":', "contexts"),
    Mutation("return member.state is not _INACTIVE and not member.left", "return not member.left", "contexts"),
    Mutation("while self._requested and self._requested[0].done():", "while False:", "contexts"),
    Mutation(
        "if error is not None and host.stopping and issubclass(type(error), ClosedError):",
        "if False:",
        "contexts ports",
    ),
    # services of the kernel
    Mutation('if failure not in ("reply", "error"):', "if False:", "services"),
    Mutation("if not link.kernel.on_loop_thread():", "if False:", "services"),
    Mutation(
        "if event is Event.ACTIVATE and stops and composite.state is _ERROR:", "if False:", "composites supervision"
    ),
    Mutation("sorted(line, key=lambda part: place[part])", "sorted(line, key=lambda part: -place[part])", "composites"),
    Mutation('if node.kind == "deep":', 'if node.kind == "history":', "statemachines"),
    Mutation("if mode not in self.modes:", "if False:", "statemachines"),
    Mutation("if not latest and not pairs and len(parts) > 1:", "if not latest and len(parts) > 1:", "functions"),
    Mutation("if lasted is not None and 2 * lasted < late and len(glances) == 1:", "if lasted is None:", "diagnostics"),
    Mutation("elif len(self._queue) >= self._length:", "elif len(self._queue) > 2 * self._length:", "observe"),
    Mutation("delay *= _FACTOR", "delay += policy.backoff", "supervision"),
    Mutation("while name not in way:", "while False:", "supervision"),
    Mutation("while waiting and waiting[0].future is not None:", "while False:", "realtime"),
    Mutation("if live.type is not fresh.type:", "if False:", "reload"),
    # systems, command line, tests for users, plugins
    Mutation(
        "if LifecycleState.ERROR in states or component.name in self._finished or component.has_finished:",
        "if component.name in self._finished or component.has_finished:",
        "system",
    ),
    Mutation(
        "if writer in edges and reader in edges and writer not in without",
        "if writer in edges and writer not in without",
        "system",
    ),
    Mutation('if "order" in table and "members" not in table:', "if False:", "system"),
    Mutation("STALLED = 70", "STALLED = 71", "cli/test_exits.py::test_the_table_is_what_scripts_may_rely_on"),
    Mutation("if not equals or not param:", "if not equals:", "cli/test_run_component.py"),
    Mutation("if self._reported == len(self._failures) and not self._expecting:", "if self._expecting:", "testing"),
    Mutation("elif self.rules.reset or self.rules.zero_old:", "elif self.rules.reset:", "flexi"),
    Mutation("if head.crc and zlib.crc32(memoryview(data)[at:]) != head.crc:", "if False:", "log"),
]


def place_of(tree: Path, text: str) -> Path | None:
    """The file in which a text stands, when it stands in the sources once and no more."""
    files = [path for top in ("aiorts", "plugins") for path in sorted((tree / top).rglob("*.py"))]
    found = [path for path in files for _ in range(path.read_text(encoding="utf-8").count(text))]
    return found[0] if len(found) == 1 else None


def failing(tree: Path, tests: str) -> str:
    """The first quick test that fails there; nothing when all pass."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tree), str(tree / "plugins")])}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider"]
    command += [f"tests/{each}" for each in tests.split()]
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return "not finished"
    if done.returncode == 0:
        return ""
    named = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    said = [f"status {done.returncode}", *(done.stdout + done.stderr).split("\n")]
    return named[0].split(" - ")[0] if named else next(line for line in reversed(said) if line)


def main(numbers: list[int]) -> int:
    """Try them; the number of those that no test found or that are gone decides the status."""
    survived, gone, broken = [], [], {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=NOT_COPIED)
        for number in numbers:
            mutation = MUTATIONS[number - 1]
            path = place_of(tree, mutation.was)
            if path is None:
                gone.append(f"{number}: {mutation.was}")
                print(f"{number}: gone: {mutation.was}", flush=True)
                continue
            if mutation.tests not in broken:
                broken[mutation.tests] = failing(tree, mutation.tests)
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace(mutation.was, mutation.becomes), encoding="utf-8")
            moment = path.stat().st_mtime + 2 * number
            os.utime(path, (moment, moment))  # bytecode is taken for current by the second alone
            why = failing(tree, mutation.tests)
            path.write_text(text, encoding="utf-8")
            os.utime(path, (moment + 1, moment + 1))
            if broken[mutation.tests]:
                why = f"the tests fail without it: {broken[mutation.tests]}"
                gone.append(f"{number}: {why}")
            elif not why:
                survived.append(f"{number}: {path.relative_to(tree)}: {mutation.was} -> {mutation.becomes}")
            print(f"{number}: {path.relative_to(tree)}: {why or 'SURVIVED'}", flush=True)
    print(f"\n{len(numbers) - len(survived) - len(gone)} of {len(numbers)} found")
    print(*(f"survived {each}" for each in survived), *(f"not tried {each}" for each in gone), sep="\n")
    return 1 if survived or gone else 0


if __name__ == "__main__":
    sys.exit(main([int(each) for each in sys.argv[1:]] or list(range(1, len(MUTATIONS) + 1))))
