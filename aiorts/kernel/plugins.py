"""Loading what a plugin offers: on first use, whatever its import does reported as the plugin's own fault.

What there is to load is in `catalogue.py`. A kernel loads off its loop, so that a slow import delays no component,
and gives up on one that does not come to an end.
"""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
import os
import sys
import threading
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.errors import PluginError
from aiorts.kernel.catalogue import Catalogue, Extension, singular

if TYPE_CHECKING:
    from aiorts.clock import Clock

T = TypeVar("T")

__all__ = (
    "API",
    "cause_of",
    "class_of",
    "extensions",
    "load",
    "load_aside",
    "load_extension",
    "load_file",
    "load_in_time",
)

API: Final = 1
"""What aiorts offers to plugins; a module of one that sets `AIORTS_API` says which it was written for."""
_OURS: Final = str(Path(__file__).parents[1]) + os.sep
"""Where aiorts itself lies."""
_LONGEST: Final = 30.0
"""Seconds that an import may take."""


def extensions(kind: str) -> Mapping[str, tuple[Extension, ...]]:
    """What is offered under `kind`, by name."""
    return Catalogue.default().extensions(kind)


def load_extension(kind: str, name: str, catalogue: Catalogue | None = None) -> Any:
    """The object that is offered as `name`, in the default catalogue where none is given.

    Raises:
        PluginError: nobody offers it (near names are given), several do (all are named), or it cannot be imported.
    """
    return load((Catalogue.default() if catalogue is None else catalogue).find(kind, name))


def load(extension: Extension) -> Any:
    """The object itself. PluginError names the plugin and what went wrong."""
    where = _named(extension)
    try:
        found = _imported(extension)
    except PluginError as error:
        raise PluginError(f"{where}: {error}") from error.__cause__
    except BaseException as error:  # a plugin's border: whatever its import does is reported as the plugin's
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(f"{where} cannot be loaded: {cause_of(error)}") from error
    return found


def cause_of(error: BaseException) -> str:
    """What an import raised, with the file and line of the plugin that it came from: none of aiorts itself."""
    if isinstance(error, SyntaxError):
        text, file, line = error.msg, error.filename, error.lineno
    else:
        text, file, line = _text(error), None, None
    trace = error.__traceback__
    while trace is not None and not isinstance(error, SyntaxError):
        name = trace.tb_frame.f_code.co_filename
        if not name.startswith(("<", _OURS)):
            file, line = name, trace.tb_lineno
        trace = trace.tb_next
    where = "" if file is None else f" ({file}, line {line})"
    return f"{type(error).__name__}: {text}{where}"


def _text(thing: object) -> str:
    """What a plugin's object says of itself, as far as it does."""
    try:
        return str(thing)
    except Exception:  # noqa: BLE001 - a plugin's border
        return "(its text cannot be had)"


def load_in_time(extension: Extension, limit: float, prepare: Callable[[], None] | None = None) -> Any:
    """The object itself, loaded in a thread for which the caller waits, `limit` seconds of real time at the most.

    Args:
        prepare: called in that thread before.

    Raises:
        PluginError: it cannot be loaded, or was left behind while it was still being imported.
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


def _answer(extension: Extension) -> tuple[Any, PluginError | None]:
    """What was loaded, or why not; for a thread, in which nothing may be raised."""
    try:
        return load(extension), None
    except PluginError as error:
        return None, error
    except KeyboardInterrupt as raised:
        interrupted = PluginError(f"{_named(extension)}: interrupted itself while it was imported")
        interrupted.__cause__ = raised
        return None, interrupted


async def load_aside(extension: Extension, clock: Clock, base: type[T], limit: float = _LONGEST) -> type[T]:
    """A class derived from `base`, loaded in a thread, for at most `limit` seconds of real time.

    A simulated clock stands still meanwhile. PluginError names the plugin and what went wrong.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Any] = loop.create_future()
    hold = getattr(clock, "hold", None)
    held = None if hold is None else hold()

    def tell(error: BaseException | None, found: Any) -> None:
        if done.done():
            return
        if error is not None:
            done.set_exception(error)
        else:
            done.set_result(found)

    def tell_from_afar(error: BaseException | None, found: Any) -> None:
        with suppress(RuntimeError):  # the loop has been closed meanwhile: nobody wants to know any more
            loop.call_soon_threadsafe(tell, error, found)

    def work() -> None:
        found, error = _answer(extension)
        tell_from_afar(error, found)

    # A thread that nobody waits for: an import that never ends must not keep the interpreter from ending.
    threading.Thread(target=work, name=f"aiorts import {extension.name}", daemon=True).start()
    alarm = threading.Timer(limit, lambda: tell_from_afar(_too_slow(extension, limit), None))
    alarm.daemon = True
    alarm.name = f"aiorts alarm {extension.name}"
    alarm.start()
    try:
        found = await done
    finally:
        alarm.cancel()
        if held is not None:
            held.release()
    return class_of(extension, found, base)


def class_of(extension: Extension, found: Any, base: type[T]) -> type[T]:
    """What was loaded, which has to be a class derived from `base`; else PluginError."""
    if not (isinstance(found, type) and issubclass(found, base)):
        kind = getattr(found, "__qualname__", None) or f"an object of {type(found).__qualname__}"
        raise PluginError(f"{_named(extension)}: {kind} is no class derived from {base.__name__}")
    return found


def _too_slow(extension: Extension, limit: float) -> PluginError:
    return PluginError(f"{_named(extension)}: still being imported after {limit:g} s; it was left behind")


def _named(extension: Extension) -> str:
    return f"{singular(extension.kind)} {extension.name!r} of {extension.source} ({extension.target})"


def _imported(extension: Extension) -> Any:
    module_name, _, attributes = extension.target.partition(":")
    if module_name.endswith(".py") and extension.folder is not None:
        path = extension.folder / module_name
        if not path.resolve().is_relative_to(extension.folder.resolve()):
            raise PluginError(f"{module_name!r} is outside its folder; move the file into it")
        module = load_file(path)
    else:
        if extension.folder is not None:
            _make_importable(extension.folder)
        module = importlib.import_module(module_name.strip())
        if extension.folder is not None:
            _check_home(module, extension.folder)
    _check_api(module)
    found: Any = module
    for attribute in filter(None, attributes.strip().split(" ")[0].split(".")):
        found = getattr(found, attribute)
    return found


def load_file(path: Path) -> ModuleType:
    """The module of a single file, imported once, under a name of its own: two folders may have an `odometry.py` each.

    Raises:
        BaseException: whatever its import does.
    """
    with _lock_of(path):  # one that is being imported by another thread is waited for, not taken half done
        name = f"aiorts_system.{path.parent.name}.{path.stem}"
        for taken in (name, f"{name}_{zlib.crc32(str(path).encode()):08x}"):
            loaded = sys.modules.get(taken)
            if loaded is None:
                return _executed(taken, path)
            if loaded.__file__ == str(path):
                return loaded
    raise ImportError(f"{path}: another module has its name {name}")


def _executed(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # before it runs: dataclasses look themselves up there
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


_LOCK = threading.Lock()
_LOCKS: dict[str, threading.RLock] = {}
"""One for each file: an import that never ends holds up nobody else's."""


def _lock_of(path: Path) -> threading.RLock:
    with _LOCK:
        return _LOCKS.setdefault(str(path), threading.RLock())


def _make_importable(folder: Path) -> None:
    for place in (folder / "src", folder):
        # At the end: a plugin's `json.py` must not take the place of Python's.
        if place.is_dir() and str(place) not in sys.path:
            sys.path.append(str(place))


def _check_home(module: ModuleType, folder: Path) -> None:
    """A module of that name from elsewhere would be taken for the plugin's."""
    file = getattr(module, "__file__", None)
    if file is None or not Path(file).resolve().is_relative_to(folder.resolve()):
        raise PluginError(f"its module {module.__name__!r} comes from {file}; rename the plugin's module")


def _check_api(module: ModuleType) -> None:
    top = sys.modules.get(module.__name__.partition(".")[0])
    for one in (module, top):
        wanted = getattr(one, "AIORTS_API", API)
        if wanted != API:
            raise PluginError(f"it was written for version {wanted} of the plugin interface, this is {API}; update it")
