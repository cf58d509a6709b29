"""Every flaw of the original components, by its number in our reading of their source, and the tests that it is gone.

The numbers are those of the list of what the components of 2008 to 2010 did; "5d" is the d-th thing said under 12.5.
"""

from __future__ import annotations

import ast
import random
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts.testing import simulated
from aiorts.types import TimedLong, TimedLongSeq, type_name
from aiorts_flexi.common.ports import parse_port
from aiorts_flexi.mapping.mapping import Mapping, Rules
from campaign import cases

TESTS = Path(__file__).parents[1]

FLAWS: dict[str, tuple[str, tuple[str, ...]]] = {
    "0.1": ("options in globals: one instance for a process", ("flexi/test_originals:test_several_of_a_kind",)),
    "0.2": (
        "values of options left as words; --opt=value unknown",
        ("cli/test_filter_options:test_a_value_may_begin",),
    ),
    "0.3": (
        "types of one module only, and enumerations taken for types",
        ("flexi/test_originals:test_types_of_any_module", "flexi/test_ports:test_a_bad_port_is_refused"),
    ),
    "0.4": ("scalar ports begin with [] as data", ("flexi/test_filter:test_the_map_of_the_paper_works",)),
    "0.5": ("ports added again at each start of the context", ("flexi/test_originals:test_ports_are_made_once",)),
    "0.6": (
        "one sample a cycle, the rest lost in silence",
        (
            "flexi/test_filter:test_every_sample_gives_one_sample",
            "flexi/test_filter:test_it_loses_nothing",
            "flexi/test_dupe:test_it_loses_nothing",
            "flexi/test_dump:test_every_sample_is_a_line",
            "flexi/test_add:test_all_waits_for_one_sample_of_each",
        ),
    ),
    "0.7": (
        "errors caught and forgotten: never in state ERROR",
        (
            "flexi/test_filter:test_what_cannot_be_converted_is_an_error",
            "flexi/test_add:test_lengths_that_differ",
            "flexi/test_select:test_a_selection_out_of_range_is_an_error",
            "cli/test_filter:test_a_component_that_fails_ends_the_filter_with_status_3",
        ),
    ),
    "0.8": (
        "data shared between ports",
        ("flexi/test_originals:test_what_comes_out_shares_no_memory", "flexi/test_flaws:test_who_gets_a_copy"),
    ),
    "0.9": (
        "prints, whatever the verbosity",
        ("flexi/test_originals:test_nothing_is_printed", "flexi/test_select:test_nothing_is_printed"),
    ),
    "0.10": (
        "exit status 0 after a wrong option",
        (
            "cli/test_filter:test_a_mistake_in_typed_text_is_one_error",
            "cli/test_filter_options:test_a_value_that_is_refused",
        ),
    ),
    "1a": ("Add: all -p but the first forgotten", ("cli/test_filter_options:test_an_option_given_twice",)),
    "1b": (
        "Add: TYPE without :N, or with no number, a traceback; N <= 0 accepted",
        ("flexi/test_ports:test_what_is_accepted_as_a_type_and_a_number",),
    ),
    "1c": (
        "Add: an input that has not sent breaks the sum of scalars",
        ("flexi/test_add:test_last_adds_the_last_known",),
    ),
    "1d": ("Add: bytes and characters are no sequences", ("flexi/test_add:test_every_type_is_added_or_refused",)),
    "1e": ("Add: shorter inputs an IndexError, longer ones cut", ("flexi/test_add:test_lengths_that_differ",)),
    "1f": (
        "Add: a sum beyond its type",
        ("flexi/test_add:test_a_sum_out_of_range", "flexi/test_add:test_integer_sums"),
    ),
    "1g": ("Add: texts a TypeError, truth values integers", ("flexi/test_add:test_what_has_no_sum",)),
    "1h": ("Add: no records", ("flexi/test_add:test_scalars_vectors_and_records",)),
    "1i": ("Add: time of whichever input came last by number", ("flexi/test_add:test_the_time_is_of_the_samples",)),
    "2a": ("Select: a bad index stays stored", ("flexi/test_select:test_a_selection_out_of_range_is_an_error",)),
    "2b": (
        "Select: a negative index selects from the end",
        ("flexi/test_select:test_a_selection_out_of_range_is_an_error",),
    ),
    "2c": (
        "Select: old samples come out on switching",
        ("flexi/test_select:test_no_old_sample_comes_out", "flexi/test_select:test_against_a_model"),
    ),
    "2d": ("Select: no hold and no none", ("flexi/test_select:test_out_of_range_may_hold",)),
    "2e": ("Select: nobody is told what is selected", ("flexi/test_select:test_by_time_stamp_each_sample_goes",)),
    "2f": ("Select: TimedShort only", ("flexi/test_select:test_any_integer_or_truth_value_selects",)),
    "3a": ("Dupe: parse errors are tracebacks", ("flexi/test_dupe:test_a_bad_spec_is_refused_with_the_place",)),
    "3b": (
        "Dupe: one slow reader delays the others",
        ("flexi/test_dupe:test_a_reader_that_blocks", "flexi/test_dupe:test_two_readers_that_block"),
    ),
    "4a": (
        "Dump: names and ports of different number not checked",
        ("flexi/test_dump:test_bad_parameters_are_refused",),
    ),
    "4b": (
        "Dump: the data stands in the place of the name",
        ("flexi/test_dump:test_a_line_is_name_type_time_and_data",),
    ),
    "4c": ("Dump: no time of arrival, no formats", ("flexi/test_dump:test_arrival_is_kernel_time",)),
    "4d": ("Dump: types without time", ("flexi/test_originals:test_types_of_any_module",)),
    "5a": (
        "Const: eval",
        ("flexi/test_const:test_no_constant_runs_anything", "cli/test_filter:test_a_constant_is_never_code"),
    ),
    "5b": (
        "Const: a module needs a second one; its name replaced in texts",
        ("cli/test_filter_options:test_types_of_a_module_of_the_user",),
    ),
    "5c": ("Const: 0, False and [] are failures", ("cli/test_filter:test_a_constant_that_is_false",)),
    "5d": (
        "Const: records without data send their defaults",
        ("flexi/test_const:test_several_types_with_and_without",),
    ),
    "5e": (
        "Const: no check of type, length and range",
        ("flexi/test_literal:test_a_value_that_does_not_fit", "flexi/test_literal:test_a_sequence_of_the_wrong_length"),
    ),
    "5f": ("Const: time by a float", ("flexi/test_const:test_the_rate_is_its_own",)),
    "5g": ("Const: the rate is that of its context", ("flexi/test_const:test_the_rate_is_its_own",)),
    "5h": ("Const: one port", ("flexi/test_const:test_several_types_with_and_without",)),
    "6.1": (
        "Filter: what is not understood is skipped",
        (
            "flexi/test_grammar:test_what_is_accepted_as_a_map_is_the_grammar",
            "flexi/test_grammar:test_a_bad_map_is_refused_with_the_place",
        ),
    ),
    "6.2": ("Filter: nothing can become a UShort", ("flexi/test_mapping:test_every_value_of_every_type",)),
    "6.3": (
        "Filter: text to truth value and others impossible",
        ("flexi/test_mapping:test_every_value_of_every_type", "flexi/test_mapping:test_text_says_what_it_is"),
    ),
    "6.4": (
        "Filter: times sorted in place; pins that never came are of 1970",
        (
            "flexi/test_flaws:test_the_time_of_a_sample_is_of_its_pins",
            "flexi/test_filter:test_the_time_is_of_the_sources",
        ),
    ),
    "6.5": (
        "Filter: bool('False'), int('3.7'), 3.99 is 3, no ranges",
        ("flexi/test_mapping:test_text_says_what_it_is", "flexi/test_filter:test_no_value_is_changed_in_silence"),
    ),
    "6.6": (
        "Filter: a sequence that is too short loses the cycle, and nobody knows",
        ("flexi/test_filter:test_what_cannot_be_converted_is_an_error",),
    ),
    "6.7": (
        "Filter: pins of scalars ignored, entries overwrite each other, no offset",
        (
            "flexi/test_filter:test_a_map_that_does_not_fit",
            "flexi/test_filter:test_several_entries_to_one_pin",
            "flexi/test_mapping:test_factor_and_offset_of_integers_are_exact",
        ),
    ),
    "6.8": ("Filter: -z clears what is not sent", ("flexi/test_mapping:test_the_value_of_zero_old_is_only_sent",)),
    "6.9": ("Filter: verbosity used before it is set", ("flexi/test_originals:test_the_filter_prints_its_map",)),
    "7.1": (
        "Logger: a log is code, tied to import paths; no version, index, checksum, rotation, flush or append",
        (
            "log/test_reader:test_a_pickle_is_refused_by_its_first_bytes",
            "log/test_reader:test_nothing_that_a_file_names_is_imported",
            "log/test_reader:test_a_flipped_bit_never_gives_a_wrong_value",
            "log/test_reader:test_recordings_of_other_versions",
            "log/test_writer:test_a_killed_recorder_leaves_an_exact_prefix_that_opens_as_it_is",
            "flexi/test_recording:test_files_of_a_size_or_a_time",
            "flexi/test_recording:test_a_file_that_is_there_is_refused",
        ),
    ),
    "7.2": (
        "Logger: -g fails, with 0 too, and there is no speed",
        (
            "log/test_schedule:test_with_a_rate_their_own_times_do_not_count",
            "flexi/test_logger_replay_command:test_a_rate_that_makes_no_sense",
            "flexi/test_replaying:test_samples_leave_on_the_clock_of_the_kernel",
        ),
    ),
    "7.3": (
        "Logger: adjusted time stamps thrown away",
        ("flexi/test_replaying:test_stamps_are_now_and_with_absolute_as_recorded",),
    ),
    "7.4": (
        "Logger: types without a time stamp fail",
        (
            "flexi/test_recording:test_any_mix_of_ports_and_types",
            "log/test_player:test_of_types_without_a_stamp_nothing_is_shifted",
        ),
    ),
    "7.5": (
        "Logger: a second activation fails; starting it truncates the log",
        (
            "flexi/test_recording:test_activated_again_it_goes_on_in_the_same_file",
            "flexi/test_replaying:test_activated_again_it_plays_from_the_start",
            "flexi/test_recording:test_a_file_that_is_there_is_refused_before_anything_runs",
        ),
    ),
    "7.6": (
        "Logger: the end of a log is an error, and so is a sample that cannot be read",
        (
            "flexi/test_replaying:test_it_finishes_without_an_error",
            "flexi/test_replaying:test_of_one_that_breaks_off_or_is_damaged_everything_whole_is_played",
        ),
    ),
    "7.7": (
        "Logger: replayed in the order of reading; one late stamp stalls all, stamps of 0 break the offset",
        (
            "log/test_player:test_samples_of_all_ports_leave_in_the_order_and_at_the_distances_of_their_log_times",
            "log/test_player:test_of_types_without_a_stamp_nothing_is_shifted_and_one_that_was_never_set_stays_unset",
        ),
    ),
    "7.8": (
        "Logger: a burst after a pause of a replay, stale samples after one of a recording",
        (
            "log/test_schedule:test_whatever_happens_stamps_keep_step_with_the_clock_and_nothing_bursts",
            "flexi/test_recording:test_a_pause_by_parameter_leaves_no_stale_sample",
            "flexi/test_recording:test_a_recorder_begins_disabled_with_control_and_records_nothing_of_a_pause",
        ),
    ),
    "7.9": (
        "Logger: no seek, range, selection of ports, other names, speed or step",
        (
            "flexi/test_replaying:test_parameters_pause_step_move_and_hurry_it",
            "flexi/test_replaying:test_chosen_left_out_and_renamed",
            "flexi/test_logger_replay_command:test_options_choose_what_is_played",
        ),
    ),
    "7.10": (
        "Logger: sums of floats on the wall clock",
        (
            "log/test_player:test_in_hours_of_virtual_time_nothing_drifts",
            "flexi/test_recording:test_a_clock_that_is_put_back_does_not_turn_log_time_back",
        ),
    ),
    "7.11": (
        "Logger: one bad sample is an error of the component, and writing blocks its context",
        (
            "flexi/test_logger_record_faults:test_a_sample_for_which_there_is_no_memory_is_refused",
            "flexi/test_logger_record_faults:test_a_slow_disk_holds_up_neither_loop_nor_activation",
        ),
    ),
}


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(123)
def test_each_flaw_has_tests_that_exist() -> None:
    missing = []
    for number, (_, places) in FLAWS.items():
        for file, _, name in (place.partition(":") for place in places):
            text = (TESTS / f"{file}.py").read_text(encoding="utf-8")
            if not re.search(rf"^\s*(async )?def {name}", text, re.MULTILINE):
                missing.append(f"{number}: {file}:{name}")
    assert missing == []


def test_no_number_is_left_out() -> None:
    assert {number for number in FLAWS if number.startswith("0.")} == {f"0.{each}" for each in range(1, 11)}
    assert {number for number in FLAWS if number.startswith("6.")} == {f"6.{each}" for each in range(1, 10)}
    assert {number for number in FLAWS if number.startswith("7.")} == {f"7.{each}" for each in range(1, 12)}
    assert {number[0] for number in FLAWS} == set("01234567")


@dataclass
class Mutable:
    """A dataclass of a user that can be changed after it was written."""

    values: list[float] = field(default_factory=list)


@pytest.mark.parametrize(
    ("kind", "params", "source"),
    [
        ("FlexiDupe", {"inputs": ["TYPE:2"]}, "input0"),
        ("FlexiSelect", {"port": "TYPE:1"}, "input0"),
    ],
)
@simulated
async def test_who_gets_a_copy_cannot_change_what_another_got(kind: str, params: dict[str, Any], source: str) -> None:
    async with Kernel() as kernel:
        user = await kernel.create(Component)
        feed = user.add_port("feed", OutPort(Mutable))  # which makes the type known
        given = str(params).replace("TYPE", type_name(Mutable))
        component = await kernel.create(kind, **ast.literal_eval(given))
        await kernel.connect(feed, component.ports[source])
        outs = [port for port in component.ports.values() if isinstance(port, OutPort)]
        takers: list[InPort[Any]] = [user.add_port(f"taker{n}", InPort(Mutable)) for n in range(2)]
        for taker, out in zip(takers, outs * 2, strict=False):
            await kernel.connect(out, taker)
        await kernel.start(EventContext(), component, activate=True)
        mine = Mutable([1.0])
        feed.write_nowait(mine)
        mine.values.append(2.0)
        await kernel.sleep(0.1)
        (one,), (other,) = (taker.drain() for taker in takers)
        assert list(one.values) == list(other.values) == [1.0]
        with pytest.raises((AttributeError, TypeError)):
            one.values.append(3.0)


@pytest.mark.slow(kept_by="flexi/test_filter.py::test_the_time_is_of_the_sources_that_have_sent")
@given(st.randoms(use_true_random=False), st.sampled_from(["oldest", "newest"]), st.integers(1, 4))
@settings(max_examples=cases(3_000))
def test_the_time_of_a_sample_is_of_its_pins_for_as_long_as_it_runs(dice: random.Random, time: str, ports: int) -> None:
    """The original sorted the times of its pins in place: from the second sample on they were those of other pins."""
    specs = [parse_port("TimedLong", f"input{number}") for number in range(ports)]
    text = ",".join(f"{number}>0:{number}" for number in range(ports))
    mapping = Mapping(specs, [parse_port(f"TimedLongSeq:{ports + 1}", "output0")], text, Rules(time=time))
    last: dict[int, TimedLong] = {}
    for _ in range(20):
        new = {n: TimedLong(dice.randrange(10**9), dice.randrange(100)) for n in range(ports) if dice.random() < 0.6}
        last |= new
        made = mapping.apply(new, 0)
        if not new:
            assert made == []
            continue
        tm = (min if time == "oldest" else max)(sample.tm for sample in last.values())
        data = [last[number].data if number in last else 0 for number in range(ports + 1)]
        assert made == [("output0", TimedLongSeq(tm, data))]
