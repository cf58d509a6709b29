"""The code of one component type, read again: finds the type, compiles and runs its file aside, and sets its names.

Nothing that is in use changes until `adopt`: until then the new module stands under a name of its own, so that no
import finds a half-made module. The file is always read, but not the files that it imports. Its byte code is not used:
that would miss an edit within one second that keeps the length.
"""

from __future__ import annotations

import asyncio
import importlib.util
import inspect
import itertools
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from aiorts.errors import AbsentError, ClosedError, DeclarationError, PluginError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.hooks import further_kinds
from aiorts.kernel.extensions.files import file_of_module
from aiorts.kernel.extensions.loading import cause_of
from aiorts.kernel.extensions.type_names import split_type
from aiorts.late import dataclass
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_NUMBERS = itertools.count(1)
_READ_ANEW: WeakKeyDictionary[type, tuple[int, str]] = WeakKeyDictionary()
"""The number of times that the code of a class was read again before, and the module that it stands for."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The module and file of a type's code."""

    module: str
    name: str
    """The name of the class within the module."""
    path: Path
    readings: int = 0
    """The number of times that it was read again before."""

    def __str__(self) -> str:
        return f"{self.path.name}:{self.name}"

    def is_of(self, cls: type) -> bool:
        """Whether a class is of this type: of this very code, or of an earlier or later reading of it."""
        return _key(cls) == (self.module, self.name)


@dataclass(frozen=True, slots=True)
class Code:
    """The code of an instance that takes the place of another."""

    origin: Origin
    cls: type[Component]
    readings: int


@dataclass(frozen=True, slots=True)
class FreshCode(Code):
    """A module that was read again and is not in use yet."""

    module: ModuleType

    def adopt(self) -> None:
        """Make this the module of its name: from now on, imports and look-ups of types get this module."""
        aside, name = self.module.__name__, self.origin.module
        _rename(vars(self.module).values(), aside, name)
        spec = self.module.__spec__
        self.module.__name__ = name
        if spec is not None:
            spec.name = name
            if isinstance(spec.loader, SourceFileLoader):
                spec.loader.name = name
        if name != "__main__":  # the program that runs stays what it is
            sys.modules[name] = self.module
            parent, _, child = name.rpartition(".")
            if parent in sys.modules:
                setattr(sys.modules[parent], child, self.module)
        sys.modules.pop(aside, None)

    def forget(self) -> None:
        """Forget this module, as if its file had not been read again."""
        if sys.modules.get(self.module.__name__) is self.module:
            del sys.modules[self.module.__name__]


# -- which type is meant -----------------------------------------------------------------------------------------------


def find_type(kernel: Microkernel, kind: type[Component] | str) -> Origin:
    """The type with instances that is meant by a class, its name, or a type as text (`extensions/type_names.py`).

    Raises:
        AbsentError: there is no such type.
        PluginError: there are several such types (all are named), or the type does not come from a file.
    """
    used = {_key(cls): cls for cls in map(type, kernel.components.values())}
    if isinstance(kind, str):
        found = [cls for cls in used.values() if _is_meant(kernel, kind, cls)]
        what = repr(kind)
    elif isinstance(kind, type) and issubclass(kind, Component):
        found = [used[key]] if (key := _key(kind)) in used else []
        what = kind.__qualname__
    else:
        raise PluginError(f"reload({kind!r:.80}): expected a component class, its name, or a text as 'pid.py:Pid'")
    if not found:
        names = sorted(cls.__qualname__ for cls in used.values())
        hint = suggestion(what.strip("'").rpartition(":")[2], names, None if names else "there are no components")
        raise AbsentError(f"reload({what}): no component of that type; {hint}")
    if len(found) > 1:
        several = ", ".join(f"{file_of(cls) or cls.__module__}:{cls.__qualname__}" for cls in found)
        raise PluginError(f"reload({what}): may be each of {several}; say which: a class, or 'file.py:Class'")
    return _origin(found[0])


def _is_meant(kernel: Microkernel, kind: str, cls: type) -> bool:
    if kind.endswith(".py"):
        return _same_file(kind, file_of(cls))
    home, name = split_type(kind)
    if home.endswith(".py"):
        return name == cls.__qualname__ and _same_file(home, file_of(cls))
    if home:
        return name == cls.__qualname__ and (home == _key(cls)[0] or _same_file(file_of_module(home), file_of(cls)))
    if kind in (cls.__name__, cls.__qualname__):
        return True
    for offer in kernel.plugins.extensions("components").get(kind, ()):
        module, _, attribute = offer.target.partition(":")
        if attribute.strip().split(" ")[0] == cls.__qualname__ and (
            module.strip() == _key(cls)[0]
            or (offer.folder is not None and _same_file(str(offer.folder / module.strip()), file_of(cls)))
        ):
            return True
    return False


def _same_file(wanted: str, file: Path | None) -> bool:
    if file is None or not wanted:
        return False
    path = Path(wanted)
    return path.resolve() == file or (not path.is_absolute() and file.parts[-len(path.parts) :] == path.parts)


def file_of(cls: type) -> Path | None:
    """The source file of the module of a class; None: there is no such file."""
    file = getattr(sys.modules.get(_key(cls)[0]), "__file__", None)
    return Path(file).resolve() if isinstance(file, str) and file.endswith(".py") else None


def _origin(cls: type[Component]) -> Origin:
    path, name = file_of(cls), cls.__qualname__
    if path is None:
        raise PluginError(f"{cls.__module__}.{name}: its code comes from no Python file; it cannot be read anew")
    if "<locals>" in name:
        raise PluginError(f"{path}: {name} is made by a function; only a class of the module itself can be read anew")
    return Origin(_key(cls)[0], name, path, readings_of(cls))


def code_of(cls: type[Component]) -> Code:
    """The present code of a class, for a component that is to become an instance of the class.

    Raises:
        DeclarationError: its `on_reload` cannot be called with the old instance.
    """
    declarations(cls).hook_kinds |= further_kinds(cls, Component, {"on_reload": ("self", "old")})
    module, name = _key(cls)
    path = file_of(cls) or Path(cls.__module__)
    return Code(Origin(module, name, path, readings_of(cls)), cls, readings_of(cls))


def _key(cls: type) -> tuple[str, str]:
    """The module's real name and the class's name; new code on trial is in a module of another name."""
    return _READ_ANEW[cls][1] if cls in _READ_ANEW else cls.__module__, cls.__qualname__


def readings_of(cls: type) -> int:
    """The number of times that the code had been read again when this class was made."""
    return next((_READ_ANEW[base][0] for base in cls.__mro__ if base in _READ_ANEW), 0)


def forget_file(path: Path) -> None:
    """Forget a file without components: it is read again when one of its types is wanted next."""
    for name, module in list(sys.modules.items()):
        if getattr(module, "__file__", None) == str(path):
            del sys.modules[name]


# -- reading it --------------------------------------------------------------------------------------------------------


class _Anew(SourceFileLoader):
    """Reads and compiles the source, whatever byte code there is, and leaves none."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        code: CodeType = self.source_to_code(self.get_data(path), path)
        return code


async def read_anew(kernel: Microkernel, origin: Origin, limit: float) -> FreshCode:
    """Read, compile and run the file in a thread, for at most `limit` seconds of real time.

    A simulated clock stands still meanwhile. A file that does not come to an end is abandoned.

    Raises:
        PluginError: names file and line; the class is gone, or is no component any more.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[ModuleType | PluginError] = loop.create_future()
    name = f"{origin.module}__{next(_NUMBERS)}"
    hold = getattr(kernel.clock, "hold", None)
    held = None if hold is None else hold()

    def deliver(outcome: ModuleType | PluginError) -> None:
        if not done.done():
            done.set_result(outcome)

    def report_from_thread(outcome: ModuleType | PluginError) -> None:
        with suppress(RuntimeError):  # the loop has been closed meanwhile: no caller waits any more
            loop.call_soon_threadsafe(deliver, outcome)

    too_slow = PluginError(f"{origin.path}: still being run after {limit:g} s; it was abandoned, nothing was changed")
    # A daemon thread: a file that never ends must not keep the interpreter from ending.
    work = threading.Thread(
        target=lambda: report_from_thread(_run(name, origin)), name=f"aiorts reload {origin}", daemon=True
    )
    alarm = threading.Timer(limit, report_from_thread, (too_slow,))
    alarm.daemon = True
    work.start()
    alarm.start()
    closing = kernel.closing
    try:
        waited: list[asyncio.Future[Any]] = [done, closing]
        await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
    finally:
        alarm.cancel()
        if held is not None:
            held.release()
        if not done.done() or isinstance(done.result(), PluginError):
            sys.modules.pop(name, None)
    if not done.done():
        raise ClosedError(f"{kernel.name}: closes; the reload was given up")
    outcome = done.result()
    if isinstance(outcome, PluginError):
        raise outcome
    try:
        return _fresh(origin, outcome)
    except PluginError:
        sys.modules.pop(name, None)
        raise


def _run(name: str, origin: Origin) -> ModuleType | PluginError:
    """In a thread: the module, or why there is none; raises nothing."""
    try:
        loader = _Anew(name, str(origin.path))
        spec = importlib.util.spec_from_file_location(name, origin.path, loader=loader)
        if spec is None:
            raise ImportError(f"{origin.path} is no Python file")
        module = importlib.util.module_from_spec(spec)
        module.__package__ = getattr(sys.modules.get(origin.module), "__package__", module.__package__)
        sys.modules[name] = module  # before it runs: dataclasses look themselves up there
        loader.exec_module(module)
    except BaseException as error:  # noqa: BLE001 - a component file's border: whatever running it does is reported as its own
        failed = PluginError(f"{origin}: cannot be loaded: {cause_of(error)}; nothing was changed")
        failed.__cause__ = error
        return failed
    return module


def _fresh(origin: Origin, module: ModuleType) -> FreshCode:
    cls: Any = module
    for part in origin.name.split("."):
        cls = getattr(cls, part, None)
    if not (isinstance(cls, type) and issubclass(cls, Component)):
        has = [name for name, value in vars(module).items() if _is_own(value, module)]
        now = "is no component class any more" if cls is not None else "is gone"
        raise PluginError(
            f"{origin.path}: {origin.name} {now} (the file has {', '.join(has) or 'none'}); nothing was changed"
        )
    try:
        declarations(cls).hook_kinds |= further_kinds(cls, Component, {"on_reload": ("self", "old")})
    except DeclarationError as error:
        line = _line_of(getattr(cls, "on_reload", None))
        raise PluginError(f"{origin.path}{line}: {error}; nothing was changed") from error
    readings = origin.readings + 1
    for value in vars(module).values():
        if _is_own(value, module):
            _READ_ANEW[value] = readings, origin.module
    return FreshCode(origin, cls, readings, module)


def _is_own(value: object, module: ModuleType) -> bool:
    return isinstance(value, type) and issubclass(value, Component) and value.__module__ == module.__name__


def _line_of(function: Any) -> str:
    code = getattr(inspect.unwrap(function), "__code__", None) if callable(function) else None
    return "" if code is None else f":{code.co_firstlineno}"


def _rename(values: Iterable[Any], aside: str, name: str) -> None:
    """Give the classes and functions of a module its real name."""
    for value in _named(values, aside, set()):
        value.__module__ = name


def _named(values: Iterable[Any], aside: str, seen: set[int]) -> Iterator[Any]:
    for value in tuple(values):
        if not isinstance(value, type | Callable) or id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, type) and value.__module__ == aside:
            yield value
            yield from _named(vars(value).values(), aside, seen)
        elif inspect.isfunction(value) and value.__module__ == aside:
            yield value
