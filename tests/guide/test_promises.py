"""The page of promises names the tests that hold them: a name that no test has is a promise that nothing holds."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from aiorts.guide import page

TESTS = Path(__file__).parents[1]
LEFT_OUT = {"a", "an", "the", "and"}
"""Words by which a sentence differs from the name of its test."""


def words(name: str) -> str:
    plain = re.sub(r"(?<=\d),(?=\d)|'", "", name.lower())
    return " ".join(word for word in re.findall(r"[a-z0-9]+", plain) if word not in LEFT_OUT)


@pytest.mark.slow
def test_every_test_that_the_page_of_promises_names_is_there() -> None:
    found = page("delivery")
    assert found is not None
    text = re.sub(r"^```.*?^```$", "", found.text, flags=re.DOTALL | re.MULTILINE)
    named = re.findall(r"(?<!\*)\*([^*]+)\*(?!\*)", text)
    there = {
        words(name)
        for path in TESTS.rglob("test_*.py")
        for name in re.findall(r"def test_(\w+)", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 15
    assert [name for name in named if words(name) not in there] == []
