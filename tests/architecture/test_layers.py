"""Rooms and layers: an import points down, whatever its kind, and a plugin imports the public face alone.

A room is a folder; a file that stands in `aiorts/` itself is a room of its own. An arrow is an import from one file to
another: at the top of a module, in a function, for typing, or a module named in a string. An import from the face of a
room (its `__init__`) is an arrow to the file that defines the name.
"""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

from trees import many_objects, nodes, parse, statements

ROOT = Path(__file__).parents[2]
ORDER = """
aiorts/errors.py aiorts/exits.py aiorts/late.py aiorts/progress.py aiorts/spelling.py aiorts/tiers.py
aiorts/description.py aiorts/layout
aiorts/guide
aiorts/timer_heap.py
aiorts/clock.py
aiorts/model
aiorts/model/configuration aiorts/model/health aiorts/model/links aiorts/processes
aiorts/model/wanted
aiorts/types
aiorts/types/ros aiorts/wire aiorts/rings
aiorts/kernel/loop
aiorts/kernel/extensions
aiorts/kernel/ports
aiorts/kernel/execution
aiorts/kernel/quality
aiorts/kernel
aiorts/contexts
aiorts/configuration aiorts/diagnostics aiorts/functions aiorts/health aiorts/realtime aiorts/services aiorts/sync
aiorts/rules
aiorts/observe
aiorts/composites aiorts/statemachines
aiorts/supervision
aiorts/reload
aiorts/sessions
aiorts/links
aiorts/isolation
aiorts/remote
aiorts/planning
aiorts/adapting
aiorts/control
aiorts/control/operations
aiorts/control/server
aiorts/assembly.py
aiorts/running.py aiorts/events.py aiorts/statechart.py
aiorts/system/text
aiorts/system/expansion
aiorts/system/file
aiorts/system/stdio
aiorts/system/checks
aiorts/system/draw aiorts/system/schemas
aiorts/system
aiorts/testing
aiorts/cli/console
aiorts/cli/runtime
aiorts/cli/commands/live
aiorts/cli/commands/live/look aiorts/cli/commands/live/measure
aiorts/cli/commands aiorts/cli/demo aiorts/cli/new
aiorts/cli
plugins/aiorts_log plugins/aiorts_bench/harness plugins/aiorts_flexi/common
plugins/aiorts_foxglove plugins/aiorts_zenoh/security
plugins/aiorts_studio plugins/aiorts_zenoh
"""
"""The rooms, lowest first; those of one line know nothing of each other."""
SERVICES = (
    *("adapting", "composites", "configuration", "control", "diagnostics", "functions", "health", "isolation"),
    *(
        "links",
        "observe",
        "planning",
        "processes",
        "realtime",
        "reload",
        "remote",
        "rules",
        "services",
        "sessions",
        "statemachines",
        "supervision",
        "sync",
    ),
)
"""The rooms round the microkernel."""
LARGEST_ROOM = 21
"""Files; `types` has one more than the others may have."""
PUBLIC = (
    "aiorts",
    "aiorts.events",
    "aiorts.statechart",
    "aiorts.types",
    "aiorts.types.ros",
    "aiorts.control",
    "aiorts.sessions",
    "aiorts.links",
    "aiorts.description",
    "aiorts.errors",
    "aiorts.exits",
    "aiorts.late",
    "aiorts.layout",
    "aiorts.progress",
    "aiorts.spelling",
    "aiorts.clock",
    "aiorts.wire",
    "aiorts.system",
    "aiorts.testing",
)
"""What a plugin may import from: modules with `__all__`, and only names in it."""
MODEL_MAY_NOT = {"asyncio", "threading", "time", "socket", "subprocess", "selectors", "signal", "logging", "concurrent"}


class Import(NamedTuple):
    """One import: the module, the name taken from it if any, where it stands; or a module's name in a string."""

    line: int
    module: str
    name: str | None = None
    text: bool = False


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def module_of(path: Path, root: Path = ROOT) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    parts = parts[1:] if parts[0] == "plugins" else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def room_of(path: Path, root: Path = ROOT) -> str:
    inside = path.relative_to(root)
    return str(inside if inside.parent == Path("aiorts") else inside.parent)


@cache
def imports(path: Path) -> list[Import]:
    """Every import of a file, wherever it stands, and every string that is nothing but the name of a module of ours."""
    found, tree = [], parse(path)
    names_ours = re.search(r"""["']aiorts""", path.read_text(encoding="utf-8"))
    for node in nodes(tree) if names_ours else statements(tree):
        if isinstance(node, ast.Import):
            found += [Import(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno}: a relative import"
            found += [Import(node.lineno, node.module or "", alias.name) for alias in node.names]
        elif isinstance(node, ast.Constant) and re.fullmatch(r"aiorts(_\w+)?(\.\w+)+", str(node.value)):
            found.append(Import(node.lineno, str(node.value), text=True))
    return found


class House:
    """The files below a root, and what each imports of the others."""

    def __init__(self, root: Path = ROOT) -> None:
        self.root = root
        tops = [root / top for top in ("aiorts", "plugins")]
        paths = [path for top in tops if top.is_dir() for path in sorted(top.rglob("*.py"))]
        self.files = {module_of(path, root): path for path in paths}
        self.faces = {module for module, path in self.files.items() if path.name == "__init__.py"}
        self.imports = {module: imports(path) for module, path in self.files.items()}
        self._given = {
            face: {one.name: one.module for one in self.imports[face] if one.name is not None} for face in self.faces
        }

    def home(self, module: str, name: str | None) -> str | None:
        """The file that an import leads to, through faces to the file that defines the name; None: none of ours."""
        for _ in range(5):
            if name is not None and f"{module}.{name}" in self.files:
                module, name = f"{module}.{name}", None
            if module not in self.faces or name not in self._given[module]:
                break
            module = self._given[module][name]
        return module if module in self.files else None

    def room(self, module: str) -> str:
        return room_of(self.files[module], self.root)

    def arrows(self) -> list[tuple[str, int, str]]:
        """(file, line, file) of each import of ours. A face only gathers; in a string it is the name of a logger."""
        return [
            (module, one.line, home)
            for module, found in self.imports.items()
            if module not in self.faces
            for one in found
            if not (one.text and one.module in self.faces)
            if (home := self.home(one.module, one.name)) not in (None, module)
        ]


@cache
def house() -> House:
    with many_objects():
        return House()


def levels() -> dict[str, int]:
    return {room: level for level, line in enumerate(ORDER.split("\n")) for room in line.split()}


def upward(of: House) -> list[str]:
    """Imports that do not point down."""
    level, faults = levels(), []
    for module, line, target in of.arrows():
        here, there = of.room(module), of.room(target)
        if here == there or here.startswith("plugins") or here == "aiorts/__main__.py":
            continue
        if there == "aiorts/__init__.py":
            there = "aiorts/statechart.py"  # a name of the public face: above every room of the kernel
        if there.startswith("plugins") or level[there] >= level[here]:
            faults.append(f"{module}:{line}: {target}")
    return faults


def circles(of: House) -> list[set[str]]:
    """Rooms that need each other, by any way."""
    needs: dict[str, set[str]] = {}
    for module, _, target in of.arrows():
        if of.room(module) != of.room(target) and of.room(target) != "aiorts/__init__.py":
            needs.setdefault(of.room(module), set()).add(of.room(target))
    reached: dict[str, set[str]] = {}
    for room in needs:
        seen: set[str] = set()
        todo = [room]
        while todo:
            for other in needs.get(todo.pop(), ()):
                if other not in seen:
                    seen.add(other)
                    todo.append(other)
        reached[room] = seen
    return [{room, other} for room in reached for other in reached[room] if room in reached.get(other, ())]


def test_every_import_points_down() -> None:
    assert upward(house()) == []


def test_a_room_round_the_microkernel_is_imported_through_its_face() -> None:
    inner = {module for module in house().files if module.startswith(tuple(f"aiorts.{room}" for room in SERVICES))}
    assert [
        f"{module}:{one.line}: {one.module}"
        for module, found in house().imports.items()
        for one in found
        for target in [f"{one.module}.{one.name}" if f"{one.module}.{one.name}" in inner else one.module]
        if target in inner - house().faces and module.split(".")[:2] != target.split(".")[:2]
    ] == []


def test_no_rooms_need_each_other() -> None:
    assert circles(house()) == []


def test_every_room_has_a_layer() -> None:
    rooms = {house().room(module) for module in house().files}
    ours = {room for room in rooms if not room.startswith("plugins")} - {"aiorts/__init__.py", "aiorts/__main__.py"}
    assert ours == {room for room in levels() if not room.startswith("plugins")}


def test_no_room_is_too_large_to_know() -> None:
    count: dict[str, int] = {}
    for module in house().files:
        room = house().room(module)
        count[room] = count.get(room, 0) + 1
    assert {room: files for room, files in count.items() if files > LARGEST_ROOM} == {}


def test_an_upward_import_is_found_wherever_it_stands(tmp_path: Path) -> None:
    for folder in ("model", "kernel"):
        (tmp_path / "aiorts" / folder).mkdir(parents=True)
        (tmp_path / "aiorts" / folder / "__init__.py").write_text("from aiorts.kernel.context import Context\n")
    (tmp_path / "aiorts" / "errors.py").write_text("")
    (tmp_path / "aiorts" / "kernel" / "context.py").write_text("import aiorts.model.names\n")
    (tmp_path / "aiorts" / "model" / "names.py").write_text(
        "from typing import TYPE_CHECKING\n"
        "from aiorts.errors import AiortsError\n"
        "if TYPE_CHECKING:\n"
        "    from aiorts.kernel import Context\n"
        "def f():\n"
        "    import aiorts.kernel.context\n"
        "    return import_module('aiorts.kernel.context')\n"
    )
    assert upward(House(tmp_path)) == [f"aiorts.model.names:{line}: aiorts.kernel.context" for line in (4, 6, 7)]
    assert {"aiorts/model", "aiorts/kernel"} in circles(House(tmp_path))


def test_the_model_imports_values_only() -> None:
    for path in sources("aiorts/model"):
        tops = {one.module.split(".")[0] for one in imports(path)}
        assert tops <= sys.stdlib_module_names | {"aiorts"}, path
        assert not tops & MODEL_MAY_NOT, path


def test_a_microkernel_runs_components_with_no_service_loaded() -> None:
    """The proof that it is one: periodic and event components over connectors, and no room of a service imported."""
    program = f"""
import asyncio, sys
from aiorts.contexts import EventContext, PeriodicContext
from aiorts.kernel import Component, InPort, Microkernel, OutPort

class Source(Component):
    out = OutPort(float)
    def on_execute(self):
        self.out.write_nowait(1.5)

class Sink(Component):
    into = InPort(float)
    got = 0
    def on_execute(self):
        self.got += len(self.into.drain())
        if self.got >= 5:
            self.kernel.request_stop()

async def main():
    async with Microkernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.create(Sink)
        await kernel.connect(source.out, sink.into)
        await kernel.start(EventContext(), sink, activate=True)
        await kernel.start(PeriodicContext(rate=200.0), source, activate=True)
        await asyncio.wait_for(kernel.wait_stop_requested(), 30.0)
        assert sink.got >= 5
asyncio.run(main())
rooms = {SERVICES!r}
print(sorted(name for name in sys.modules if name.startswith("aiorts.") and name.split(".")[1] in rooms))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False, cwd=ROOT
    )
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def public_names(module: str) -> set[str]:
    return set(importlib.import_module(module).__all__)


def test_plugins_and_examples_import_the_public_face_only() -> None:
    faults = []
    for path in sources("plugins", "examples"):
        for one in imports(path):
            if one.module.split(".")[0] != "aiorts" or one.text or (one.name is None and one.module in PUBLIC):
                continue
            names = public_names(one.module) if one.module in PUBLIC else set()
            if not names & {one.name} and f"{one.module}.{one.name}" not in PUBLIC and one.name != "__version__":
                faults.append(f"{path.name}:{one.line}: {one.module}.{one.name or ''}")
    assert faults == []
