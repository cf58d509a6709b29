"""The judgement itself, as a table: what was seen and what the books say, and who is to blame then."""

from __future__ import annotations

import os

import pytest

from aiorts.diagnostics.blame import Entry, Glance, Line, Pause, choose_line, cut_at_loop, judge
from aiorts.model.blame import OTHERS, Blame, MissedDeadlines
from contexts.parts import MS, S

NEIGHBOUR = Blame("loop", "cam", "on_execute", "/home/me/cam.py", 42, "grab")
OWN = Blame("hook", "pid", "on_execute", "/home/me/pid.py", 7, "step", held="its context")
FOREIGN = Blame("loop", "", "", "/home/me/app.py", 10, "poll")
BOOKED = Blame("loop", "cam", "on_execute", "/home/me/cam.py", 40, "on_execute")
OWN_BOOKED = Blame("hook", "pid", "on_execute", "/home/me/pid.py", 5, "on_execute", held="its context")


def seen(at: int, ran: Blame | None, waits: Blame | None = None, absent: int = 0, runs: int | None = None) -> Glance:
    took = None if runs is None else Entry(BOOKED, 0, runs, key=1)
    return Glance(at * MS, ran, waits, absent * MS, took)


def booked(blame: Blame, last: int, *, own: bool = False, runs: int = 5) -> Entry:
    return Entry(blame, last * MS, runs, own, last * MS, 1)


CASES = [
    # what happened, glances, pauses (from, to), books, absent, kind, component, line, held
    ("a neighbour was seen", [seen(2, NEIGHBOUR)], [], [], 0, ("loop", "cam", 42, 40)),
    (
        "... and the books know how long",
        [seen(2, NEIGHBOUR, runs=4)],
        [],
        [booked(BOOKED, 50)],
        0,
        ("loop", "cam", 42, 50),
    ),
    ("it ran again since", [seen(2, NEIGHBOUR, runs=3)], [], [booked(BOOKED, 1)], 0, ("loop", "cam", 42, 40)),
    ("it only passed by", [seen(2, NEIGHBOUR, OWN, runs=4)], [], [booked(BOOKED, 1)], 0, ("hook", "pid", 7, 40)),
    (
        "who was seen longest",
        [seen(2, NEIGHBOUR), seen(4, FOREIGN), seen(30, NEIGHBOUR)],
        [],
        [],
        0,
        ("loop", "", 10, 26),
    ),
    ("a collection", [seen(2, NEIGHBOUR)], [(-5, 30)], [booked(BOOKED, 50)], 0, ("gc", "", 0, 35)),
    ("a short collection", [seen(2, NEIGHBOUR)], [(0, 19)], [], 0, ("loop", "cam", 42, 40)),
    ("a collection before it", [seen(2, NEIGHBOUR)], [(-90, 1)], [], 0, ("loop", "cam", 42, 40)),
    ("nobody ran", [seen(30, None, absent=28)], [], [], 0, ("machine", "", 0, 28)),
    ("half the time away inside a hook", [seen(30, NEIGHBOUR, absent=25)], [], [], 0, ("loop", "cam", 42, 40)),
    ("nearly all the time away inside a hook", [seen(39, NEIGHBOUR, absent=35)], [], [], 0, ("machine", "", 0, 35)),
    ("nobody looked, by the books", [], [], [booked(BOOKED, 30)], 0, ("loop", "cam", 40, 30)),
    ("its own hook first", [], [], [booked(BOOKED, 39), booked(OWN_BOOKED, 30, own=True)], 0, ("hook", "pid", 5, 30)),
    ("the books know of nothing long", [], [], [booked(BOOKED, 19)], 0, ("unknown", "", 0, 40)),
    ("nobody used the processor", [], [], [booked(BOOKED, 19)], 20, ("machine", "", 0, 20)),
    ("somebody did", [], [], [], 19, ("unknown", "", 0, 40)),
]


@pytest.mark.parametrize(("what", "glances", "pauses", "books", "absent", "expected"), CASES, ids=[c[0] for c in CASES])
def test_a_cycle_40_ms_late_is_blamed_on(
    what: str,
    glances: list[Glance],
    pauses: list[tuple[int, int]],
    books: list[Entry],
    absent: int,
    expected: tuple[str, str, int, int],
) -> None:
    collections = [Pause(began * MS, ended * MS, 2) for began, ended in pauses]
    blame = judge(0, 40 * MS, glances, collections, books, absent * MS)
    assert (blame.kind, blame.component, blame.line, blame.held_ns // MS) == expected


HOOK = Line("/home/me/cam.py", 40, "on_execute", 40)
STANDARD = Line(os.__file__, 12, "read", 10)
INSTALLED = Line("/venv/lib/python3.11/site-packages/cv2/video.py", 9, "decode", 3)
KERNEL = Line(
    os.path.join(os.path.dirname(__import__("aiorts").__file__), "kernel", "execution", "task_driver.py"),
    99,
    "_run",
    90,
)
HELPER = Line("/home/me/lib/grab.py", 5, "grab", 3)


def within(line: int, file: str = HOOK.file, name: str = "on_execute", first: int = 40) -> Line:
    return Line(file, line, name, first)


@pytest.mark.parametrize(
    ("lines", "hook", "expected"),
    [
        ([HELPER, within(44), KERNEL], HOOK, HELPER),
        ([STANDARD, INSTALLED, within(44), KERNEL], HOOK, within(44)),
        # beyond the hook's frame nothing counts, not even the application that called
        (
            [STANDARD, INSTALLED, KERNEL, Line("/home/me/app.py", 1, "main", 1)],
            None,
            Line("/home/me/app.py", 1, "main", 1),
        ),
        ([STANDARD, KERNEL], HOOK, HOOK),
        # an installed component: the lines of its own folder are its own
        (
            [STANDARD, INSTALLED],
            Line("/venv/lib/python3.11/site-packages/cv2/part.py", 1, "on_execute", 1),
            INSTALLED,
        ),
        ([STANDARD], None, STANDARD),
        ([KERNEL], None, None),
        ([], None, None),
    ],
)
def test_the_innermost_line_of_the_users_own_is_chosen(lines: list[Line], hook: Line | None, expected: Line) -> None:
    assert choose_line(lines, hook) == expected


def test_what_called_the_event_loop_is_not_blamed_for_what_it_calls() -> None:
    handle = Line("/usr/lib/python3.11/asyncio/events.py", 80, "_run", 78)
    main = Line("/home/me/app.py", 30, "<module>", 1)
    assert cut_at_loop([HELPER, handle, main], 0) == [HELPER]
    assert cut_at_loop([HELPER, main], 1) == [HELPER]
    assert cut_at_loop([main], 1) == []
    assert cut_at_loop([Line("/usr/lib/python3.11/selectors.py", 468, "select", 1), main], 0) == []


@pytest.mark.parametrize(
    ("blame", "text"),
    [
        (
            Blame("loop", "camera0", "on_execute", "/x/camera.py", 42, "grab", 37 * MS),
            "camera0.on_execute (camera.py:42 in grab) held the loop for 37 ms",
        ),
        (
            Blame("loop", "camera0", "on_execute", "/x/camera.py", 42, "on_execute", 1_234_567),
            "camera0.on_execute (camera.py:42) held the loop for 1.23 ms",
        ),
        (
            Blame("hook", "serial", "on_execute", held_ns=2 * S, held="its thread"),
            "serial.on_execute held its thread for 2000 ms",
        ),
        (
            Blame("loop", "camera0", "", "/x/camera.py", 9, "work", 37 * MS),
            "camera0, in a task of its own (camera.py:9 in work) held the loop for 37 ms",
        ),
        (Blame("loop", "", "", "/x/app.py", 10, "poll", 37 * MS), "poll (app.py:10) held the loop for 37 ms"),
        (Blame("gc", held_ns=37 * MS, generation=2), "garbage collection of generation 2 held the loop for 37 ms"),
        (Blame("machine", held_ns=37 * MS), "the machine: this process did not run, for 37 ms"),
    ],
)
def test_a_blame_is_one_sentence(blame: Blame, text: str) -> None:
    assert str(blame) == text
    assert "ms" not in blame.place


def test_counts_by_place_are_bounded_and_nothing_is_lost() -> None:
    missed = MissedDeadlines()
    for number in range(100):
        for _ in range(3):
            missed.add(Blame("loop", f"c{number}", "on_execute", held_ns=number), 0)
    assert len(missed.counts) == 33
    assert sum(missed.counts.values()) == 300
    assert missed.counts["c0.on_execute"] == 3
    assert missed.counts[OTHERS] == 68 * 3
    assert missed.last == Blame("loop", "c99", "on_execute", held_ns=99)


def test_each_place_is_told_of_once_in_five_seconds_with_the_number_since() -> None:
    missed = MissedDeadlines()
    one, two = (Blame("loop", name, "on_execute", held_ns=10 * MS) for name in ("one", "two"))
    assert [missed.add(one, moment * S) for moment in (0, 1, 4, 5, 6, 10)] == [1, 0, 0, 3, 0, 2]
    assert missed.add(two, 6 * S) == 1
    assert missed.add(Blame("loop", "three", held_ns=9 * MS), 6 * S) == 0
