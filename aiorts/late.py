"""Names that are imported when they are first used: a module of many names costs what is used of it."""

from __future__ import annotations

TYPE_CHECKING = False
"""What `typing` calls so; importing that would take as long as all else until the command line can take Ctrl-C."""

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ("late",)


def late(
    module: str, homes: Mapping[str, tuple[str, ...]], modules: frozenset[str] = frozenset()
) -> Callable[[str], object]:
    """A `__getattr__` for `module`.

    Args:
        homes: the names by the module that each is imported from.
        modules: submodules that can be asked for like names.
    """
    home = {name: place for place, names in homes.items() for name in names}

    def found(name: str) -> object:
        import sys
        from importlib import import_module

        if name in modules:
            return import_module(f"{module}.{name}")
        if name not in home:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(sys.modules[module], name, value)
        return value

    return found
