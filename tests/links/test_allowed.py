"""What other kernels may do with ports, as a table says it: which pattern decides, and which tables are none."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError
from aiorts.model.links import RIGHTS, Allowed

TABLE = {
    "write": {
        "station": ["!drive.trim", "drive.*", "lamp-1.*", "*.reset"],
        "anna": [],
        "*": ["display.text"],
    },
    "read": {"station": ["*.*"]},
}
NO_MATCH = "no pattern matches it"


@pytest.mark.parametrize(
    ("name", "right", "port", "why"),
    [
        ("station", "write", "drive.velocity", ""),
        ("station", "write", "drive.trim", "'station': '!drive.trim' denies it"),
        ("station", "write", "lamp-1.on", ""),
        ("station", "write", "lamp-2.on", f"'station': {NO_MATCH}"),
        ("station", "write", "arm.reset", ""),
        ("station", "write", "display.text", f"'station': {NO_MATCH}"),
        ("station", "write", "Drive.velocity", f"'station': {NO_MATCH}"),
        ("station", "write", "drive", f"'station': {NO_MATCH}"),
        ("anna", "write", "display.text", f"'anna': {NO_MATCH}"),
        ("other", "write", "display.text", ""),
        ("other", "write", "drive.velocity", f"'*': {NO_MATCH}"),
        ("", "write", "drive.velocity", f"'*': {NO_MATCH}"),
        ("*", "write", "display.text", ""),
        ("station", "read", "camera.image", ""),
        ("other", "read", "camera.image", "has neither 'other' nor '*'"),
        ("other", "call", "arm.pose", ""),
    ],
)
def test_the_first_pattern_of_a_names_own_list_decides(name: str, right: str, port: str, why: str) -> None:
    allowed = Allowed.of_table(TABLE, "[allow] of pc1/robot:")
    said = f"{port}: {name!r} may not {right} it: [allow] of pc1/robot: {right} {why}"
    assert allowed.refusal(name, right, port) == (said if why else "")


@pytest.mark.parametrize("table", [None, {}])
@pytest.mark.parametrize("right", RIGHTS)
def test_without_a_table_all_may_do_everything(table: Any, right: str) -> None:
    allowed = Allowed() if table is None else Allowed.of_table(table)
    assert allowed.refusal("anybody", right, "drive.velocity") == ""


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ([], "allow: expected a table by right, got []"),
        ({7: {}}, "allow: expected a table by right, got {7: {}}"),
        ({"write": {7: []}}, "allow: write: expected a table of patterns by name, got {7: []}"),
        ({"writes": {}}, "allow: expected read, write, call, got 'writes'"),
        ({"write": ["drive.*"]}, "allow: write: expected a table of patterns by name, got ['drive.*']"),
        ({"write": {"a": "drive.*"}}, "allow: write.a: expected a list of patterns, got 'drive.*'"),
        ({"call": {"a": [7]}}, "allow: call.a: expected COMPONENT.PORT, with * for any letters, got 7"),
        ({"read": {"*": ["drive"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got 'drive'"),
        ({"read": {"*": ["*"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got '*'"),
        ({"read": {"*": ["a.b.c"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got 'a.b.c'"),
        ({"read": {"*": ["k/a.b"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got 'k/a.b'"),
        ({"read": {"*": ["a.[bc]"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got 'a.[bc]'"),
        ({"read": {"*": ["!!a.b"]}}, "allow: read.*: expected COMPONENT.PORT, with * for any letters, got '!!a.b'"),
        (
            {"write": {"a": ["arm.*", "!arm.trim"]}},
            "allow: write.a: '!arm.trim' is never looked at: 'arm.*' before it matches all of it",
        ),
        (
            {"write": {"a": ["!*.*", "arm.*"]}},
            "allow: write.a: 'arm.*' is never looked at: '!*.*' before it matches all of it",
        ),
    ],
)
def test_what_is_no_table_is_refused_and_said(table: Any, said: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        Allowed.of_table(table)
    assert str(refused.value) == said


def test_the_names_are_those_that_have_lists() -> None:
    assert Allowed.of_table(TABLE).names == {"station", "anna"}


WORDS = st.text("ab*", min_size=1, max_size=3)
PATTERNS = st.builds("{}{}.{}".format, st.sampled_from(["", "!"]), WORDS, WORDS)
PORTS = st.builds("{}.{}".format, st.text("ab", min_size=1, max_size=3), st.text("ab", min_size=1, max_size=3))


@given(st.lists(PATTERNS, max_size=5), PORTS)
def test_any_list_that_is_taken_decides_as_its_first_match(patterns: list[str], port: str) -> None:
    try:
        allowed = Allowed.of_table({"call": {"*": patterns}})
    except ConfigurationError:
        covered = [one.lstrip("!") for one in patterns]
        assert any(fnmatchcase(two, one) for number, two in enumerate(covered) for one in covered[:number])
        return
    wanted = next((not one.startswith("!") for one in patterns if fnmatchcase(port, one.lstrip("!"))), False)
    assert (allowed.refusal("anybody", "call", port) == "") is wanted
