"""Configuration in files: what is saved is read back the very same, all or nothing; the difference can be asked for."""

from __future__ import annotations

import asyncio
import contextlib
import enum
import os
import random
import signal
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, Kernel, Param, PeriodicContext
from aiorts.errors import ConfigurationError, StateError
from aiorts.events import ConfigurationSetActivated, ParameterChanged
from aiorts.kernel.declarations import declarations
from aiorts.model.configuration.configuration_text import LARGEST, document_text, parse_document
from aiorts.model.configuration.constraints import Constraint
from aiorts.model.configuration.parameters import ParameterSpec
from aiorts.model.configuration.sets import ConfigurationState, Difference
from aiorts.model.configuration.toml_lines import lines_of
from aiorts.testing import simulated
from config_parts import Arm, Many, Source, hear

if TYPE_CHECKING:
    from collections.abc import Callable


class Parity(enum.Enum):
    NONE = "none"
    EVEN = 2


class Everything(Component):
    """A parameter of every type."""

    flag = Param(False)
    whole = Param(3)
    real = Param(0.1)
    text = Param("a")
    path = Param(Path("a"))
    parity = Param(Parity.NONE)
    reals = Param((1.0,))
    pair = Param(("a", 1))
    rows = Param((), type=tuple[tuple[int, ...], ...])
    table = Param({"a": 1.0})
    maybe = Param(None, type=float | None)
    word = Param(None, type=str | None)
    some = Param((), type=tuple[str | None, ...])


ODD: dict[str, Any] = {
    "flag": True,
    "whole": -(10**100),
    "real": -0.0,
    "text": 'none "\\\n\t\x00\x7f\x1f é🤖 = [x] #',
    "path": Path("/tmp/a b/ü"),
    "parity": Parity.EVEN,
    "reals": (float("inf"), float("-inf"), float("nan"), 5e-324, 1e16, 0.1),
    "pair": ("", 0),
    "rows": ((1, 2), (), (3,)),
    "table": {"odd key = 1": 0.5, "": -0.0, "b": 3.0},
    "maybe": None,
    "word": "none",
    "some": (None, "none", ""),
}


async def settled(kernel: Kernel, kind: type[Component] = Everything) -> Any:
    return await kernel.add(kind("one"))


@pytest.mark.row(77)
@simulated
async def test_changes_made_while_running_survive_the_kernel(tmp_path: Path) -> None:
    """OpenRTM loses what was changed at run time when the component ends."""
    path = tmp_path / "conf.toml"
    async with Kernel() as kernel:
        one, arm = await settled(kernel), await kernel.add(Arm("arm"))
        await kernel.add(Source("source"))  # has no parameters
        await kernel.start(PeriodicContext(10.0), one, activate=True)
        await one.configure(**ODD)
        await one.configuration.add("other", {"word": None, "reals": ()})
        await arm.configuration.add("soft", {"low": 0.1})
        await arm.configuration.remove("stiff")
        await arm.configuration.activate("soft")
        await one.add_param("baud_rate", Param(9600, constraint="(9600, 19200)", unit="Bd", doc='of "it"'))
        await one.configure(baud_rate=19200)
        before = {name: repr(component.params._state) for name, component in kernel.components.items()}
        await kernel.save_configuration(path)
    async with Kernel() as kernel:
        one, arm = await settled(kernel), await kernel.add(Arm("arm"))
        await kernel.load_configuration(path)
        assert repr(one.params._state) == before["one"]
        assert repr(arm.params._state) == before["arm"]
        assert (one.word, one.baud_rate, arm.low, arm.configuration.active) == ("none", 19200, 0.1, "soft")
        assert await kernel.diff_configuration(path) == ()
        again = tmp_path / "again.toml"
        await kernel.save_configuration(again)
        assert again.read_bytes() == path.read_bytes()


@simulated
async def test_only_the_components_asked_for_are_saved(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    async with Kernel() as kernel, Kernel() as other:
        await settled(kernel)
        arm = await kernel.add(Arm("arm"))
        await kernel.save_configuration(path, arm)
        assert list(tomllib.loads(path.read_text())["components"]) == ["arm"]
        with pytest.raises(StateError, match="does not belong"):
            await other.save_configuration(path, arm)


@pytest.mark.row(77)
@simulated
async def test_the_difference_between_file_and_running_system_is_frozen_values(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        many = await kernel.add(Many("gone"))
        await kernel.save_configuration(path)
        await kernel.remove(many)
        await kernel.add(Many("new"))
        await arm.configure(low=1.5)
        await arm.configuration.add("soft", {"low": 0.5})
        await arm.configuration.remove("fast")
        await arm.configuration.change("stiff", {"mode": "fast"})
        await arm.configuration.activate("soft")
        found = await kernel.diff_configuration(path)
        assert found == (
            Difference("changed", "value", "arm", "default", "low", 1.0, 1.5),
            Difference("added", "value", "arm", "stiff", "mode", None, "fast"),
            Difference("removed", "set", "arm", "fast"),
            Difference("removed", "value", "arm", "fast", "mode", "fast", None),
            Difference("added", "set", "arm", "soft"),
            Difference("added", "value", "arm", "soft", "low", None, 0.5),
            Difference("changed", "active", "arm", old="default", new="soft"),
            Difference("removed", "component", "gone"),
            Difference("added", "component", "new"),
        )
        assert [str(one) for one in found] == [
            "arm default.low: 1.0 -> 1.5",
            "arm stiff.mode: not there -> 'fast'",
            "arm fast: set removed",
            "arm fast.mode: 'fast' -> not there",
            "arm soft: set added",
            "arm soft.low: not there -> 0.5",
            "arm active: 'default' -> 'soft'",
            "gone: component removed",
            "new: component added",
        ]


@simulated
async def test_a_file_written_by_hand_says_all_there_is_to_say_of_its_components(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    path.write_text(
        "schema = 1\n[components.arm]\nactive = 'hard'\nsets.default.low = 0.25\n[components.arm.sets.hard]\nhigh = 9\n"
    )
    async with Kernel() as kernel:
        arm, many = await kernel.add(Arm("arm"), count=6), await kernel.add(Many("many"), inputs=3)
        heard = hear(kernel, ConfigurationSetActivated, ParameterChanged)
        await kernel.load_configuration(path)
        assert {name: dict(values) for name, values in arm.configuration.sets.items()} == {
            "default": {"low": 0.25, "high": 2.0, "mode": "slow", "count": 4},
            "hard": {"high": 9.0},
        }
        assert (arm.low, arm.high, many.inputs, len(heard)) == (0.25, 9.0, 3, 4)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "conf.toml:1: schema: expected schema = 1"),
        ("schema = true", "conf.toml:1: schema"),
        ("schema = 2", "got 2"),
        ("schema = 1\n[components", r"not valid TOML.*line 2"),
        ("schema = 1\n\n[component.arm]", "conf.toml:3: component: unknown key; did you mean 'components'"),
        ("schema = 1\ncomponents = 5", "conf.toml:2: components: expected a table, got 5"),
        ("schema = 1\n[components]\n\narm = 5", "conf.toml:4: components.arm: expected a table"),
        ("schema = 1\n[components.amr]", r"conf.toml:2: components.amr: no such component; did you mean arm\?"),
        (
            "schema = 1\n[components.arm]\n\nactve = 'x'",
            "conf.toml:4: .*actve: unknown key; did you mean 'active'",
        ),
        ("schema = 1\n[components.arm]\nactive = 5", "conf.toml:3: .*expected the name of a set, got 5"),
        ("schema = 1\n[components.arm]\nactive = 'stif'", "conf.toml:3: components.arm.active: arm: no set 'stif'"),
        ("schema = 1\n[components.arm.sets]\ndefault = 5", "conf.toml:3: .*default: expected a table"),
        (
            "schema = 1\n[components.arm.sets.default]\nhigh = 9.0\nlwo = 1.0",
            r"conf.toml:4: components.arm.sets.default.lwo: arm.lwo: no such parameter; did you mean low\?",
        ),
        ("schema = 1\n[components.arm.sets.a]\nlow = '''\n\n'''\nhigh = 'x'", "conf.toml:6: .*must be a float"),
        ("schema = 1\n[components.arm.sets.a]\nlow = -1.0", r"conf.toml:3: .*arm \(set a\).low = -1.0: must be >= 0.0"),
        ("schema = 1\n[components.arm]\nsets = {a = {low = -1.0}}", "conf.toml:3: .*must be >= 0.0"),
        ("schema = 1\n[components.arm.sets._a]\n", "conf.toml:2: .*begin with '_'"),
        ("schema = 1\n[components.arm.sets.a]\nlow = {none = true}", "conf.toml:3: .*must be a float, got dict"),
        ("schema = 1\n[components.arm.sets.a]\nlow = 2024-01-01", "conf.toml:3: .*must be a float"),
        ("schema = 1\n[components.arm.parameters.p]\ntype = 'int'", "conf.toml:2: .*default is missing"),
        (
            "schema = 1\n[components.arm.parameters.p]\ntype = 'foo'\ndefault = 1",
            "conf.toml:2: .*type 'foo': expected bool",
        ),
        ("schema = 1\n[components.arm.parameters.p]\ntype = 'int'\ndefault = 'x'", "conf.toml:2: .*must be an int"),
        (
            "schema = 1\n[components.arm.parameters.log]\ntype = 'int'\ndefault = 1",
            "something of that name",
        ),
        ("schema = 1\n[components.arm.parameters._x]\ntype = 'int'\ndefault = 1", "cannot be used as one"),
        (
            "schema = 1\n[components.arm.sets.a]\nlow = 5.0",
            "arm: set a: low 5.0 is above high 2.0; nothing was",
        ),
        ("schema = 1\n" + "a." * 40 + "b = 1", "conf.toml:2: a key of so many parts"),
        ("schema = 1\nb = " + "[" * 100_000, "conf.toml:2: nesting so deep"),
        ("schema = 1\n[components.arm.sets]\n" + "".join(f"s{n} = {{}}\n" for n in range(2000)), "2000 sets; at most"),
        ("schema = 1\n# " + "x" * LARGEST, "larger than"),
    ],
)
@simulated
async def test_a_wrong_file_is_refused_with_its_place_and_nothing_changes(text: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    path.write_text(text)
    async with Kernel() as kernel:
        arm, many = await kernel.add(Arm("arm")), await kernel.add(Many("many"))
        before = arm.params._state, many.params._state
        heard = hear(kernel)
        with pytest.raises(ConfigurationError, match=f"(?s){why}") as caught:
            await kernel.load_configuration(path)
        assert (arm.params._state, many.params._state) == before
        assert (heard, len(str(caught.value)) < 5000) == ([], True)


@simulated
async def test_everything_that_is_wrong_is_named_at_once(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    path.write_text(
        "schema = 1\n[components.arm.sets.default]\nlow = -1.0\nhigh = 'x'\n"
        "[components.many.sets.default]\ninputs = 99\n"
    )
    async with Kernel() as kernel:
        await kernel.add(Arm("arm"))
        await kernel.add(Many("many"))
        with pytest.raises(ConfigurationError) as caught:
            await kernel.load_configuration(path)
        assert [line.partition(": ")[0] for line in str(caught.value).splitlines()] == [
            f"{path}:{number}" for number in (3, 4, 6)
        ]


@simulated
async def test_a_refused_value_names_the_one_in_force_as_kept(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    path.write_text("schema = 1\n[components.arm.sets.default]\nlow = -1.0\n")
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        await arm.configure(low=0.25)
        with pytest.raises(ConfigurationError, match=r"; 0\.25 kept"):
            await kernel.load_configuration(path)
        assert arm.low == 0.25


@simulated
async def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary"
    binary.write_bytes(b"schema = 1\n\xff\xfe")
    async with Kernel() as kernel:
        for path, why in (
            (tmp_path / "nothing.toml", "cannot be read: No such file"),
            (tmp_path, "cannot be read|not a regular"),
            (Path("/dev/zero"), "not a regular file"),
            (binary, "binary:2: not UTF-8"),
        ):
            with pytest.raises(ConfigurationError, match=why):
                await kernel.load_configuration(path)


PIPE = """
import asyncio, sys
from aiorts import Kernel
async def main():
    async with Kernel() as kernel:
        await kernel.load_configuration(sys.argv[1])
asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_a_file_that_is_none_is_refused")
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
def test_a_pipe_that_nobody_writes_into_is_refused_and_the_interpreter_ends(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    command = [sys.executable, "-c", PIPE, str(tmp_path / "fifo")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert "ConfigurationError" in done.stderr
    assert "fifo: is not a regular file" in done.stderr


# -- all or nothing --------------------------------------------------------------------------------------------------


class Moody(Component):
    """Refuses a value the second time it is asked: when it is put in force."""

    value = Param(0)
    asked: ClassVar[int] = 0

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["value"] == 13:
            type(self).asked += 1
            if self.asked == 2:
                raise ValueError("not today")


@pytest.mark.fault("B22")
@simulated
async def test_when_the_last_component_refuses_what_the_first_took_is_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    async with Kernel() as kernel:
        arm, many, moody = [await kernel.add(one) for one in (Arm("arm"), Many("many"), Moody("moody"))]
        await arm.configuration.activate("stiff")
        await arm.add_param("mass", Param(1.0, unit="kg"))
        await many.configure(inputs=4)
        await moody.configure(value=12)
        await kernel.save_configuration(path)
        await arm.configuration.activate("default")
        await arm.remove_param("mass")
        await many.configure(inputs=2)
        path.write_text(path.read_text().replace("value = 12", "value = 13"))
        before = [repr(component.params._state) for component in (arm, many, moody)]
        ports = dict(many.ports)
        Moody.asked = 0
        with pytest.raises(ConfigurationError, match="not today"):
            await kernel.load_configuration(path)
        assert [repr(component.params._state) for component in (arm, many, moody)] == before
        assert (arm.low, hasattr(arm, "mass"), dict(many.ports)) == (1.0, False, ports)


@simulated
async def test_a_hook_that_loads_a_file_is_not_made_to_wait(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"

    class Loader(Arm):
        async def on_execute(self) -> None:
            if not self.seen:
                await self.kernel.load_configuration(path)
            await super().on_execute()

    async with Kernel() as kernel:
        arm = await kernel.add(Loader("arm"), low=0.5)
        await kernel.save_configuration(path)
        await arm.configure(low=1.5)
        await kernel.start(PeriodicContext(10.0), arm, activate=True)
        await asyncio.sleep(0.25)
        assert arm.seen == [(1.5, 2.0), (0.5, 2.0), (0.5, 2.0)]


@simulated
async def test_a_file_that_a_hook_loads_is_refused_as_a_whole_too(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "conf.toml"

    class Loader(Arm):
        async def on_execute(self) -> None:
            if not self.seen:
                await self.kernel.load_configuration(path)
            await super().on_execute()

    async with Kernel() as kernel:
        arm, moody = await kernel.add(Loader("arm"), low=0.5), await kernel.add(Moody("moody"), value=12)
        await kernel.save_configuration(path)
        path.write_text(path.read_text().replace("value = 12", "value = 13"))
        await arm.configure(low=1.5)
        Moody.asked = 1
        await kernel.start(PeriodicContext(10.0), arm, activate=True)
        await asyncio.sleep(0.25)
        assert (set(arm.seen), arm.last_error, moody.value) == ({(1.5, 2.0)}, None, 12)
        assert "not today" in caplog.messages[-1]


@simulated
async def test_a_value_that_would_be_read_back_as_another_is_not_saved(tmp_path: Path) -> None:
    class Ambiguous(Component):
        table = Param(None, type=Mapping[str, bool] | None)

    async with Kernel() as kernel:
        one = await kernel.add(Ambiguous("one"))
        await kernel.save_configuration(tmp_path / "conf.toml")
        await one.configure(table={"none": True})  # how a file says None
        with pytest.raises(ConfigurationError, match="one: a value of it cannot be saved"):
            await kernel.save_configuration(tmp_path / "conf.toml")


@pytest.mark.parametrize("step", ["open", "fsync", "replace", "none"])
@simulated
async def test_a_disk_that_fails_leaves_the_old_file(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "conf.toml"

    def fail(*arguments: Any, **options: Any) -> Any:
        raise OSError(28, "No space left on device")

    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        await kernel.save_configuration(path)
        path.chmod(0o640)
        old = path.read_bytes()
        await arm.configure(low=1.25)
        with monkeypatch.context() as patch:
            if step != "none":
                patch.setattr(os, step, fail)
            if step == "none":
                await kernel.save_configuration(path)
            else:
                with pytest.raises(ConfigurationError, match="cannot be written: No space left"):
                    await kernel.save_configuration(path)
        assert (path.read_bytes() == old) is (step != "none")
        assert os.listdir(tmp_path) == ["conf.toml"]
        assert path.stat().st_mode & 0o777 == 0o640


@simulated
async def test_a_link_stays_a_link(tmp_path: Path) -> None:
    real, link = tmp_path / "real.toml", tmp_path / "link.toml"
    real.write_text("schema = 1")
    link.symlink_to(real)
    async with Kernel() as kernel:
        await kernel.add(Arm("arm"))
        await kernel.save_configuration(link)
        assert link.is_symlink()
        assert "stiff" in real.read_text()


@pytest.mark.slow(kept_by="test_a_disk_that_fails_leaves_the_old_file")
def test_a_process_that_is_killed_while_it_saves_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "conf.toml"
    code = (
        "import sys\nfrom pathlib import Path\nfrom aiorts.configuration.safe_files import replace_text\n"
        "texts = ['schema = 1\\n' + f'# {n}' * 200_000 + '\\nend = %d' % n for n in (1, 2)]\n"
        "replace_text(Path(sys.argv[1]), texts[0])\nprint('go', flush=True)\n"
        "while True:\n    for text in texts: replace_text(Path(sys.argv[1]), text)\n"
    )
    lengths = set()
    rest = random.Random(1)
    for _ in range(8):
        with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE) as child:
            assert child.stdout is not None
            child.stdout.readline()
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(rest.uniform(0.0, 0.1))
            child.send_signal(signal.SIGKILL)
        assert tomllib.loads(path.read_text())["end"] in (1, 2)
        lengths.add(path.stat().st_size)
    assert len(lengths) == 1


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"text": "\udcff"}, "one.text: cannot be saved"),
        ({"path": "\udcff"}, "one.path: cannot be saved"),
        ({"whole": 10**5000}, "one.whole: cannot be saved"),
    ],
)
@simulated
async def test_a_value_that_no_file_can_hold_is_named_and_nothing_is_written(
    values: dict[str, Any], why: str, tmp_path: Path
) -> None:
    async with Kernel() as kernel:
        one = await settled(kernel)
        await one.configure(**values)
        with pytest.raises(ConfigurationError, match=why):
            await kernel.save_configuration(tmp_path / "conf.toml")
        assert os.listdir(tmp_path) == []


# -- the text itself -------------------------------------------------------------------------------------------------

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "flag": st.booleans(),
    "whole": st.integers(),
    "real": st.floats(),
    "text": texts,
    "path": texts.filter(lambda text: text != "" and "\0" not in text).map(Path),
    "parity": st.sampled_from(Parity),
    "reals": st.lists(st.floats(), max_size=3).map(tuple),
    "pair": st.tuples(texts, st.integers()),
    "rows": st.lists(st.lists(st.integers(), max_size=2).map(tuple), max_size=3).map(tuple),
    "table": st.dictionaries(texts, st.floats(), max_size=3),
    "maybe": st.one_of(st.none(), st.floats()),
    "word": st.one_of(st.none(), texts),
    "some": st.lists(st.one_of(st.none(), texts), max_size=3).map(tuple),
}
names = st.from_regex(r"[A-Za-z0-9-][A-Za-z0-9_-]{0,6}", fullmatch=True).filter(
    lambda name: name[0] != "-" and name != "default"
)


@pytest.mark.slow(kept_by="test_changes_made_while_running_survive_the_kernel")
@settings(max_examples=150, deadline=None)
@given(
    st.fixed_dictionaries({}, optional=VALUES),
    st.dictionaries(names, st.fixed_dictionaries({}, optional=VALUES), max_size=3),
    st.data(),
)
def test_any_configuration_is_read_back_as_it_was_written(
    default: dict[str, Any], sets: dict[str, dict[str, Any]], data: st.DataObject
) -> None:
    declared = declarations(Everything).parameters
    state = ConfigurationState.of(declared).changed(default)
    for name, values in sets.items():
        state = state.added(name, values)
    state = state.activated(data.draw(st.sampled_from(list(state.sets))))
    text = document_text({"one": state}, {"one": declared})
    again = parse_document(text, "x").state("one", ConfigurationState.of(declared))
    assert repr(again) == repr(state)
    assert document_text({"one": again}, {"one": declared}) == text


@pytest.mark.slow
@settings(max_examples=200)
@given(st.text(alphabet="[]{}.=\"'\\#\n ab1,", max_size=40))
def test_lines_are_found_in_any_toml_and_none_hangs(text: str) -> None:
    try:
        top = tomllib.loads(text)
    except ValueError:
        lines_of(text)  # of other text it need not be right, but it ends
        return
    lines = lines_of(text)
    assert {key[0] for key in lines} == top.keys()
    assert all(1 <= line <= text.count("\n") + 1 for line in lines.values())


def test_lines_are_those_where_keys_stand() -> None:
    text = '# a\n\na = """\nb = 1\n"""\nc = [1,\n# d = 1\n  2]\n[t . "x.y"]\nz.w = "]" # =\n[[u]]\nv = {q = 1}\n[[u]]\n'
    assert lines_of(text) == {
        ("a",): 3,
        ("c",): 6,
        ("t", "x.y"): 9,
        ("t", "x.y", "z", "w"): 10,
        ("u",): 11,
        ("u", "v"): 12,
    }


def test_a_parameter_that_was_added_is_written_with_its_declaration() -> None:
    specs: list[ParameterSpec] = [
        ParameterSpec("a", 1, unit="Bd", doc="d", constraint=Constraint(ge=0, lt=5), widget="slider.1"),
        ParameterSpec("b", None, tuple[float | None, ...] | None),
        ParameterSpec("c", {"k": "v"}, constraint=Constraint(keys={"k": Constraint(pattern=r"\w")})),
        ParameterSpec("d", (("a", 1),)),
    ]
    state = ConfigurationState.of({})
    for spec in specs:
        state = state.with_parameter(spec)
    state = state.changed({"b": (1.0, None)})
    text = document_text({"one": state}, {"one": {}})
    again = parse_document(text, "x").state("one", ConfigurationState.of({}))
    assert repr(again) == repr(state)
    check: Callable[[object], Any] = again.specs["a"].check
    with pytest.raises(ConfigurationError, match="must be < 5"):
        check(5)
