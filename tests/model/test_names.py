"""Names and paths: what is refused is listed, with the allowed set; what is accepted survives parse and format."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import InvalidNameError
from aiorts.model.names import ALLOWED, Path, check_host, check_name, split_path
from campaign import cases

NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}", fullmatch=True)


@pytest.mark.parametrize("name", ["pid0", "input0", "3d_camera", "_x", "a", "A-b_9", "x" * 100])
def test_name_of_the_grammar_is_returned_as_it_is(name: str) -> None:
    assert check_name(name, "component") == name


@pytest.mark.fault("B12")
@pytest.mark.parametrize("character", [*"/*?#$,>. \t\n\0:;'\"\\<|&!()[]{}=+@~%^`", "é", "名", "🤖", "\u200b", "\ud800"])
def test_refused_character_is_named_with_the_allowed_set(character: str) -> None:
    with pytest.raises(InvalidNameError) as caught:
        check_name(f"pid{character}0", "port")
    message = str(caught.value)
    assert message.startswith("port name ")
    assert f"{character!a} not allowed" in message
    assert ALLOWED in message


@pytest.mark.fault("B12")
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "is empty"),
        ("x" * 200, "has 200 characters"),
        ("-x", "starts with '-'"),
        (5, "got int"),
        (None, "got NoneType"),
    ],
)
def test_name_of_wrong_form_says_why(name: object, why: str) -> None:
    with pytest.raises(InvalidNameError, match=re.escape(why)):
        check_name(name, "component")


def test_message_of_a_huge_name_stays_one_short_line() -> None:
    with pytest.raises(InvalidNameError) as caught:
        check_name("".join(map(chr, range(256, 20_256))), "component")
    assert len(str(caught.value)) < 400
    assert "\n" not in str(caught.value)


@pytest.mark.slow(kept_by="test_refused_character_is_named_with_the_allowed_set")
@pytest.mark.fault("B12")
@settings(max_examples=2_000)
@given(st.text(max_size=220))
def test_any_text_is_either_of_the_grammar_or_refused(text: str) -> None:
    allowed = 1 <= len(text) <= 100 and text[0] != "-" and all(c.isascii() and (c.isalnum() or c in "_-") for c in text)
    if allowed:
        assert check_name(text, "port") == text
    else:
        with pytest.raises(InvalidNameError, match="allowed: "):
            check_name(text, "port")


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("pid0", Path("pid0")),
        ("pid0.command", Path("pid0", "command")),
        ("kernel/pid0.command", Path("pid0", "command", "kernel")),
        ("host/kernel/pid0.command", Path("pid0", "command", "kernel", "host")),
        ("192.168.0.7/k/pid0", Path("pid0", "", "k", "192.168.0.7")),
    ],
)
def test_path_is_read_and_written(text: str, path: Path) -> None:
    assert Path.parse(text) == path
    assert str(path) == text


@pytest.mark.slow(kept_by="test_path_is_read_and_written")
@settings(max_examples=cases(10_000))
@given(NAMES, st.none() | NAMES, st.none() | NAMES, st.none() | NAMES)
def test_every_path_survives_format_and_parse(
    component: str, port: str | None, kernel: str | None, host: str | None
) -> None:
    path = Path(component, port or "", kernel or "", (host or "") if kernel else "")
    assert Path.parse(str(path)) == path


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("pid*", (None, None, "pid*", None)),
        ("pid0.", (None, None, "pid0", "")),
        ("robot/", (None, "robot", "", None)),
        ("h.local/r?/[pq]id0.out.*", ("h.local", "r?", "[pq]id0", "out.*")),
        ("//pid0", ("", "", "pid0", None)),
    ],
)
def test_the_parts_of_a_path_may_be_patterns(text: str, parts: tuple[str | None, ...]) -> None:
    assert split_path(text) == parts


@pytest.mark.slow(kept_by="test_path_is_read_and_written")
@settings(max_examples=2_000)
@given(st.text(alphabet="ab0_-./ *", max_size=12))
def test_text_that_parses_is_written_back_unchanged(text: str) -> None:
    try:
        path = Path.parse(text)
    except InvalidNameError:
        return
    assert str(path) == text


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "component name '': is empty"),
        (".command", "component name '': is empty"),
        ("pid0.", "port name '': is empty"),
        ("pid0.a.b", "'.' not allowed"),
        ("pid0.a.b", "did you mean 'pid0.a_b'?"),
        ("host/k/pid0.a.b.c", "did you mean 'host/k/pid0.a_b_c'?"),
        ("/pid0", "kernel name '': is empty"),
        ("//pid0", "kernel name '': is empty"),
        ("a b/k/pid0", "' ' not allowed"),
        ("a/b/c/d", "4 parts between '/'"),
        ("a..b/k/pid0", "two in a row"),
    ],
)
def test_path_of_wrong_form_says_which_part(text: str, why: str) -> None:
    with pytest.raises(InvalidNameError, match=re.escape(why)) as caught:
        Path.parse(text)
    assert repr(text) in str(caught.value)


def test_host_needs_a_kernel() -> None:
    with pytest.raises(InvalidNameError, match="a host needs a kernel"):
        Path("pid0", host="robot")


@pytest.mark.parametrize("host", ["localhost", "robot.local", "10.0.0.1", "a_b-c", "x" * 253])
def test_host_is_returned_as_it_is(host: str) -> None:
    assert check_host(host) == host


@pytest.mark.parametrize("host", ["", ".", "a.", ".a", "-a", "a..b", "a/b", "x" * 254, "hôte", None])
def test_host_of_wrong_form_is_refused(host: object) -> None:
    with pytest.raises(InvalidNameError, match="allowed: "):
        check_host(host)
