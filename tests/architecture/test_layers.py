"""An import only points down, and a plugin imports the public face alone; late and typing-only imports count too."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAYERS = (
    {"errors", "late"},
    {"timer_heap"},
    {"clock"},
    {"model"},
    {"types"},
    {"wire"},
    {"kernel"},
    {"contexts"},
    {"running", "events", "statechart"},
    {"system"},
    {"testing"},
    {"cli", "bench"},
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
PUBLIC = (
    "aiorts",
    "aiorts.events",
    "aiorts.statechart",
    "aiorts.types",
    "aiorts.errors",
    "aiorts.clock",
    "aiorts.wire",
    "aiorts.system",
    "aiorts.testing",
)
"""What a plugin may import from: modules with `__all__`, and only names in it."""
BUILT_LIKE_A_USER = ("cli", "bench")
MODEL_MAY_NOT = {"asyncio", "threading", "time", "socket", "subprocess", "selectors", "signal", "logging", "concurrent"}


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def imports(path: Path, package: str) -> list[tuple[int, str, tuple[str, ...]]]:
    """(line, absolute module, names) of every import in the file, wherever it stands."""
    found: list[tuple[int, str, tuple[str, ...]]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = ".".join(parts[: len(parts) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            found.append((node.lineno, module, tuple(alias.name for alias in node.names)))
    return found


def package_of(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).parent.parts)


def upward_imports(path: Path, root: Path = ROOT) -> list[str]:
    """Imports of a file of aiorts that do not point down."""
    parts = path.relative_to(root).with_suffix("").parts
    if len(parts) == 2 and parts[1] in ("__init__", "__main__"):
        return []  # the public face itself: gathers from every layer
    own = LEVEL[parts[1]]
    faults = []
    for line, module, names in imports(path, package_of(path, root)):
        if module == "aiorts":
            targets = [f"aiorts.{name}" for name in names] or ["aiorts"]
        elif module.startswith("aiorts."):
            targets = [module]
        else:
            continue
        for target in targets:
            top = target.split(".")[1] if "." in target else ""
            level = LEVEL.get(top, LEVEL["testing"] - 1)  # a name of the public face: above the kernel
            if level > own or (level == own and top != parts[1] and top in LEVEL):
                faults.append(f"{'/'.join(parts)}.py:{line}: {target}")
    return faults


@pytest.mark.parametrize("path", sources("aiorts"), ids=lambda path: str(path.relative_to(ROOT)))
def test_import_points_down(path: Path) -> None:
    assert upward_imports(path) == []


def test_every_part_of_the_package_has_a_layer() -> None:
    parts = {
        path.stem for path in (ROOT / "aiorts").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert parts - {"__init__", "__main__"} == LEVEL.keys() & parts


def test_an_upward_import_is_found_wherever_it_stands(tmp_path: Path) -> None:
    folder = tmp_path / "aiorts" / "model"
    folder.mkdir(parents=True)
    path = folder / "x.py"
    path.write_text(
        "from typing import TYPE_CHECKING\n"
        "from aiorts.errors import AiortsError\n"
        "from . import names\n"
        "from ..kernel import kernel\n"
        "if TYPE_CHECKING:\n"
        "    from aiorts.types import Time\n"
        "def f():\n"
        "    import aiorts.wire.codec\n"
        "    from aiorts import Kernel\n"
    )
    assert upward_imports(path, tmp_path) == [
        "aiorts/model/x.py:4: aiorts.kernel",
        "aiorts/model/x.py:6: aiorts.types",
        "aiorts/model/x.py:8: aiorts.wire.codec",
        "aiorts/model/x.py:9: aiorts.Kernel",
    ]


@pytest.mark.parametrize("path", sources("aiorts/model"), ids=lambda path: path.name)
def test_model_imports_values_only(path: Path) -> None:
    tops = {module.split(".")[0] for _, module, _ in imports(path, package_of(path, ROOT))}
    assert tops <= sys.stdlib_module_names | {"aiorts"}
    assert not tops & MODEL_MAY_NOT


def public_names(module: str) -> set[str] | None:
    """`__all__` of a module, read from its source; None when it has none."""
    base = ROOT / Path(*module.split("."))
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
            assert node.value is not None
            return set(ast.literal_eval(node.value))
    return None


def private_imports(path: Path, package: str) -> list[str]:
    faults = []
    for line, module, names in imports(path, package):
        if module.split(".")[0] != "aiorts":
            continue
        if module not in PUBLIC:
            faults.append(f"{path.name}:{line}: {module} is not public")
            continue
        allowed = public_names(module) or set()
        submodules = {name.rpartition(".")[2] for name in PUBLIC if name.startswith(f"{module}.")}
        faults += [f"{path.name}:{line}: {module}.{name}" for name in names if name not in allowed | submodules]
    return faults


@pytest.mark.parametrize("path", sources("plugins", "examples"), ids=lambda path: str(path.relative_to(ROOT)))
def test_plugin_and_example_import_the_public_face_only(path: Path) -> None:
    assert (
        private_imports(path, package_of(path, ROOT / "plugins") if path.is_relative_to(ROOT / "plugins") else "") == []
    )
