"""Connector options: defaults, bounds, OpenRTM's keys, and what is said of a mistake."""

from __future__ import annotations

import math
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import connect_options
from aiorts.errors import WiringError
from aiorts.model.buffer import EmptyPolicy, FullPolicy
from aiorts.model.connect_options import ConnectOptions
from aiorts.model.options import (
    OWN_KEYS,
    OWN_OPTIONS,
    SERVICE_KEYS,
    PortLimits,
    chosen_options,
    connector_profile,
    doubts,
    idle,
    link_options,
    with_openrtm,
    without_effect,
)
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription
from aiorts.model.profile import ConnectorProfile

CHOICES = {
    "dataflow": Dataflow,
    "subscription": Subscription,
    "push": Push,
    "full": FullPolicy,
    "empty": EmptyPolicy,
    "stamp": Stamp,
}


CHOSEN: dict[str, st.SearchStrategy[Any]] = {
    **{key: st.sampled_from(kind) for key, kind in CHOICES.items()},
    "push_rate": st.sampled_from([1.0, 50.0]),
    "length": st.integers(0, 10),
    "out_length": st.integers(1, 10),
    "skip": st.integers(0, 3),
    "timeout": st.sampled_from([None, 0.5, 1.0]),
    "measure": st.sampled_from([0, 10]),
    "keep_last": st.booleans(),
    "lifespan": st.sampled_from([None, 0.5]),
    "max_gap": st.sampled_from([None, 0.5]),
}


def profile(**options: Any) -> ConnectorProfile:
    return connector_profile("a.out -> b.in", options, "wire", ("a.out", "b.in"))[0]


def limits(**options: Any) -> PortLimits:
    return connector_profile("a.out -> b.in", options, "", ())[1]


def test_the_defaults_are_those_of_the_design() -> None:
    assert profile() == ConnectorProfile("wire", ("a.out", "b.in"))
    plain = profile()
    assert (plain.dataflow, plain.subscription, plain.push, plain.full) == ("push", "flush", "all", "overwrite")
    assert (plain.length, plain.out_length, plain.timeout, plain.stamp, plain.empty) == (8, 8, 1.0, None, None)
    assert [profile(subscription=kind, push_rate=1).push for kind in ("flush", "new", "periodic")] == [
        "all",
        "new",
        "new",
    ]
    assert profile(subscription="new").length == 1
    assert profile(subscription="new", push="all").length == 8


def test_flush_keeps_and_reports_a_push_policy_it_does_not_use() -> None:
    kept = profile(subscription="flush", push="new")
    assert kept.push == "new"
    assert kept.length == 8


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"dataflow": "pull", "length": 5}, ["length"]),
        ({"dataflow": "pull", "push": "all", "subscription": "new"}, ["push"]),
        ({"dataflow": "pull", "full": "block", "skip": 2, "push_rate": 5.0}, ["full", "skip", "push_rate"]),
        (
            {
                "dataport.dataflow_type": "pull",
                "dataport.inport.buffer.length": "5",
                "dataport.publisher.push_policy": "all",
            },
            ["dataport.inport.buffer.length", "dataport.publisher.push_policy"],
        ),
        ({"subscription": "new", "full": "block"}, ["full"]),
        ({"subscription": "new", "push": "new", "full": "reject", "length": 5}, ["full", "length"]),
        (
            {"dataport.subscription_type": "new", "inport.buffer.write.full_policy": "do_nothing"},
            ["inport.buffer.write.full_policy"],
        ),
        ({"out_length": 5}, ["out_length"]),
        ({"push_rate": 5.0}, ["push_rate"]),
        ({"subscription": "new", "push_rate": 5.0}, ["push_rate"]),
        ({"skip": 2}, ["skip"]),
        ({"push": "skip", "skip": 2}, ["push", "skip"]),
        ({"push": "new"}, ["push"]),
        ({"subscription": "flush", "push": "new", "length": 5}, ["push"]),
        ({"dataport.publisher.push_policy": "new"}, []),  # in each file of OpenRTM's tools
        ({"subscription": "new", "push": "all", "skip": 2}, ["skip"]),
        ({"subscription": "new", "push": "skip", "skip": 2}, []),
        ({"subscription": "periodic", "push_rate": 5.0, "push": "skip", "skip": 2}, []),
        ({"dataport.push_rate": "5", "dataport.publisher.skip_count": "2"}, []),  # in each file of OpenRTM's tools
        ({"subscription": "new", "push": "all", "out_length": 5, "length": 5}, ["out_length"]),
        ({"subscription": "new", "out_length": 5, "length": 5}, ["out_length", "length"]),
        # What is said as it is, and what chooses something:
        ({"subscription": "periodic", "push_rate": 5.0, "out_length": 5}, []),
        ({"dataport.outport.buffer.length": "5", "dataport.buffer.length": "3"}, []),
        ({"dataflow": "pull", "length": 1, "push": "new", "full": "overwrite", "stamp": "read"}, []),
        ({"dataflow": "pull"}, []),
        ({"subscription": "new", "full": "overwrite", "length": 1}, []),
        ({"subscription": "new", "push": "all", "full": "block", "length": 5}, []),
        ({"subscription": "periodic", "push": "new", "push_rate": 5.0, "full": "reject", "length": 5}, []),
        ({"length": 5, "full": "block"}, []),
        ({"push": "all"}, []),
        ({"push": "fifo"}, []),
        (link_options("", {"push": "new"}), []),
    ],
    ids=str,
)
def test_an_option_that_chooses_nothing_beside_the_others_is_found(options: dict[str, Any], named: list[str]) -> None:
    found = dict(idle(options, profile(**options)))
    assert list(found) == named
    for key, text in found.items():
        assert text.startswith(f"{key} chooses nothing where ")
        assert text.endswith("; take it away")


@pytest.mark.row(41)
@pytest.mark.fault("B13")
@pytest.mark.parametrize("key", ["length", "out_length", "dataport.inport.buffer.length", "dataport.buffer.length"])
@pytest.mark.parametrize("bad", [-1, 10**9, "abc", 1.5, math.inf, math.nan, True, "", [8]], ids=repr)
def test_a_length_out_of_range_is_refused_naming_the_range(key: str, bad: Any) -> None:
    with pytest.raises(WiringError, match=r"length = .*: expected a whole number from [01] to 1000000"):
        profile(**{key: bad})


def test_a_backlog_has_room_for_one_sample() -> None:
    with pytest.raises(WiringError, match=r"out_length = 0: expected a whole number from 1 to 1000000"):
        profile(out_length=0)


@pytest.mark.parametrize("good", [1, 1_000_000, "8", 8.0])
def test_a_length_in_range_is_taken(good: Any) -> None:
    assert profile(length=good).length == int(good)


def test_no_time_at_all_is_a_timeout_like_any_other() -> None:
    """The ends of a range are in it."""
    assert profile(timeout=0).timeout == 0.0


@pytest.mark.row(40)
@pytest.mark.fault("B14")
@pytest.mark.parametrize("bad", [0, -1, math.nan, "fast", math.inf, True], ids=repr)
@pytest.mark.parametrize("key", ["push_rate", "dataport.push_rate", "dataport.publisher.push_rate"])
def test_a_bad_push_rate_is_refused(key: str, bad: Any) -> None:
    """OpenRTM takes 1000 Hz instead and says nothing."""
    with pytest.raises(WiringError, match=r"push_rate = .*: expected a number from"):
        profile(subscription="periodic", **{key: bad})


@pytest.mark.fault("B14")
def test_periodic_without_a_rate_is_refused() -> None:
    with pytest.raises(WiringError, match="periodic needs a push_rate in Hz"):
        profile(subscription="periodic")


@pytest.mark.fault("B14")
@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({"push": "newst"}, "push = 'newst': expected all, fifo, skip, new; did you mean 'new'?"),
        ({"subscription": "flash"}, "did you mean 'flush'?"),
        ({"full": "overwrit"}, "did you mean 'overwrite'?"),
        ({"dataport.publisher.push_policy": "fif"}, "did you mean 'fifo'?"),
        ({"stamp": "sent"}, "did you mean 'send'?"),
        ({"dataflow": "duplex"}, "expected push, pull"),
        ({"lenght": 3}, "unknown option 'lenght'; did you mean 'length'?"),
        ({"subscripton": "new"}, "did you mean 'subscription'?"),
        ({"zzz": 3}, "unknown option 'zzz'; there are name, dataflow, subscription"),
        ({"skip": -1}, "skip = -1: expected a whole number from 0"),
        ({"timeout": -1}, "timeout = -1: expected a number from 0"),
        ({"timeout": "soon"}, "timeout = 'soon'"),
        ({"fan_in": 0}, "fan_in = 0: expected a whole number from 1"),
        ({"connection_limit": -2}, "connection_limit = -2"),
        ({"allow_dup_connection": "MAYBE"}, "expected true or false"),
    ],
    ids=repr,
)
def test_a_mistake_is_refused_where_it_was_made_with_a_hint(options: dict[str, Any], hint: str) -> None:
    with pytest.raises(WiringError, match=r"a\.out -> b\.in") as caught:
        profile(**options)
    assert hint in str(caught.value)


OPENRTM = [
    ({"dataflow_type": "pull"}, "dataflow", "pull"),
    ({"subscription_type": "new"}, "subscription", "new"),
    ({"io_mode": "block"}, "subscription", "flush"),
    ({"io_mode": "nonblock"}, "subscription", "new"),
    ({"io_mode": "periodic", "push_rate": "10"}, "subscription", "periodic"),
    ({"subscription_type": "flush", "io_mode": "nonblock"}, "subscription", "new"),
    ({"io_mode": "nonblock", "subscription_type": "flush"}, "subscription", "new"),
    ({"publisher.push_policy": "fifo"}, "push", "fifo"),
    ({"publisher.skip_count": "4"}, "skip", 4),
    ({"publisher.push_rate": "2.5"}, "push_rate", 2.5),
    ({"push_rate": "2.5"}, "push_rate", 2.5),
    ({"buffer.length": "3"}, "length", 3),
    ({"buffer.length": "3"}, "out_length", 3),
    ({"inport.buffer.length": "5", "buffer.length": "3"}, "length", 5),
    ({"inport.buffer.length": "5", "buffer.length": "3"}, "out_length", 3),
    ({"outport.buffer.length": "5", "buffer.length": "3"}, "out_length", 5),
    ({"outport.buffer.length": "5", "buffer.length": "3"}, "length", 3),
    ({"buffer.write.full_policy": "do_nothing"}, "full", "reject"),
    ({"buffer.write.full_policy": "block"}, "full", "block"),
    ({"inport.buffer.write.full_policy": "overwrite", "buffer.write.full_policy": "block"}, "full", "overwrite"),
    ({"outport.buffer.write.full_policy": "do_nothing"}, "full", "overwrite"),
    ({"outport.buffer.write.full_policy": "block", "buffer.write.full_policy": "do_nothing"}, "full", "reject"),
    ({"outport.buffer.write.timeout": "7"}, "timeout", 1.0),
    ({"outport.buffer.read.empty_policy": "block"}, "empty", None),
    ({"subscription_type": "New"}, "subscription", "new"),
    ({"io_mode": " NonBlock"}, "subscription", "new"),
    ({"buffer.write.full_policy": "Do_Nothing "}, "full", "reject"),
    ({"timestamp_policy": "ON_SEND"}, "stamp", "send"),
    ({"buffer.write.timeout": "0.25"}, "timeout", 0.25),
    ({"inport.buffer.write.timeout": "2", "buffer.write.timeout": "1"}, "timeout", 2.0),
    ({"buffer.read.empty_policy": "readback"}, "empty", "readback"),
    ({"inport.buffer.read.empty_policy": "block"}, "empty", "block"),
    ({"timestamp_policy": "on_write"}, "stamp", "send"),
    ({"timestamp_policy": "on_send"}, "stamp", "send"),
    ({"timestamp_policy": "on_received"}, "stamp", "received"),
    ({"timestamp_policy": "on_read"}, "stamp", "read"),
    ({"timestamp_policy": "none"}, "stamp", None),
    ({"inport.timestamp_policy": "on_read", "timestamp_policy": "on_write"}, "stamp", "read"),
    ({"sync_readwrite": "YES"}, "length", 0),
    ({"sync_readwrite": "YES"}, "full", "block"),
    ({"inport.sync_readwrite": "YES", "outport.sync_readwrite": "NO"}, "length", 0),
    ({"sync_readwrite": "NO"}, "length", 8),
    ({"sync_readwrite": "NO", "buffer.length": "0"}, "length", 0),
    ({"sync_readwrite": ""}, "full", "overwrite"),
    ({"dataflow_type": "Duplex"}, "length", 0),
    ({"dataflow_type": "duplex"}, "dataflow", "push"),
    ({"dataflow_type": "duplex", "sync_readwrite": "YES", "buffer.length": "0"}, "full", "block"),
    ({"outport.publisher.push_policy": "all", "publisher.push_policy": "new"}, "push", "all"),
]


@pytest.mark.row(39, 40, 41)
@pytest.mark.parametrize("prefix", ["dataport.", ""])
@pytest.mark.parametrize(("options", "key", "value"), OPENRTM, ids=repr)
def test_openrtms_keys_are_understood(options: dict[str, str], key: str, value: Any, prefix: str) -> None:
    assert getattr(profile(**{prefix + name: given for name, given in options.items()}), key) == value


ASKS_FOR_IT: list[dict[str, Any]] = [
    {"length": 0},
    {"length": "0"},
    {"dataport.buffer.length": "0"},
    {"sync_readwrite": "YES"},
    {"dataport.dataflow_type": "duplex"},
]


@pytest.mark.row(38)
@pytest.mark.parametrize(
    "other",
    [
        {"subscription": "new"},
        {"dataport.subscription_type": "new"},
        {"io_mode": "periodic", "push_rate": 1},
        {"full": "overwrite"},
        {"inport.buffer.write.full_policy": "do_nothing"},
        {"lifespan": 1.0},
    ],
    ids=repr,
)
@pytest.mark.parametrize("asked", ASKS_FOR_IT, ids=repr)
def test_what_a_rendezvous_cannot_be_is_refused_with_both_keys(asked: dict[str, Any], other: dict[str, Any]) -> None:
    with pytest.raises(WiringError, match="take one of them away") as caught:
        profile(**asked, **other)
    (said,) = asked.items()
    key, value = next(iter(other.items()))
    assert f"{key} = {value!r} does not go with {said[0]} = {said[1]!r}" in str(caught.value)


@pytest.mark.row(38)
@pytest.mark.parametrize("asked", ASKS_FOR_IT, ids=repr)
def test_what_says_the_same_as_a_rendezvous_is_taken(asked: dict[str, Any]) -> None:
    found = profile(**asked, subscription="flush", full="block", lifespan=None, skip=3, out_length=4, timeout=2)
    assert (found.length, found.full, found.dataflow, found.subscription, found.timeout) == (
        0,
        "block",
        "push",
        "flush",
        2.0,
    )
    assert list(doubts(asked)) == []
    assert without_effect(asked) == []


@pytest.mark.row(38)
def test_openrtms_other_words_for_a_rendezvous_are_refused() -> None:
    with pytest.raises(WiringError, match=r"length = 4 does not go with sync_readwrite = 'YES'"):
        profile(sync_readwrite="YES", length=4)
    with pytest.raises(WiringError, match=r"sync_readwrite = 'MAYBE': expected true or false"):
        profile(sync_readwrite="MAYBE")
    with pytest.raises(WiringError, match=r"dataflow_type = 'pull' does not go with length = 0"):
        profile(dataflow_type="pull", length=0)
    with pytest.raises(WiringError, match="dataflow_type and dataflow are one option with two values"):
        profile(dataflow_type="duplex", dataflow="push")


@pytest.mark.row(58)
def test_openrtms_limits_are_understood() -> None:
    given = limits(**{"dataport.fan_in": "3", "fan_out": 4, "connection_limit": "-1", "allow_dup_connection": "YES"})
    assert given == PortLimits(fan_in=3, fan_out=4, connection_limit=-1, allow_duplicate=True)
    assert limits(allow_dup_connection="NO") == limits() == PortLimits()


def test_keys_that_are_for_others_are_kept_and_reported() -> None:
    others = {
        "dataport.interface_type": "corba_cdr",
        "dataport.data_type": "IDL:RTC/TimedLong:1.0",
        "dataport.buffer_type": "ring_buffer",
        "dataport.marshaling_type": "cdr",
        "dataport.inport.marshaling_type": "cdr",
        "dataport.serializer.cdr.endian": "little,big",
        "dataport.buffer.read.timeout": "1.0",
        "dataport.interface_option.ros.topic": "chatter",
        "port.port_type": "DataInPort",
    }
    assert dict(profile(**others).extra) == others
    assert profile(length=3).extra == {}


@pytest.mark.fault("B14")
@pytest.mark.parametrize("key", ["dataport.measurement.exec_count", "inport.measurement.period_count"])
def test_a_count_of_sends_that_is_none_is_refused_also_where_nothing_is_measured(key: str) -> None:
    with pytest.raises(WiringError, match="expected a whole number from 1"):
        profile(**{key: "many"})


SPELLINGS = [
    *((key, word.value) for key, kind in CHOICES.items() for word in kind),
    *((key, word) for key, one in OWN_OPTIONS.items() for word in one.words),
]


@pytest.mark.slow(kept_by="test_one_word_in_two_spellings_is_one_value")
@pytest.mark.row(39, 40, 41)
@given(data=st.data())
def test_a_word_is_the_same_in_any_case_and_with_blanks_round_it(data: st.DataObject) -> None:
    key, word = data.draw(st.sampled_from(SPELLINGS))
    cased = "".join(data.draw(st.sampled_from([letter.lower(), letter.upper()])) for letter in word)
    blanks = st.text(" \t\n", max_size=3)
    given_word = data.draw(blanks) + cased + data.draw(blanks)
    assert profile(push_rate=1, **{key: given_word}) == profile(push_rate=1, **{key: word})


@pytest.mark.slow(kept_by="test_a_mistake_is_refused_where_it_was_made_with_a_hint")
@pytest.mark.fault("B14")
@given(key=st.sampled_from(sorted(CHOICES)), word=st.text(st.characters(codec="utf-8")))
def test_a_word_that_is_none_of_an_option_is_refused(key: str, word: str) -> None:
    known = {one for other, one in SPELLINGS if other == key} | ({""} if key in ("stamp", "empty") else set())
    assume(word.strip().lower() not in known)
    with pytest.raises(WiringError, match=rf"{key} = .*: expected "):
        profile(**{key: word})


def test_one_word_in_two_spellings_is_one_value() -> None:
    assert profile(**{"dataport.subscription_type": "Flush", "subscription": "flush"}).subscription == "flush"
    assert profile(**{"dataport.push": "All", "push": "all"}).push == "all"


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"interface_type": "corba_cdr"}, ["interface_type"]),
        (
            {"dataport.inport.marshaling_type": "cdr", "dataport.sync_readwrite": "NO"},
            ["dataport.inport.marshaling_type"],
        ),
        ({"dataport.buffer.read.empty_policy": "readback"}, ["dataport.buffer.read.empty_policy"]),
        ({"empty": "block"}, ["empty"]),
        ({"outport.buffer.write.full_policy": "block"}, ["outport.buffer.write.full_policy"]),
        ({"outport.buffer.length": 4, "inport.buffer.write.full_policy": "block", "push": "new", "empty": None}, []),
    ],
)
def test_options_that_are_taken_for_openrtm_alone_are_known(options: dict[str, Any], found: list[str]) -> None:
    assert without_effect(options) == found


def test_no_timeout_waits_for_ever_and_a_report_cannot_be_edited() -> None:
    kept = profile(timeout=None, **{"x.y": 1})
    assert kept.timeout is None
    assert kept.extra == {"x.y": "1"}
    with pytest.raises(TypeError):
        kept.extra["x.y"] = "2"  # type: ignore[index]
    with pytest.raises(AttributeError):
        kept.length = 4  # type: ignore[misc]


def test_one_option_in_two_spellings_with_two_values_is_refused() -> None:
    for one, other in (
        ("buffer.length", "length"),
        ("dataport.push_rate", "push_rate"),
        ("inport.buffer.length", "length"),
    ):
        with pytest.raises(WiringError, match=rf"{one} and {other} are one option with two values"):
            connector_profile("a.out -> b.in", {one: 4, other: 5}, "", ("a.out", "b.in"))
        connector_profile("a.out -> b.in", {one: 4, other: "4"}, "", ("a.out", "b.in"))
    kept = connector_profile("", {"buffer.length": 4, "out_length": 5}, "", ("a.out", "b.in"))[0]
    assert (kept.length, kept.out_length) == (4, 5)


def test_the_typed_keywords_are_exactly_the_options_there_are() -> None:
    assert connect_options.FILE.read_text(encoding="utf-8") == connect_options.text(), (
        "run python tests/connect_options.py"
    )
    hints = get_type_hints(ConnectOptions)
    assert set(hints) == ConnectOptions.__optional_keys__ == {*OWN_KEYS, *SERVICE_KEYS, "openrtm"}
    assert not ConnectOptions.__required_keys__
    for key, kind in CHOICES.items():
        words, enum = get_args(hints[key])
        assert enum is kind, key
        assert get_args(words) == tuple(member.value for member in kind), key


@given(st.dictionaries(st.sampled_from(["dataport.push_policy", "dataport.io_mode", "length", "skip"]), st.just("1")))
def test_keys_of_openrtm_count_as_if_they_were_keywords(given_keys: dict[str, Any]) -> None:
    assert with_openrtm({"name": "w", "openrtm": given_keys}) == {"name": "w", **given_keys}
    assert with_openrtm(given_keys) is given_keys


@pytest.mark.parametrize("wrong", ["new", 7, None, [("a", 1)], {1: "new"}])
def test_openrtm_has_to_be_a_mapping_of_keys(wrong: Any) -> None:
    with pytest.raises(WiringError, match=r"openrtm = .*: expected a mapping, such as \{'dataport"):
        with_openrtm({"openrtm": wrong})


def test_a_key_in_openrtm_and_beside_it_with_another_value_is_refused() -> None:
    assert with_openrtm({"full": "block", "openrtm": {"full": " Block "}})["full"] == " Block "
    with pytest.raises(WiringError, match="full stands in openrtm and beside it with two values; take one"):
        with_openrtm({"full": "block", "openrtm": {"full": "reject"}})


@pytest.mark.slow(kept_by="planning/test_save.py::test_what_a_program_made_is_saved_without_what_is_so_by_default")
@given(options=st.fixed_dictionaries({}, optional=CHOSEN), usual=st.sampled_from([None, 1, 8, 100]))
def test_the_options_chosen_make_the_same_profile_again_and_none_can_be_left_out(
    options: dict[str, Any], usual: int | None
) -> None:
    length = 8 if usual is None else usual
    try:
        profile, _ = connector_profile("", options, "", (), length)
    except WiringError:
        assume(False)
    chosen = chosen_options(profile, usual)
    assert connector_profile("", chosen, "", (), length)[0] == profile
    for key in chosen:
        try:
            fewer, _ = connector_profile("", {k: v for k, v in chosen.items() if k != key}, "", (), length)
        except WiringError:
            continue
        assert fewer != profile
