"""Parts that are there under a condition, and parts that are repeated: as if each were written out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from aiorts.errors import SystemFileError
from aiorts.system import Choices, SystemFile, check, load, prepare
from expansion_parts import ARM, refused, wires

PAIR = """\
schema = 1
[variables]
sim = true
count = 3
[components."source{i}"]
repeat = "${count}"
type = "parts.py:Source"
params = { rate_limit = "{i+1}", data = "no-{i}-{{i}}.txt" }
[components."middle{i}"]
repeat = "${count}"
type = "parts.py:Middle"
start.after = "source{i} active"
[components.sink]
type = "parts.py:Sink"
start.after = ["middle{i} active"]
[[connections]]
repeat = "${count}"
from = "source{i}.out"
to = "middle{i}.input"
name = "wire{i}"
[[connections]]
repeat = "${count}"
from = "middle{i}.output"
to = "sink.input"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["source{i}", "middle{i}", "sink"]
"""
SIM = """\
schema = 1
[variables]
sim = true
[components.player]
if = "${sim}"
type = "parts.py:Source"
[components.camera]
if = "not ${sim}"
type = "parts.py:Source"
[components.sink]
type = "parts.py:Sink"
start.after = ["player active", "camera active"]
[composites.front]
if = false
members = ["camera"]
[composites.all]
members = ["player", "camera", "sink"]
groups = "player,camera|sink"
exported = ["player.out", "camera.out"]
[[connections]]
if = "${sim}"
from = "player.out"
to = "sink.input"
[[connections]]
if = "not ${sim}"
from = "camera.out"
to = "sink.input"
[contexts.loop]
kind = "event"
members = ["all", "front"]
[contexts.other]
if = "not ${sim}"
kind = "event"
members = []
[clock]
if = "${sim}"
kind = "simulated"
[watch_loop]
if = "not ${sim}"
limit = 1
"""


def parts_of(system: SystemFile) -> dict[str, object]:
    return {name: getattr(system, name) for name in ("components", "composites", "connections", "contexts", "clock")}


def test_what_is_repeated_is_as_if_each_were_written_out(write: Callable[..., Path]) -> None:
    system = load(write(PAIR))
    names = [*(f"source{i}" for i in range(3)), *(f"middle{i}" for i in range(3)), "sink"]
    assert list(system.components) == names
    assert dict(system.components["source2"].params) == {"rate_limit": "3", "data": "no-2-{i}.txt"}
    assert wires(system)[1] == ("source1.out", "middle1.input")
    assert wires(system)[5] == ("middle2.output", "sink.input")
    assert system.connections[2].options["name"] == "wire2"
    assert system.contexts["loop"].members == tuple(names)
    assert system.components["middle1"].start is not None
    assert system.components["middle1"].start.after == ("source1 active",)
    assert system.components["sink"].start is not None
    assert system.components["sink"].start.after == ("middle0 active", "middle1 active", "middle2 active")
    prepare(system)
    again = load(write(system.text, "again.toml"))
    assert parts_of(again) == parts_of(system)


def test_none_of_it_is_none(write: Callable[..., Path]) -> None:
    path = write(PAIR)
    system = load(path, (), Choices(("count=0",)))
    assert list(system.components) == ["sink"]
    assert system.contexts["loop"].members == ("sink",)
    assert wires(system) == []


def test_a_text_that_is_the_number_alone_is_a_number(write: Callable[..., Path]) -> None:
    text = PAIR.replace('rate_limit = "{i+1}"', 'rate_limit = "{i}"')
    assert load(write(text)).components["source2"].params["rate_limit"] == 2


def test_a_list_of_in_ports_has_all_of_what_is_repeated(write: Callable[..., Path]) -> None:
    text = PAIR + '[components.one]\ntype = "parts.py:Source"\n[[connections]]\nfrom = "one.out"\nto = {}\n'
    system = load(write(text.replace("{}", '["middle{i}.input"]')))
    assert wires(system)[-1] == ("one.out", "middle0.input", "middle1.input", "middle2.input")
    message = refused(write(text.replace("{}", '"middle{i}.input"')))
    assert message.endswith(
        'to: middle{i} stands for 3 components; write repeat in the connection, or a list: to = ["middle{i}.input"]'
    )


def test_a_chain_is_made_of_neighbours(write: Callable[..., Path]) -> None:
    text = """\
schema = 1
[components."link{i}"]
repeat = 4
type = "parts.py:Middle"
[[connections]]
repeat = 3
from = "link{i}.output"
to = "link{i+1}.input"
"""
    assert wires(load(write(text))) == [(f"link{i}.output", f"link{i + 1}.input") for i in range(3)]


@pytest.mark.parametrize("sim", [True, False])
def test_one_file_is_two_systems(write: Callable[..., Path], sim: bool) -> None:
    system = load(write(SIM), (), Choices((f"sim={str(sim).lower()}",)))
    there, gone = ("player", "camera") if sim else ("camera", "player")
    assert list(system.components) == [there, "sink"]
    assert system.composites.keys() == {"all"}
    assert system.composites["all"].members == (there, "sink")
    assert system.composites["all"].groups == ((there,), ("sink",))
    assert system.composites["all"].exported == {f"{there}.out": "{port}"}
    assert wires(system) == [(f"{there}.out", "sink.input")]
    assert system.contexts.keys() == ({"loop"} if sim else {"loop", "other"})
    assert system.contexts["loop"].members == ("all",)
    assert system.components["sink"].start is not None
    assert system.components["sink"].start.after == (f"{there} active",)
    assert system.clock.kind == ("simulated" if sim else "system")
    assert ("watch_loop" in system.services) is not sim
    assert gone not in system.text


def test_a_connection_of_one_that_is_left_out_is_refused(write: Callable[..., Path]) -> None:
    text = SIM.replace('if = "not ${sim}"\nfrom', "from")
    assert refused(write(text)) == (
        "system.toml:25:8: connections[2].from: camera is left out by the if in system.toml:8:6; give the connection "
        "the same if"
    )
    other = text.replace('if = "${sim}"\nfrom', 'if = "not ${sim}"\nfrom')
    assert wires(load(write(other), (), Choices(remaps=("camera.out=player.out",))))[0] == ("player.out", "sink.input")
    with pytest.raises(SystemFileError, match=r"player\.out and sink\.input are connected already"):
        load(write(text), (), Choices(remaps=("camera.out=player.out",)))
    text = SIM + '[[connections]]\nfrom = "player.out"\nto = ["sink.input", "camera.in"]\n'
    assert refused(write(text)).endswith("the same if, or a connection of its own")


def test_who_is_in_a_file_that_is_not_included_is_left_out(put: Callable[..., Path]) -> None:
    robot = """\
[variables]
real = false
[[include]]
file = "arm.toml"
if = "${real}"
[components.sink]
type = "parts.py:Sink"
[contexts.own]
kind = "event"
members = ["motor", "sink"]
"""
    path = put(robot=robot, arm=ARM.partition("[composites")[0])
    assert load(path).contexts["own"].members == ("sink",)
    assert "motor" in load(path, (), Choices(("real=yes",))).components
    (path.parent / "arm.toml").unlink()  # then nobody knows who would be in it
    assert refused(path).startswith("robot.toml:11:12: contexts.own.members[1]: unknown component 'motor'")


def test_an_include_is_repeated_with_its_number_in_the_prefix(put: Callable[..., Path]) -> None:
    robot = """\
[[include]]
file = "arm.toml"
repeat = 2
prefix = "arm{i}_"
vars = { speed = "{i}" }
[contexts.own]
kind = "event"
members = ["arm{i}_arm"]
"""
    path = put(robot=robot, arm=ARM.replace("[contexts.loop]", "[contexts.loop]\nif = false"))
    system = load(path)
    assert list(system.components) == ["arm0_motor", "arm0_gauge", "arm1_motor", "arm1_gauge"]
    assert [system.components[f"arm{i}_gauge"].params["gain"] for i in range(2)] == [0, 1]
    assert system.contexts["own"].members == ("arm0_arm", "arm1_arm")
    message = refused(put(robot=robot.replace("arm{i}_", "arm_"), arm=ARM))
    assert message.startswith("robot.toml:5:10: include[1].prefix: repeat needs a prefix with a number, such as")


@pytest.mark.fault("F03")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('repeat = "${count}"', "repeat = -1", "components.source{i}.repeat: expected how often, a whole number 0..10"),
        ('repeat = "${count}"', "repeat = true", "components.source{i}.repeat: expected how often, a whole number 0"),
        ('repeat = "${count}"', "repeat = 1000000000", "components.source{i}.repeat: expected how often, a whole num"),
        ('repeat = "${count}"', "repeat = 1.5", "components.source{i}.repeat: expected how often, a whole number 0.."),
        ('repeat = "${count}"\n', "", "components.source{i}: 'source{i}' has a number only with repeat; write repeat"),
        ('"source{i}"', "source", 'components.source: {i} is missing in the name; write [components."source{i}"], and'),
        ("[components.sink]", "[components.source1]", "components.source1: there is 'source1' already, in system"),
        ("type =", 'if = "sim"\ntype =', 'components.source{i}.if: expected true, false, "${name}" or "not ${name}"'),
        ("type =", 'if = "${count}"\ntype =', "components.source{i}.if: expected a variable that is true or false, a"),
        ("type =", 'if = "${simm}"\ntype =', "components.source{i}.if: unknown variable 'simm'; did you mean 'sim'?"),
        ('"source{i} active"', '"source{i-1} active"', "components.middle0.start.after: "),
        ('to = "middle{i}.input"', 'to = "middle{i+1}.input"', "connections[3].to: unknown component 'middle3'; did"),
        ('repeat = "${count}"\nfrom = "source', 'from = "source', "connections[1].from: source{i} stands for 3 comp"),
        ("repeat =", "repaet =", "components.source{i}: 'source{i}' has a number only with repeat"),
    ],
)
def test_a_part_that_is_wrong_says_so(write: Callable[..., Path], old: str, new: str, message: str) -> None:
    assert old in PAIR
    text = refused(write(PAIR.replace(old, new, 1)))
    assert text.startswith("system.toml:")
    assert message in text


@pytest.mark.fault("F03")
@pytest.mark.parametrize(("word", "meant"), [("iff = true", "if"), ("repat = 2", "repeat")])
def test_a_misspelt_key_of_a_part_is_told_so(write: Callable[..., Path], word: str, meant: str) -> None:
    for table in ('[components.a]\ntype = "parts.py:Sink"', "[composites.a]\nmembers = []"):
        found = check(write(f"schema = 1\n{table}\n{word}\n"))
        assert any(one.message.endswith(f"did you mean {meant!r}?") for one in found)


def test_what_is_wrong_in_a_part_that_is_left_out_is_said_too(write: Callable[..., Path]) -> None:
    message = refused(write(SIM.replace('if = "not ${sim}"\ntype', 'if = "not ${sim}"\nparams.data = "${dat}"\ntype')))
    assert message.startswith("system.toml:9:15: components.camera.params.data: unknown variable 'dat'")


def test_what_is_wrong_with_each_of_the_repeated_is_said_once(write: Callable[..., Path]) -> None:
    found = check(write(PAIR.replace('rate_limit = "{i+1}"', "rate_limit = 11")))
    (finding,) = [one for one in found if one.severity == "error"]
    assert finding.where == "components.source0.params.rate_limit"
    assert finding.copies == 2
    assert "(and of 2 more that are repeated)" in finding.message


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ('["middle{i}.output"]', ["{port}"] * 3),
        ('"middle{i}.output"', ["{port}"] * 3),
        ('{ "middle{i}.output" = "out{i}" }', ["out0", "out1", "out2"]),
        ('{ "middle*.output" = "{component}" }', ["{component}"]),
    ],
)
def test_a_composite_shows_ports_of_each_of_the_repeated(
    write: Callable[..., Path], given: str, names: list[str]
) -> None:
    text = PAIR.replace('"middle{i}", "sink"]', '"sink"]')
    text += f'[composites.all]\nmembers = ["middle{{i}}"]\nexported = {given}\n'
    exported = load(write(text)).composites["all"].exported
    assert list(exported.values()) == names
    assert len(names) == 1 or list(exported) == ["middle0.output", "middle1.output", "middle2.output"]
