"""A plan puts components into processes of their own and back, while the system runs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from anyio import fail_after, sleep

from aiorts import Kernel, LifecycleState
from aiorts.errors import ApplyError, StateError
from aiorts.links import Links
from aiorts.model.wanted.entries import Wanted
from aiorts.model.wanted.plan import plan
from aiorts.planning import wanted_of
from aiorts.supervision import Supervision
from aiorts.system import load, prepare, wanted
from aiorts.testing import simulate
from aiorts.types import TimedLong
from isolation import moved_parts
from isolation.test_isolated import runs, until
from isolation.test_moving import Input, check_all_came

pytestmark = pytest.mark.anyio
ACTIVE = LifecycleState.ACTIVE
ISOLATED = 'isolation = "process"\n'
ALONE = '[contexts.loop]\nkind = "periodic"\nrate = 100.0\nmembers = ["ctrl"]\n'
TOGETHER = ALONE.replace('"ctrl"', '"clock", "ctrl"')
APART = ALONE.replace('"ctrl"', '"clock"') + '[contexts.own]\nkind = "periodic"\nrate = 200.0\nmembers = ["ctrl"]\n'
SIMULATED = '[clock]\nkind = "simulated"\n'
FAILING = '[contexts.last]\nkind = "event"\nmembers = ["dark"]\n'


def system(isolation: str, contexts: str, more: str = "") -> str:
    parts = {"feed": "Feed", "clock": "Clockwork", "log": "Log", "places": "Log"}
    components = "".join(f'[components.{name}]\ntype = "moved_parts.py:{kind}"\n' for name, kind in parts.items())
    pairs = {"feed.out": "ctrl.inp", "ctrl.out": "log.inp", "ctrl.where": "places.inp"}
    joined = "".join(f'[[connections]]\nfrom = "{one}"\nto = "{two}"\n' for one, two in pairs.items())
    ctrl = f'[components.ctrl]\ntype = "moved_parts.py:Controller"\nparams.gain = 2\n{isolation}'
    return f"schema = 1\n{components}{ctrl}{joined}{contexts}{more}"


@pytest.fixture
def made(tmp_path: Path) -> Callable[[str], Wanted]:
    """Systems by their text."""
    shutil.copy(moved_parts.__file__, tmp_path)
    (tmp_path / "dark.py").write_text(
        "from aiorts import Component\n"
        "class Dark(Component):\n    def on_activated(self):\n        raise ValueError('no light')\n"
    )

    def of(text: str) -> Wanted:
        (tmp_path / "system.toml").write_text(text)
        return wanted(prepare(load(tmp_path / "system.toml")))

    return of


async def running(kernel: Kernel, goal: Wanted) -> tuple[Any, Any]:
    """The system, and what writes to its controller at 1 kHz."""
    await kernel.apply(goal)
    feed: Any = kernel.components["feed"]
    source = Input(feed)
    ctrl: Any = kernel.components["ctrl"]
    return ctrl, source


@pytest.mark.slow
@pytest.mark.parametrize("contexts", [(ALONE, ALONE), (TOGETHER, APART)], ids=["the same context", "one of its own"])
async def test_into_a_process_and_back_with_state_and_all_samples(
    made: Callable[[str], Wanted], contexts: tuple[str, str]
) -> None:
    here, there = made(system("", contexts[0])), made(system(ISOLATED, contexts[1]))
    async with Kernel() as kernel:
        ctrl, source = await running(kernel, here)
        await until(lambda: ctrl.count > 20)
        names = list(kernel.connectors)
        with fail_after(60):
            applied = await kernel.apply(there)
        assert (applied.done, applied.notes, plan(wanted_of(kernel), there).empty) == (True, (), True)
        anew = f"; counts begin at 0: {', '.join(names)}"
        assert f"isolate ctrl: the kernel's process -> one of its own{anew}" in [one.text for one in applied.plan.steps]
        one: Any = kernel.components["ctrl"]
        assert (one.pid != os.getpid(), one.state, sorted(kernel.connectors)) == (True, ACTIVE, sorted(names))
        with pytest.raises(StateError, match="this handle is not valid"):
            _ = ctrl.state
        pid = one.pid
        await until(lambda: kernel.connectors["ctrl.out-log.inp"].statistics.written > 20)
        with fail_after(60):
            applied = await kernel.apply(here)
        assert (applied.done, applied.notes, plan(wanted_of(kernel), here).empty) == (True, (), True)
        assert f"isolate ctrl: a process of its own -> the kernel's{anew}" in [one.text for one in applied.plan.steps]
        back: Any = kernel.components["ctrl"]
        source.end()
        await until(lambda: back.count == source.written)
        assert (type(back), back.gain, back.state, runs(pid)) == (type(ctrl), 2, ACTIVE, False)
        log: Any = kernel.components["log"]
        await check_all_came(log, source.written)


@pytest.mark.slow
@pytest.mark.parametrize("isolated", [False, True], ids=["out of the kernel", "out of a process"])
async def test_a_later_step_that_fails_takes_it_back_with_its_state(
    made: Callable[[str], Wanted], isolated: bool
) -> None:
    dark = '[components.dark]\ntype = "dark.py:Dark"\n' + FAILING
    before = made(system(ISOLATED if isolated else "", ALONE))
    after = made(system("" if isolated else ISOLATED, ALONE, dark))
    async with Kernel() as kernel:
        _, source = await running(kernel, before)
        log: Any = kernel.components["log"]
        await until(lambda: kernel.connectors["ctrl.out-log.inp"].statistics.written > 20)
        with fail_after(60), pytest.raises(ApplyError, match="no light") as refused:
            await kernel.apply(after)
        assert "ctrl: was made anew: has its attributes; take the new handle" in refused.value.not_undone
        assert plan(wanted_of(kernel), before).empty
        assert kernel.components["ctrl"].state is ACTIVE
        source.end()
        await check_all_came(log, source.written)


@pytest.mark.slow
async def test_one_that_was_made_in_a_process_is_in_the_kernel_as_if_it_was_made_there(
    made: Callable[[str], Wanted],
) -> None:
    here, there = made(system("", ALONE)), made(system(ISOLATED, ALONE))
    async with Kernel() as kernel:
        await kernel.apply(there)
        with fail_after(60):
            assert (await kernel.apply(here)).done
        assert plan(wanted_of(kernel), here).empty


@pytest.mark.slow
async def test_who_cannot_go_is_named_and_nothing_is_changed(made: Callable[[str], Wanted]) -> None:
    text = '[components.a]\ntype = "moved_parts.py:Holder"\n[contexts.c]\nkind = "event"\nmembers = ["a"]\n'
    more = '[components.b]\ntype = "moved_parts.py:Feed"\n'
    before = made(f"schema = 1\n{text}")
    after = made(f"schema = 1\n{more}{text}".replace(':Holder"\n', f':Holder"\n{ISOLATED}'))
    async with Kernel() as kernel:
        await kernel.apply(before)
        there = kernel.components["a"]
        with pytest.raises(StateError, match=r"a.lock: a lock cannot go into another process"):
            await kernel.apply(after)
        assert (dict(kernel.components), there.state) == ({"a": there}, ACTIVE)


@pytest.mark.slow
async def test_one_that_is_isolated_so_is_supervised_there(made: Callable[[str], Wanted]) -> None:
    before = made(system("", ALONE))
    supervised = '[components.ctrl.supervision]\nrestart = "restart"\nbackoff = 0.05\n'
    after = made(system(ISOLATED + supervised, ALONE))
    async with Kernel() as kernel:
        _, source = await running(kernel, before)
        await kernel.apply(after)
        one: Any = kernel.components["ctrl"]
        os.kill(one.pid, 9)
        await until(lambda: kernel.components["ctrl"] is not one and kernel.components["ctrl"].state is ACTIVE)
        again: Any = kernel.components["ctrl"]
        assert again.pid not in (None, os.getpid())
        assert plan(wanted_of(kernel), after).empty
        source.end()
    assert Supervision(restart="restart", backoff=0.05) == after.components["ctrl"].supervision


def test_on_a_simulated_clock_there_is_nothing_to_do(made: Callable[[str], Wanted]) -> None:
    here, there = made(system("", ALONE, SIMULATED)), made(system(ISOLATED, ALONE, SIMULATED))

    async def applied() -> None:
        async with Kernel() as kernel:
            await kernel.apply(here)
            ctrl = kernel.components["ctrl"]
            assert (await kernel.apply(there)).plan.empty
            assert kernel.components["ctrl"] is ctrl

    simulate(applied())


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (system("", ALONE), system(ISOLATED, ALONE).replace(":Controller", ":Echo").replace("params.gain = 2\n", ""),
         "ctrl: its type and its isolation change; apply one after the other"),
        (system("", ALONE.replace('"ctrl"', '"all"'), '[composites.all]\nmembers = ["ctrl"]\n'),
         system(ISOLATED, ALONE), "ctrl: is a member of all, and its isolation changes; take it out of all first"),
        (system(ISOLATED, ALONE), system(ISOLATED + "limits = { processes = 99 }\n", ALONE),
         "ctrl: the limits of a process that runs cannot be changed; take its isolation away first"),
    ],
)  # fmt: skip
def test_what_a_plan_cannot_do_it_says(made: Callable[[str], Wanted], before: str, after: str, said: str) -> None:
    assert said in plan(made(before), made(after)).refused


def told(isolation: str, options: str) -> str:
    """A reader that is told when to read."""
    parts = {"feed": "Feed", "tell": "Feed", "told": "Told", "log": "Log"}
    components = "".join(f'[components.{name}]\ntype = "moved_parts.py:{kind}"\n' for name, kind in parts.items())
    components = components.replace(':Told"\n', f':Told"\n{isolation}')
    pairs = {"tell.out": "told.go", "told.out": "log.inp", "feed.out": "told.inp"}
    joined = "".join(f'[[connections]]\nfrom = "{one}"\nto = "{two}"\n' for one, two in pairs.items())
    return f"schema = 1\n{components}{joined}{options}\n{ALONE.replace('ctrl', 'told')}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "left"),
    [
        ('subscription = "new"\npush = "new"', [19]),
        ("lifespan = 60.0", [*range(12, 20)]),
        ('dataflow = "pull"', [19]),
    ],
    ids=["newest", "all", "pull"],
)
@pytest.mark.parametrize("isolation", [ISOLATED, ""], ids=["in a process", "in the kernel"])
async def test_a_connector_that_gets_other_options_counts_what_is_unread(
    made: Callable[[str], Wanted], isolation: str, options: str, left: list[int]
) -> None:
    async with Kernel() as kernel:
        await kernel.apply(made(told(isolation, "")))
        feed, tell, log = (cast("Any", kernel.components[name]) for name in ("feed", "tell", "log"))

        async def counted(read: int, buffered: int) -> tuple[int, int]:
            """What was written, and what the reader has lost, once so many samples are read and unread."""
            connector = kernel.connectors["feed.out-told.inp"]
            with fail_after(15):
                while True:
                    ledger = (await kernel.service(Links).ledger(connector)) if isolation else connector.statistics
                    if (ledger.delivered, ledger.buffered) == (read, buffered):
                        break
                    await sleep(0.02)
            lost = sum(ledger.dropped.values())
            assert ledger.written == read + buffered + lost
            return ledger.written, lost

        for number in range(20):
            feed.out.write_nowait(TimedLong(0, number))
        assert await counted(0, 8) == (20, 12)
        await kernel.apply(made(told(isolation, options)))
        before = (0, 0) if isolation else (12, 12)  # a link that is made anew counts anew
        assert await counted(0, len(left)) == (before[0] + 8, before[1] + 8 - len(left))
        tell.out.write_nowait(TimedLong(0, 0))
        await counted(len(left), 0)
        with fail_after(15):
            assert [(await log.inp.read()).data for _ in left] == left
        assert not log.inp.is_new


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ('push = "new"', "renew feed.out -> ctrl.inp: push all -> new"),
        ('subscription = "new"', "renew feed.out -> ctrl.inp: push all -> new"),
        ('subscription = "flush"', "renew feed.out -> ctrl.inp: subscription new -> flush"),
        ('push = "skip"\nskip = 1', "renew feed.out -> ctrl.inp: push all -> skip, skip default -> 1"),
        ('length = 20\nfull = "block"', "change feed.out -> ctrl.inp: length default -> 20, full default -> block"),
        ("lifespan = 0.5", "renew feed.out -> ctrl.inp: lifespan default -> 0.5"),
    ],
)
def test_a_plan_names_the_options_that_a_connector_to_a_process_gets(
    made: Callable[[str], Wanted], options: str, said: str
) -> None:
    text = system(ISOLATED, ALONE)
    before, after = made(text), made(text.replace('to = "ctrl.inp"\n', f'to = "ctrl.inp"\n{options}\n'))
    anew = "; counts begin at 0" if said.startswith("renew") else ""
    assert [one.text for one in plan(before, after).steps] == [said + anew]


def test_who_holds_what_its_replacement_needs_goes_before_it_comes(made: Callable[[str], Wanted]) -> None:
    before, after = made(system("", ALONE)), made(system(ISOLATED, ALONE))
    texts = [one.text for one in plan(before, after, exclusive={"ctrl"}).steps]
    assert texts.index("remove ctrl (moved_parts.py:Controller)") < texts.index(
        "create ctrl (moved_parts.py:Controller)"
    )
    assert not [one for one in texts if one.startswith("isolate")]
