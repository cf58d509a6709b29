"""Things that are made at their first use: the names of a face, the methods of a dataclass, and the finders by which a
lower room asks a higher one.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
"""The flag of `typing`; importing that would take as long as all else until the command line can take Ctrl-C."""

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass
    from typing import Any

__all__ = ("dataclass", "finder", "late", "provide")


def late(*modules: str) -> None:
    """Make the imports of a face that stand under `if TYPE_CHECKING` when their names are first used.

    A face calls it once, at its own level and below these imports; type checkers see nothing but them.

    Args:
        modules: submodules that can be asked for like names.
    """
    caller = sys._getframe(1)
    face = caller.f_globals
    package: str = face["__name__"]
    # The code above the call runs again, as type checkers see it and without importing anything.
    noted: dict[str, Any] = {"__builtins__": {"__import__": lambda module, *_: _Noted(module)}}
    try:  # noqa: SIM105 - `contextlib` is not loaded yet
        exec(caller.f_code, noted)  # noqa: S102 - the face's own code
    except _CalledError:
        pass
    homes = {name: home for name, home in noted.items() if name not in face and not name.startswith("_")}

    def found(name: str) -> object:
        from importlib import import_module

        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        value = face[name] = getattr(import_module(home.module), home.name)
        return value

    face["__getattr__"] = found
    face["__dir__"] = lambda: sorted({*face, *homes, *modules})


class _CalledError(Exception):
    """The call of `late` is reached again."""


class _Noted:
    """A stand-in for a module, or for a name imported from it: both are true, and `late` is called."""

    __slots__ = ("module", "name")

    def __init__(self, module: str, name: str = "") -> None:
        self.module, self.name = module, name

    def __getattr__(self, name: str) -> _Noted:
        return _Noted(self.module, name)

    def __call__(self, *modules: str) -> None:
        raise _CalledError


_FINDERS: dict[str, Callable[[str], Callable[[str], Any]]] = {}


def provide(kinds: tuple[str, ...], finders: Callable[[str], Callable[[str], Any]]) -> None:
    """Use `finders` for the finders of these kinds ("types", "codecs"); it is called at the first use."""
    _FINDERS.update(dict.fromkeys(kinds, finders))


def finder(kind: str) -> Callable[[str], Any]:
    """The function that finds names of this kind that are not loaded."""
    return _FINDERS[kind](kind)


if not TYPE_CHECKING:

    def dataclass(*, slots: bool, **options: bool) -> Callable[[type], type]:
        """`dataclasses.dataclass(slots=True)`, whose methods are written when the class is first used.

        Writing them takes 0.4 ms a class, and was 30 % of the time of `from aiorts import Kernel`. The module of the
        class begins with `from __future__ import annotations`.
        """
        return lambda plain: _with_slots(plain, options)


def _with_slots(plain: type, options: dict[str, Any]) -> type:
    given = {name: value for name, value in vars(plain).items() if name not in ("__dict__", "__weakref__")}
    own = [name for name, kind in given.get("__annotations__", {}).items() if not kind.startswith("ClassVar")]
    space = {name: value for name, value in given.items() if name not in own}
    space["__declared__"] = {name: given[name] for name in own if name in given}

    def write() -> None:
        # Twice is as good as once: two threads may be here, or one again that was interrupted. `__init__`, which
        # begins it, is replaced last.
        from dataclasses import dataclass

        full = vars(dataclass(**options)(type(plain)(plain.__name__, plain.__bases__, dict(given))))
        kept = {*own, *frozen, "__dict__", "__weakref__", "__init__"}
        for name, value in full.items():
            if name not in kept and value is not given.get(name, given):
                setattr(cls, name, value)
        cls.__init__ = full["__init__"]  # type: ignore[misc]

    frozen = _FROZEN if options.get("frozen") else {}
    unwritten = {name: _Unwritten(name, write) for name in _WRITTEN}
    cls = type(plain)(
        plain.__name__,
        plain.__bases__,
        {**unwritten, **frozen, **space, "__slots__": tuple(own), "__qualname__": plain.__qualname__},
    )
    return cls


_WRITTEN = ("__init__", "__dataclass_fields__", "__dataclass_params__", "__match_args__")
"""The attributes that are looked up on a class, or that make its first instance."""


class _Unwritten:
    """The placeholder in a class for an attribute that `write` puts there."""

    __slots__ = ("_name", "_write")

    def __init__(self, name: str, write: Callable[[], None]) -> None:
        self._name, self._write = name, write

    def __get__(self, instance: object, owner: type) -> Any:
        self._write()
        return getattr(owner if instance is None else instance, self._name)


def _refuse(self: object, name: str, *value: object) -> None:
    from dataclasses import FrozenInstanceError

    raise FrozenInstanceError(f"cannot {'assign to' if value else 'delete'} field {name!r}")


def _state(self: Any) -> list[object]:
    from dataclasses import fields

    return [getattr(self, field.name) for field in fields(self)]


def _set_state(self: Any, state: list[object]) -> None:
    from dataclasses import fields

    for field, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, field.name, value)


_FROZEN = {"__setattr__": _refuse, "__delattr__": _refuse, "__getstate__": _state, "__setstate__": _set_state}
