"""What README promises, in its words, and the quick tests that show it as a user would see it."""

from __future__ import annotations

from pathlib import Path

import rows
import tiers

README = Path(__file__).parents[2] / "README.md"

PROMISES = {
    # Run it, five minutes
    "heading verified: 1216 of 1216 within 1e-6 rad": (
        "examples/test_roomba.py::test_the_command_of_the_readme_runs_with_nothing_else_running"
    ),
    "`aiorts demo` runs a small system in the terminal": (
        "cli/test_demo.py::test_a_reader_that_has_seen_enough_ends_it_quietly"
    ),
    "### A component in ten lines": "examples/test_pid.py::test_the_component_is_the_readmes",
    "a misspelt one is refused when the class is made": (
        "kernel/test_declarations.py::test_a_misspelt_hook_is_refused_when_the_class_is_made"
    ),
    "`echo 1.5 | aiorts --plugins . pid` runs it alone, as a filter": (
        "cli/test_plugins_commands.py::test_a_command_of_a_plugin_ends_as_it_wants"
    ),
    "An existing function is a component in one line": (
        "functions/test_function_use.py::test_an_installed_one_is_a_filter_whose_parameters_are_options"
    ),
    "Event-loop policy, task factory, exception handler, signal handlers and logging are left as found": (
        "kernel/test_embedding.py::test_importing_and_running_installs_nothing_in_the_process"
    ),
    "In a notebook": "examples/test_notebook.py::test_its_cells_build_run_and_change_a_system",
    "### As a system file": "examples/test_pid.py::test_the_cart_comes_to_the_set_point",
    "`kill -USR1` prints its state and stacks": (
        "cli/test_signals.py::test_usr1_prints_state_and_stacks_and_the_run_goes_on"
    ),
    "put the FlexiFilter": "system/test_check.py::test_the_filter_that_would_join_two_ports_is_told_and_does",
    "`aiorts graph system.toml -o system.svg` draws it": (
        "cli/test_graph.py::test_the_end_of_the_file_name_says_the_form"
    ),
    "`aiorts schema > aiorts.schema.json`": "cli/test_schema.py::test_it_is_a_schema_in_strict_json",
    "and tells systemd": "examples/test_deploy.py::test_it_is_ready_answers_the_watchdog_and_stops_at_sigterm",
    # Filters, recordings
    "every installed component is a command": (
        "cli/test_filter.py::test_good_lines_go_through_and_a_bad_one_makes_the_exit_status_1"
    ),
    "A bad one is reported with its number": (
        "cli/test_filter_lines.py::test_of_ten_thousand_lines_one_in_a_hundred_is_bad_and_all_others_are_processed"
    ),
    "The Flexi paper's three cases": (
        "examples/test_flexi.py::test_a_system_says_what_it_verified_and_fails_on_another_result"
    ),
    "### Record and replay": "flexi/test_logger_replay_command.py::test_options_choose_what_is_played",
    "A recorder that is killed leaves a file that opens as it is": (
        "log/test_writer.py::test_what_was_said_to_be_on_the_disk_is_there_after_a_kill"
    ),
    "every byte has a checksum, always checked": (
        "log/test_reader.py::test_a_check_finds_every_flipped_byte_but_in_the_name_of_who_wrote_it"
    ),
    "`aiorts log convert` reads and writes CSV, text and JSON lines": (
        "log/test_convert.py::test_numbers_and_texts_at_the_edge_come_back"
    ),
    "`import` and `export` ROS 2 bags": (
        "log/test_ros_messages.py::test_a_bag_of_all_twelve_comes_back_equal_in_every_field"
    ),
    "to the same verified heading": "examples/test_recording.py::test_replayed_it_gives_the_heading_of_the_robot",
    # Services, sets, machines, composites
    "compares the interfaces": (
        "services/test_service_wiring.py::test_another_interface_is_refused_at_connect_with_the_difference"
    ),
    "a circle of calls is an error at once": (
        "services/test_serialised.py::test_a_circle_of_calls_is_an_error_at_once_that_tells_the_way"
    ),
    "one that stays loses no sample": ("kernel/test_port_groups.py::test_no_sample_is_lost_on_a_connector_that_stays"),
    "between two cycles, whole or not at all": (
        "kernel/test_configuring.py::test_of_a_thousand_changes_good_and_bad_while_hooks_run_none_is_ever_half_done"
    ),
    "A state machine is a table": (
        "statemachines/test_state_machine.py::test_a_door_opens_and_closes_by_ports_and_timers_alone"
    ),
    "is several components as one": (
        "composites/test_shared_context.py::test_members_share_a_context_in_their_order_and_leave_their_own"
    ),
    "resets or restarts what fails, with back-off and a budget": (
        "supervision/test_supervisor.py::test_crash_loop_is_helped_exactly_five_times_and_ends_in_one_line"
    ),
    "show the whole system, its changes and chosen values": (
        "observe/test_changes.py::test_changes_applied_to_the_snapshot_give_the_later_snapshot"
    ),
    "replaces the code of running components": "reload/test_reloading.py::test_code_is_replaced_while_it_runs",
    "a force-controlled arm": "examples/test_manipulator.py::test_the_force_settles_and_the_brake_holds",
    # The command line, plugins, virtual time
    "look at this machine": "cli/test_doctor.py::test_it_looks_at_everything_and_measures_the_timer",
    "complete words in your shell": "cli/test_completion.py::test_bash_completes",
    "Exit status, of every command": "cli/test_exits.py::test_each_command_keeps_to_it",
    "They are listed without importing": "cli/test_plugins.py::test_what_is_installed_is_listed_and_nothing_imported",
    "copy [`examples/plugin`](examples/plugin)": "examples/test_plugin.py::test_as_it_lies_there",
    "### Tested in virtual time": "testing/test_rig.py::test_component_in_a_rig_is_fed_ticked_and_asked",
    # What you can rely on
    "**no sample disappears uncounted**": (
        "ports/test_connector.py::test_survivors_and_ledger_are_those_of_the_reference_model_after_every_step"
    ),
    "**order**": "ports/test_fan.py::test_samples_are_read_in_order_of_arrival_and_each_tells_its_source",
    "**immutable data**": "ports/test_out_port.py::test_no_reader_sees_what_a_writer_changes_afterwards",
    "**one component's fault stays its own**": (
        "execution/test_failing_hooks.py::test_whatever_a_hook_raises_is_the_error_of_its_component_alone"
    ),
    "**a fault of aiorts itself is said**": (
        "kernel/test_internal_faults.py::test_a_context_goes_on_after_a_fault_of_its_own_and_the_run_has_failed"
    ),
    "**orderly end**": (
        "execution/test_hook_timeout.py"
        "::test_kernel_with_many_stuck_components_in_several_contexts_closes_within_five_seconds"
    ),
    "no drift; ticks run + ticks skipped": (
        "contexts/test_ten_hours.py::test_ticks_counted_one_by_one_neither_drift_nor_get_lost"
    ),
    "its ports cross without one": (
        "realtime/test_lock_free_connector.py::test_the_lock_of_a_port_is_never_taken_by_a_real_time_thread"
    ),
    "gives the same bytes every time": (
        "determinism/test_determinism.py::test_two_processes_on_two_loops_each_give_the_same_bytes"
    ),
    # Policies, contexts, types
    "says what changed beyond the spread": (
        "bench/test_compare.py::test_slow_down_of_one_row_is_found_and_of_no_other"
    ),
    "the same class runs in any of them": "testing/test_rig.py::test_one_test_serves_every_kind_of_context",
    "**who is to blame**": (
        "diagnostics/test_blame.py::test_a_neighbour_that_sleeps_is_named_with_component_hook_and_line"
    ),
    "The 126 records and 5 enums of OpenRTM by name": (
        "types/test_record.py::test_openrtm_has_126_records_and_5_enums"
    ),
    "structural limits checked before anything is allocated": (
        "wire/test_scan.py::test_array_head_that_lies_is_refused_before_anything_is_allocated"
    ),
    "knows nothing else": "architecture/test_layers.py::test_a_microkernel_runs_components_with_no_service_loaded",
}


def test_each_promise_stands_in_readme_and_has_a_quick_test() -> None:
    text, defined = " ".join(README.read_text(encoding="utf-8").split()), rows.defined(rows.TESTS)
    assert [words for words in PROMISES if words not in text] == [], "not in README any more"
    assert [test for test in PROMISES.values() if test not in defined] == [], "no such test"
    assert [test for test in PROMISES.values() if tiers.is_slow(f"tests/{test}")] == [], "not among the quick tests"
