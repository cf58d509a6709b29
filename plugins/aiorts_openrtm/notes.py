"""Notes on content that could not be carried over from one form to another, each with its place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Note:
    """A note on content of one form that the other form lacks or expresses differently."""

    where: str
    """FILE:LINE, or the name of a component."""
    text: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"
