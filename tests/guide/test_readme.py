"""README is short, begins with what a reader asks first, runs as pasted, and promises only what a quick test shows."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import marks
from aiorts.guide import blocks, pages
from aiorts.system import graph, load
from guide_blocks import anchors, links, run_page

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
LONGEST = 160
FIRST, LATER = 20, 45
"""Lines of the first screen, and of the first two."""

PROMISES = {
    # Run it, a program
    "heading verified: 1216 of 1216 within 1e-6 rad": (
        "examples/test_roomba.py::test_the_command_of_the_readme_runs_with_nothing_else_running"
    ),
    "`aiorts demo` runs a small system": "cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly",
    "A program": "functions/test_function_use.py::test_a_kernel_creates_it_by_class_with_parameters",
    "A hook with a misspelt name would never run": (
        "kernel/test_declarations.py::test_a_misspelt_hook_is_refused_when_the_class_is_made"
    ),
    "Each component is a command, in lower case": (
        "cli/test_plugins_commands.py::test_a_command_of_a_plugin_ends_as_it_wants"
    ),
    "show and change a running system without preparation": (
        "control/test_change.py::test_parameters_are_in_force_when_conf_returns_read_by_their_types"
    ),
    "a generator that you have already becomes a component": (
        "functions/test_function_use.py::test_an_installed_one_is_a_filter_whose_parameters_are_options"
    ),
    "the loop, its signals and your logging as they are": (
        "kernel/test_embedding.py::test_importing_and_running_installs_nothing_in_the_process"
    ),
    "build, run and change a system in Jupyter": (
        "examples/test_notebook.py::test_its_cells_build_run_and_change_a_system"
    ),
    "A system file has components, connections and contexts": (
        "examples/test_pid.py::test_the_cart_comes_to_the_set_point"
    ),
    "SIGUSR1 makes `aiorts run` print the stacks of all threads": (
        "cli/test_signals.py::test_usr1_prints_state_and_stacks_and_the_run_goes_on"
    ),
    "the error proposes a FlexiFilter between them": (
        "system/test_check.py::test_the_filter_that_would_join_two_ports_is_told_and_does"
    ),
    "`aiorts graph system.toml -o system.svg` writes a picture": (
        "cli/test_graph.py::test_the_end_of_the_file_name_says_the_form"
    ),
    "prints the same as a JSON Schema for editors": "cli/test_schema.py::test_it_is_a_schema_in_strict_json",
    "`aiorts run` notifies systemd by itself": (
        "examples/test_deploy.py::test_it_is_ready_answers_the_watchdog_and_stops_at_sigterm"
    ),
    # Filters, recordings
    "Every installed component is a command": (
        "cli/test_filter.py::test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1"
    ),
    "A bad line is reported with its number": (
        "cli/test_filter_lines.py::test_of_ten_thousand_lines_one_in_a_hundred_is_bad_and_all_others_are_processed"
    ),
    "The seven [Flexi components](../reference/flexi.md) are filters": (
        "examples/test_flexi.py::test_a_system_says_what_it_verified_and_fails_on_another_result"
    ),
    "`FlexiLogger` is a component that plays a recording back": (
        "flexi/test_logger_replay_command.py::test_options_choose_what_is_played"
    ),
    "A recorder that is killed leaves a file that opens": (
        "log/test_writer.py::test_what_was_said_to_be_on_the_disk_is_there_after_a_kill"
    ),
    "Every byte has a checksum, which is always checked": (
        "log/test_reader.py::test_a_check_finds_every_flipped_byte_but_in_the_name_of_who_wrote_it"
    ),
    "prints samples as lines of JSON, `convert` writes a table": (
        "log/test_convert.py::test_numbers_and_texts_at_the_edge_come_back"
    ),
    "recordings that become bags (rosbag2) and back": (
        "log/test_ros_messages.py::test_a_bag_of_all_twelve_comes_back_equal_in_every_field"
    ),
    "replays it with the same result every time": (
        "examples/test_recording.py::test_replayed_it_gives_the_heading_of_the_robot"
    ),
    # Services, sets, machines, composites
    "`connect` compares the interfaces": (
        "services/test_service_wiring.py::test_another_interface_is_refused_at_connect_with_the_difference"
    ),
    "an error at once, with the way of the call": (
        "services/test_serialised.py::test_a_circle_of_calls_is_an_error_at_once_that_tells_the_way"
    ),
    "its connectors go on, and no unread sample is lost": (
        "kernel/test_port_groups.py::test_no_sample_is_lost_on_a_connector_that_stays"
    ),
    "takes effect between two cycles, whole or not at all": (
        "kernel/test_configuring.py::test_of_a_thousand_changes_good_and_bad_while_hooks_run_none_is_ever_half_done"
    ),
    "whose behaviour is a table of states and transitions": (
        "statemachines/test_state_machine.py::test_a_door_opens_and_closes_by_ports_and_timers_alone"
    ),
    "several components that look and run as one": (
        "composites/test_shared_context.py::test_members_share_a_context_in_their_order_and_leave_their_own"
    ),
    "how a component that fails is brought back, how often": (
        "supervision/test_supervisor.py::test_crash_loop_is_helped_exactly_five_times_and_ends_in_one_line"
    ),
    "a profile, and then each change of it": (
        "observe/test_changes.py::test_changes_applied_to_the_snapshot_give_the_later_snapshot"
    ),
    "of a component is replaced while the system runs": (
        "reload/test_reloading.py::test_code_is_replaced_while_it_runs"
    ),
    "range finders that are calibrated over the network": (
        "examples/test_lrf.py::test_a_pose_that_is_not_right_is_said_and_ends_with_status_1"
    ),
    "a recorded drive, a force-controlled arm": (
        "examples/test_manipulator.py::test_the_force_settles_and_the_brake_holds"
    ),
    # The command line, plugins, virtual time
    "`aiorts doctor` says what this user is granted": (
        "cli/test_doctor.py::test_it_looks_at_everything_and_measures_the_timer"
    ),
    "Print the script with which SHELL completes aiorts's commands": "cli/test_completion.py::test_bash_completes",
    "The status that each command of `aiorts` ends with": "cli/test_exits.py::test_each_command_keeps_to_it",
    "lists all names that are offered, without importing anything": (
        "cli/test_plugins.py::test_what_is_installed_is_listed_and_nothing_imported"
    ),
    "a force-controlled arm, a plugin, a service for systemd": "examples/test_plugin.py::test_as_it_lies_there",
    "A `Rig` runs components in a kernel of their own": (
        "testing/test_rig.py::test_component_in_a_rig_is_fed_ticked_and_asked"
    ),
    # What you can rely on
    "**No sample disappears uncounted**": (
        "ports/test_connector.py::test_survivors_and_ledger_are_those_of_the_reference_model_after_every_step"
    ),
    "samples of several connectors in the order of arrival": (
        "ports/test_fan.py::test_samples_are_read_in_order_of_arrival_and_each_tells_its_source"
    ),
    "**Data do not change under a reader**": (
        "ports/test_out_port.py::test_no_reader_sees_what_a_writer_changes_afterwards"
    ),
    "**A component's fault stays its own**": (
        "execution/test_failing_hooks.py::test_whatever_a_hook_raises_is_the_error_of_its_component_alone"
    ),
    "A fault of aiorts itself is logged as one": (
        "kernel/test_internal_faults.py::test_a_context_goes_on_after_a_fault_of_its_own_and_the_run_has_failed"
    ),
    "A kernel ends within 5 s, from any state": (
        "execution/test_hook_timeout.py"
        "::test_kernel_with_many_stuck_components_in_several_contexts_closes_within_five_seconds"
    ),
    "ticks run + ticks skipped = elapsed time x rate": (
        "contexts/test_ten_hours.py::test_ticks_counted_one_by_one_neither_drift_nor_get_lost"
    ),
    "real-time scheduling never waits for another thread's lock": (
        "realtime/test_lock_free_connector.py::test_the_lock_of_a_port_is_never_taken_by_a_real_time_thread"
    ),
    "a simulated clock gives the same bytes every time": (
        "determinism/test_determinism.py::test_two_processes_on_two_loops_each_give_the_same_bytes"
    ),
    # Policies, contexts, types
    "what changed beyond the spread": "bench/test_compare.py::test_slow_down_of_one_row_is_found_and_of_no_other",
    "the same class runs in each of them": "testing/test_rig.py::test_one_test_serves_every_kind_of_context",
    "late execution context names the code that made it late": (
        "diagnostics/test_blame.py::test_a_neighbour_that_sleeps_is_named_with_component_hook_and_line"
    ),
    "The 126 record types keep their names": "types/test_record.py::test_openrtm_has_126_records_and_5_enums",
    "Structural limits are checked before anything is allocated": (
        "wire/test_scan.py::test_array_head_that_lies_is_refused_before_anything_is_allocated"
    ),
    "and knows nothing above it": (
        "architecture/test_layers.py::test_a_microkernel_runs_components_with_no_service_loaded"
    ),
}


def text() -> str:
    return README.read_text(encoding="utf-8")


def test_it_is_short_and_its_first_screen_says_what_for_whom_and_shows_it() -> None:
    lines = text().splitlines()
    assert len(lines) <= LONGEST
    first = "\n".join(lines[:FIRST])
    told = ["runs software as components", "It is for", "](examples/roomba/system.svg)", "<!-- command: run -->"]
    assert [first.find(words) for words in told] == sorted(first.index(words) for words in told)
    assert "Use something else" in "\n".join(lines[:LATER])


def test_its_picture_is_that_of_the_system_that_its_command_runs() -> None:
    system = load(ROOT / "examples" / "roomba" / "system.toml")
    assert (ROOT / "examples" / "roomba" / "system.svg").read_text(encoding="utf-8") == graph(system, language="svg")


def test_every_link_leads_to_a_file_and_a_heading_of_the_repository() -> None:
    wrong = []
    for link in links(text()):
        target, _, fragment = link.partition("#")
        path = ROOT / target
        if not path.exists() or (fragment and fragment not in anchors(path.read_text(encoding="utf-8"))):
            wrong.append(link)
    assert wrong == []


@pytest.mark.slow
def test_what_it_shows_runs_as_pasted(tmp_path: Path) -> None:
    """All but the two commands that set up, which nox runs to the letter."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    shown = re.sub(r"<!-- command: \w+ -->\n```sh\n.*?```\n", "", text(), flags=re.DOTALL)
    assert len(blocks(text())) == len(blocks(shown)) + 2
    assert run_page(shown, tmp_path) >= 2


@pytest.mark.slow(kept_by="first")
def test_each_promise_stands_in_readme_or_guide_and_has_a_quick_test() -> None:
    said = " ".join(" ".join([text(), *(page.text for page in pages())]).split())
    defined = marks.defined(marks.TESTS)
    assert [words for words in PROMISES if words not in said] == [], "neither in README nor in the guide any more"
    assert [test for test in PROMISES.values() if test not in defined] == [], "no such test"
    assert [test for test in PROMISES.values() if marks.is_slow(test)] == [], "not among the quick tests"
