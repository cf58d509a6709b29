"""A tree of elements, frozen, which keeps all that stood in the file: order, prefixes, texts and comments."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

XMLNS: Final = "http://www.w3.org/2000/xmlns/"
"""The name space of the declarations of name spaces."""


class Attribute(NamedTuple):
    """One attribute, or the declaration of a name space."""

    name: str
    """The name as it is written: "rts:id"."""
    space: str
    """The name space, as a URI; "" for none."""
    local: str
    value: str


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment, or a processing instruction with its target."""

    text: str
    target: str = ""


@dataclass(frozen=True, slots=True)
class Element:
    """One element with all that is in it."""

    name: str
    """The name as it is written: "rts:Components"."""
    space: str
    local: str
    attributes: tuple[Attribute, ...] = ()
    children: tuple[Element | Comment | str, ...] = ()
    where: str = ""
    """FILE:LINE where it begins."""

    def get(self, space: str, local: str, default: str = "") -> str:
        """The value of an attribute."""
        for one in self.attributes:
            if one.local == local and one.space == space:
                return one.value
        return default

    def has(self, space: str, local: str) -> bool:
        """Whether there is such an attribute."""
        return any((one.space, one.local) == (space, local) for one in self.attributes)

    def elements(self, space: str = "", local: str = "") -> Iterator[Element]:
        """The elements directly in it; only those of a name space and name, if these are given."""
        for one in self.children:
            if isinstance(one, Element) and (not local or (one.space, one.local) == (space, local)):
                yield one

    @property
    def text(self) -> str:
        """The text directly in it."""
        return "".join(one for one in self.children if isinstance(one, str))

    def with_attribute(self, name: str, space: str, value: str | None) -> Element:
        """The element with another value of an attribute, at its place or at the end; None removes the attribute."""
        local = name.rpartition(":")[2]
        new = Attribute(name, space, local, value or "")
        kept = []
        found = False
        for one in self.attributes:
            if (one.space, one.local) != (space, local):
                kept.append(one)
            elif value is not None and not found:
                found = True
                kept.append(one._replace(value=value))
        if value is not None and not found:
            kept.append(new)
        return replace(self, attributes=tuple(kept))

    def edited(
        self,
        change: Callable[[Element], Element | None] = lambda child: child,
        added: Sequence[tuple[Sequence[str], Element]] = (),
    ) -> Element:
        """The element with other elements in it; texts, comments and the order of all others stay.

        Args:
            change: gives the replacement of each element directly in it; None removes the element, with the
                white space before it.
            added: new elements, each after the last element whose local name is in its list, else first.
        """
        step = self._step()
        children: list[Element | Comment | str] = []
        for child in self.children:
            if not isinstance(child, Element):
                children.append(child)
            elif (other := change(child)) is not None:
                children.append(other)
            elif children and isinstance(last := children[-1], str) and not last.strip():
                children.pop()
        after: Sequence[str] | None = None
        place = 0
        for before, element in added:
            if before != after:
                places = [n for n, one in enumerate(children) if isinstance(one, Element) and one.local in before]
                after, place = before, places[-1] + 1 if places else 0
            new: list[Element | str] = [step, indented(element, step)] if step else [element]
            children[place:place] = new
            place += len(new)
        if step and not any(isinstance(child, Element) for child in children):
            children = [child for child in children if not isinstance(child, str) or child.strip()]
        is_same = len(children) == len(self.children) and all(map(operator.is_, children, self.children))
        return self if is_same else replace(self, children=tuple(children))

    def _step(self) -> str:
        """The white space before each element in it; "" where it is not indented."""
        for before, one in zip(self.children, self.children[1:], strict=False):
            if isinstance(one, Element):
                return before if isinstance(before, str) and not before.strip() else ""
        return ""


def indented(element: Element, step: str = "\n") -> Element:
    """The element with each element on a line of its own, four spaces further in than its parent.

    Args:
        step: the white space before the element itself.
    """
    parts = list(element.elements())
    if not parts or any(isinstance(one, Comment) or (isinstance(one, str) and one.strip()) for one in element.children):
        return element
    inner = step + "    "
    children = [part for one in parts for part in (inner, indented(one, inner))]
    return replace(element, children=(*children, step))


def walk(element: Element) -> Iterator[Element]:
    """The element and all below it, in the order of the file."""
    waiting = [element]
    while waiting:
        one = waiting.pop()
        yield one
        waiting += reversed(list(one.elements()))
