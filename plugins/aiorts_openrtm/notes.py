"""What could not be carried over from one form to another, each with its place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Note:
    """Something that stands in one form and is not, or not so, in the other."""

    where: str
    """FILE:LINE, or the name of a component."""
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"
