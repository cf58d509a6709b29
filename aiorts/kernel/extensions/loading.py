"""Loading what a plugin offers: on first use, whatever its import does reported as the plugin's own fault.

What there is to load is in `catalogue.py`. A kernel loads off its loop, so that a slow import delays no component,
and gives up on one that does not come to an end.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from types import FunctionType
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from aiorts.errors import DeclarationError, PluginError
from aiorts.kernel.extensions.catalogue import AbsentExtension
from aiorts.kernel.extensions.files import INSTALL, is_loaded, load_file, load_module, make_importable
from aiorts.kernel.loop.exceptions import trace_of
from aiorts.kernel.loop.origins import place
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from pathlib import Path
    from types import ModuleType

    from aiorts.clock import Clock

T = TypeVar("T")


API: Final = 1
"""The version of aiorts' interface to plugins; a plugin's module names in `AIORTS_API` the one it was written for."""
_OURS: Final = os.path.abspath(f"{__file__}/../../..") + os.sep
"""The folder of aiorts itself."""
_LONGEST: Final = 30.0
"""Seconds that an import may take."""


class Offer(Protocol):
    """An extension to be loaded, as `catalogue.py` has found it."""

    @property
    def kind(self) -> str: ...

    @property
    def name(self) -> str: ...

    @property
    def target(self) -> str: ...

    """"module:attribute", or "file.py:Class" of a single file."""

    @property
    def source(self) -> str: ...

    """The package or folder that offers it; "" for a target that a user typed."""

    @property
    def folder(self) -> Path | None: ...

    """The folder of its modules, for an extension that is not installed."""

    @property
    def described(self) -> str: ...

    """Its kind, name, source and target, for messages; a target that a user typed, as it was typed."""


def load(extension: Offer) -> Any:
    """The object itself. PluginError names the plugin and what went wrong; AbsentExtension: it is not there."""
    where = extension.described
    try:
        found = _imported(extension)
    except PluginError as error:
        is_absent = not extension.source and isinstance(error.__cause__, AttributeError)
        kind = AbsentExtension if is_absent else PluginError
        raise kind(f"{where}: {error}") from error.__cause__
    except BaseException as error:  # a plugin's border: whatever its import does is reported as the plugin's
        if issubclass(type(error), KeyboardInterrupt):
            raise
        if not extension.source and type(error) is ModuleNotFoundError and _is_of(error.name, extension):
            raise AbsentExtension(
                f"{where}: no module named {error.name!r}; {_near_module(str(error.name))}"
            ) from error
        raise PluginError(f"{where} cannot be loaded: {cause_of(error)}") from error
    return found


def is_imported(extension: Offer) -> bool:
    """Whether its module is imported already, so that loading it runs no code."""
    module = extension.target.partition(":")[0].strip()
    if module.endswith(".py") and extension.folder is not None:
        return is_loaded(extension.folder / module)
    return module in sys.modules


def _is_of(missing: str | None, extension: Offer) -> bool:
    """Whether the module that is missing is the one asked for, or a package above it."""
    return bool(missing) and f"{extension.target.partition(':')[0].strip()}.".startswith(f"{missing}.")


def _near_module(name: str) -> str:
    parent, _, last = name.rpartition(".")
    paths = getattr(sys.modules.get(parent), "__path__", None) if parent else None
    if parent and paths is None:
        return f"{parent!r} is no package"
    from pkgutil import iter_modules

    known = {module.name for module in iter_modules(paths)}
    return suggestion(last, known, INSTALL, shown=lambda near: f"{parent}.{near}" if parent else near)


_SYNTAX: Final = (SyntaxError, IndentationError, TabError)
"""The interpreter's own, by their exact type: what derives from them may do anything when it is looked at."""


def cause_of(error: BaseException) -> str:
    """The text of an import's exception, with the file and line of the plugin that it came from."""
    if type(error) in _SYNTAX:
        assert isinstance(error, SyntaxError)  # noqa: S101 - one of these
        text, file, line = error.msg, error.filename, error.lineno
    else:
        text, file, line = _text(error), None, None
    trace = trace_of(error)
    while trace is not None and type(error) not in _SYNTAX:
        name = trace.tb_frame.f_code.co_filename
        if not name.startswith(("<", _OURS)):
            file, line = name, trace.tb_lineno
        trace = trace.tb_next
    if type(error) is DeclarationError and file is not None and line is not None:
        line = _line_of_field(text, file, line)
    where = "" if file is None else f" ({place(file, line)})"
    return f"{type(error).__name__}: {text}{where}"


def _line_of_field(text: str, file: str, line: int) -> int:
    """The line of the field that a text begins with (`Class.field: ...`), where its class is made at `line`."""
    import ast
    import linecache

    owner, _, field = text.partition(":")[0].rpartition(".")
    with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
        for node in ast.walk(ast.parse("".join(linecache.getlines(file)))):
            if isinstance(node, ast.ClassDef) and node.name == owner.rpartition(".")[2]:
                found = [one.lineno for one in node.body if getattr(getattr(one, "target", None), "id", "") == field]
                if found and line in (node.lineno, *(one.lineno for one in node.decorator_list)):
                    return found[0]
    return line


def _text(thing: object) -> str:
    """The text of a plugin's object, as far as it has one."""
    try:
        return str(thing)
    except BaseException:  # noqa: BLE001 - a plugin's border
        return "(its text cannot be had)"


def load_in_time(extension: Offer, limit: float, prepare: Callable[[], None] | None = None) -> Any:
    """The object itself, loaded in a thread for which the caller waits, at most `limit` seconds of real time.

    Args:
        prepare: called in that thread before.

    Raises:
        PluginError: it cannot be loaded, or was abandoned while it was still being imported.
    """
    answers: list[tuple[Any, PluginError | None]] = []

    def work() -> None:
        if prepare is not None:
            prepare()
        answers.append(_answer(extension))

    thread = threading.Thread(target=work, name=f"aiorts import {extension.name}", daemon=True)
    thread.start()
    thread.join(limit)
    if not answers:
        raise _too_slow(extension, limit)
    found, error = answers[0]
    if error is not None:
        raise error
    return found


def _answer(extension: Offer) -> tuple[Any, PluginError | None]:
    """The loaded object, or the error; for a thread, in which nothing may be raised."""
    try:
        return load(extension), None
    except PluginError as error:
        return None, error
    except KeyboardInterrupt as raised:
        interrupted = PluginError(f"{extension.described}: interrupted itself while it was imported")
        interrupted.__cause__ = raised
        return None, interrupted


async def load_aside(extension: Offer, clock: Clock, base: type[T], limit: float = _LONGEST) -> type[T]:
    """A class derived from `base`, loaded as `load_object_aside` does."""
    return class_of(extension, await load_object_aside(extension, clock, limit), base)


async def load_object_aside(extension: Offer, clock: Clock, limit: float = _LONGEST) -> Any:
    """The object itself, loaded in a thread, for at most `limit` seconds of real time.

    A simulated clock stands still meanwhile. PluginError names the plugin and what went wrong.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Any] = loop.create_future()
    hold = getattr(clock, "hold", None)
    held = None if hold is None else hold()

    def deliver(error: BaseException | None, found: Any) -> None:
        if done.done():
            return
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(found)

    def report_from_thread(error: BaseException | None, found: Any) -> None:
        with suppress(RuntimeError):  # the loop has been closed meanwhile: no caller waits any more
            loop.call_soon_threadsafe(deliver, error, found)

    def work() -> None:
        found, error = _answer(extension)
        report_from_thread(error, found)

    # A daemon thread: an import that never ends must not keep the interpreter from ending.
    threading.Thread(target=work, name=f"aiorts import {extension.name}", daemon=True).start()
    alarm = threading.Timer(limit, lambda: report_from_thread(_too_slow(extension, limit), None))
    alarm.daemon = True
    alarm.name = f"aiorts alarm {extension.name}"
    alarm.start()
    try:
        found = await done
    finally:
        alarm.cancel()
        if held is not None:
            held.release()
    return found


def class_of(extension: Offer, found: Any, base: type[T]) -> type[T]:
    """The loaded object, which has to be a class derived from `base`; else PluginError."""
    if not (isinstance(found, type) and issubclass(found, base)):
        kind = getattr(found, "__qualname__", None) or f"an object of {type(found).__qualname__}"
        derived = "class" if base is object else f"class derived from {base.__name__}"
        raise PluginError(f"{extension.described}: {kind} is no {derived}")
    if found is base:
        raise PluginError(f"{extension.described}: {base.__name__} itself does nothing; name a class derived from it")
    return found


def _too_slow(extension: Offer, limit: float) -> PluginError:
    return PluginError(f"{extension.described}: still being imported after {limit:g} s; it was abandoned")


def _imported(extension: Offer) -> Any:
    module_name, _, attributes = extension.target.partition(":")
    if module_name.endswith(".py") and extension.folder is not None:
        path = extension.folder / module_name
        if not path.resolve().is_relative_to(extension.folder.resolve()):
            raise PluginError(f"{module_name!r} is outside its folder; move the file into it")
        module = load_file(path, extension.folder)
    else:
        if extension.folder is not None:
            make_importable(extension.folder)
        module = load_module(module_name.strip())
        if extension.folder is not None:
            _check_home(module, extension.folder)
    _check_api(module)
    found: Any = module
    for attribute in filter(None, attributes.strip().split(" ")[0].split(".")):
        try:
            found = getattr(found, attribute)
        except AttributeError as error:
            raise PluginError(f"there is no {attribute!r}; {_near_name(extension.kind, attribute, found)}") from error
    return found


def _near_name(kind: str, wanted: str, found: Any) -> str:
    """The name that may have been meant among the classes of a module or class; functions where they are offered."""

    held = getattr(found, "__dict__", {})
    meant, word = (FunctionType, "function") if kind in ("converters", "describers") else (type, "class")
    names = [name for name, value in held.items() if isinstance(value, meant) and not name.startswith("_")]
    own = [name for name in names if getattr(held[name], "__module__", "") == getattr(found, "__name__", "")]
    return suggestion(wanted, own or names, f"it has {', '.join(own[:12]) or f'no {word}'}")


def _check_home(module: ModuleType, folder: Path) -> None:
    """A module of that name from elsewhere would be taken for the plugin's."""
    from pathlib import Path

    file = getattr(module, "__file__", None)
    if file is None or not Path(file).resolve().is_relative_to(folder.resolve()):
        raise PluginError(f"its module {module.__name__!r} comes from {file}; rename the plugin's module")


def _check_api(module: ModuleType) -> None:
    top = sys.modules.get(module.__name__.partition(".")[0])
    for one in (module, top):
        wanted = getattr(one, "AIORTS_API", API)
        if wanted != API:
            raise PluginError(f"it was written for version {wanted} of the plugin interface, this is {API}; update it")
