"""What is there when it is first used: the names of a face, the methods of a dataclass, and what a lower room asks a
higher one for by kind.
"""

from __future__ import annotations

TYPE_CHECKING = False
"""What `typing` calls so; importing that would take as long as all else until the command line can take Ctrl-C."""

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from dataclasses import dataclass
    from typing import Any

__all__ = ("dataclass", "finder", "late", "provide")


def late(face: dict[str, Any], homes: Mapping[str, str], modules: tuple[str, ...] = ()) -> None:
    """Import names into a module at their first use; type checkers see none of this.

    Args:
        face: `globals()` of the module.
        homes: names, with spaces between them, by the module that each is imported from.
        modules: submodules that can be asked for like names.
    """
    package: str = face["__name__"]
    home = {name: place for place, names in homes.items() for name in names.split()}

    def found(name: str) -> object:
        from importlib import import_module

        if name in modules:
            return import_module(f"{package}.{name}")
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = face[name] = getattr(import_module(home[name]), name)
        return value

    face["__getattr__"] = found
    face["__dir__"] = lambda: sorted({*face, *home, *modules})


_FINDERS: dict[str, Callable[[str], Callable[[str], Any]]] = {}


def provide(kinds: tuple[str, ...], finders: Callable[[str], Callable[[str], Any]]) -> None:
    """Use `finders` for the finders of these kinds ("types", "codecs"); it is called at the first use."""
    _FINDERS.update(dict.fromkeys(kinds, finders))


def finder(kind: str) -> Callable[[str], Any]:
    """What finds a name of this kind that is not loaded."""
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
        # Twice is as good as once: two threads may be here, or one again that was interrupted. What begins it,
        # `__init__`, is replaced last.
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
"""What is looked for on a class, or makes its first instance."""


class _Unwritten:
    """Stands in a class for an attribute that `write` puts there."""

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
