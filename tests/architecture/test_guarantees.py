"""What is promised in writing, where it stands, and which tests hold it: a promise nobody tests is not one.

Each entry: the module and object in whose docstring the promise stands, its words, and tests of this suite.
"""

from __future__ import annotations

import ast
import inspect
from importlib import import_module
from pathlib import Path

import pytest

from aiorts.model.declared import options_of

TESTS = Path(__file__).parents[1]

GUARANTEES: list[tuple[str, str, str, tuple[str, ...]]] = [
    (
        "aiorts.kernel.execution.cycle",
        "",
        "One cycle has three passes",
        (
            "execution/test_failing_hooks.py::test_all_twelve_hooks_run_in_their_order_and_are_announced_before_and_after",
        ),
    ),
    (
        "aiorts.kernel.execution.cycle",
        "",
        "Requests and failures are actions; they run between cycles, in the order they came.",
        ("execution/test_reentrant_requests.py::test_request_from_a_hook_is_queued_and_done_within_a_period",),
    ),
    (
        "aiorts.kernel.execution.task_driver",
        "",
        "one that ignores them all is abandoned with its task, and the context goes on",
        (
            "execution/test_hook_timeout.py::"
            "test_hook_over_its_deadline_is_cancelled_each_half_second_then_abandoned_and_the_neighbour_runs_on",
        ),
    ),
    (
        "aiorts.kernel.execution.task_driver",
        "",
        "One that blocks is judged when it returns.",
        (
            "supervision/test_blocking_hooks.py::"
            "test_a_hook_that_blocks_longer_than_its_deadline_is_an_error_when_it_returns",
        ),
    ),
    (
        "aiorts.kernel.execution.context",
        "Context",
        "On a simulated clock code that blocks takes no time.",
        ("supervision/test_blocking_hooks.py::test_code_that_blocks_takes_no_time_of_a_simulated_clock",),
    ),
    (
        "aiorts.kernel.microkernel",
        "Microkernel.start",
        "a hook did not return within `timeout` seconds; the context runs all the same",
        ("supervision/test_blocking_hooks.py::test_a_start_is_bounded_where_an_activation_hangs",),
    ),
    (
        "aiorts.kernel.microkernel",
        "Microkernel.aclose",
        "within 5 s; idempotent",
        (
            "execution/test_hook_timeout.py::test_kernel_with_many_stuck_components_in_several_contexts_closes_within_five_seconds",
        ),
    ),
    (
        "aiorts.kernel.microkernel",
        "Microkernel.aclose",
        "A caller that is cancelled is cancelled when all is closed.",
        (
            "execution/test_reentrant_requests.py::"
            "test_host_cancelled_in_the_body_closes_the_kernel_properly_however_often_it_is_cancelled",
        ),
    ),
    (
        "aiorts.kernel.microkernel",
        "Microkernel.start",
        "A caller that is cancelled leaves no context behind.",
        (
            "execution/test_reentrant_requests.py::test_caller_cancelled_at_any_moment_leaves_a_whole_system_that_goes_on",
        ),
    ),
    (
        "aiorts.kernel.component",
        "Component.configure",
        "all of them between two cycles, or, when any value is bad, none",
        (
            "kernel/test_declarations.py::test_parameters_change_between_cycles_only",
            "kernel/test_declarations.py::test_bad_change_is_refused_whole_and_names_every_culprit",
        ),
    ),
    (
        "aiorts.kernel.embedding",
        "",
        "it wraps two things and leaves both as they were",
        ("kernel/test_embedding.py::test_loop_and_process_are_as_found_when_the_last_kernel_closes",),
    ),
    (
        "aiorts.kernel.embedding",
        "",
        "A marked task that fails and whose exception was not asked for half a second later is that component's",
        ("loop/test_own_tasks.py::test_failure_of_a_task_is_attributed_within_a_second_a_hundred_times",),
    ),
    (
        "aiorts.kernel.execution.entry_lock",
        "",
        "A component in several contexts is entered by one at a time, in the order they came.",
        (
            "execution/test_reentrant_requests.py::"
            "test_component_in_two_contexts_is_never_entered_twice_even_when_it_joins_the_second_in_mid_hook",
        ),
    ),
    (
        "aiorts.kernel.loop.log",
        "",
        "nothing is lost in silence: calls = lines + repeated + dropped",
        (
            "loop/test_log_storm.py::test_thousand_components_that_fail_at_once_are_a_thousand_lines_at_most_then_a_summary",
        ),
    ),
    (
        "aiorts.kernel.execution.hooks",
        "",
        "Anything else is refused here, with class and hook named, not when it first runs.",
        ("kernel/test_declarations.py::test_hook_of_a_wrong_kind_or_signature_is_refused_when_the_class_is_made",),
    ),
    (
        "aiorts.kernel.configuring",
        "Configuration",
        "refused whole, with ConfigurationError, when any of its values is bad",
        (
            "kernel/test_configuring.py::"
            "test_of_a_thousand_changes_good_and_bad_while_hooks_run_none_is_ever_half_done",
            "configuration/test_configuration_model.py::test_a_component_is_what_the_model_says_after_any_changes",
        ),
    ),
    (
        "aiorts.kernel.between_cycles",
        "",
        "A component that is active nowhere is changed at once.",
        (
            "kernel/test_configuring.py::"
            "test_an_inactive_component_is_changed_at_once_though_its_neighbour_holds_the_cycle",
        ),
    ),
    (
        "aiorts.kernel.port_groups",
        "",
        "A port that stays is not touched: it keeps its connectors and its unread samples.",
        ("kernel/test_port_groups.py::test_no_sample_is_lost_on_a_connector_that_stays",),
    ),
    (
        "aiorts.assembly",
        "Kernel.load_configuration",
        "of every component in it, or of none when anything is wrong",
        (
            "configuration/test_configuration_files.py::test_a_wrong_file_is_refused_with_its_place_and_nothing_changes",
            "configuration/test_configuration_files.py::test_when_the_last_component_refuses_what_the_first_took_is_taken_back",
        ),
    ),
    (
        "aiorts.configuration.safe_files",
        "",
        "a reader gets the old text or the new, never a part",
        (
            "configuration/test_configuration_files.py::test_a_process_that_is_killed_while_it_saves_leaves_a_whole_file",
            "configuration/test_configuration_files.py::test_a_disk_that_fails_leaves_the_old_file",
        ),
    ),
]


def one_line(text: str | None) -> str:
    return " ".join((text or "").split())


@pytest.mark.row(130)
@pytest.mark.parametrize(("module", "name", "promise", "tests"), GUARANTEES, ids=lambda value: str(value)[:50])
def test_promise_stands_where_users_read_it_and_tests_hold_it(
    module: str, name: str, promise: str, tests: tuple[str, ...]
) -> None:
    found: object = import_module(module)
    for part in name.split(".") if name else ():
        found = getattr(found, part)
    declared = options_of(found).values() if isinstance(found, type) else ()
    assert one_line(promise) in one_line(" ".join([inspect.getdoc(found) or "", *(one.doc for one in declared)]))
    for test in tests:
        file, function = test.split("::")
        tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
        assert function in names
