"""Included files: their parts are parts of the system, by names of their own, and what is wrong has its place there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest

from aiorts.system import Choices, SystemFile, check, load, prepare, wanted
from expansion_parts import ARM, refused, wires

Put: TypeAlias = Callable[..., Path]


def test_the_parts_of_an_included_file_are_parts_of_the_system(put: Put) -> None:
    path = put(robot='include = ["arm.toml"]\n[contexts.more]\nkind = "event"\nmembers = []\n', arm=ARM)
    system = load(path)
    assert list(system.components) == ["motor", "gauge"]
    assert list(system.composites) == ["arm"]
    assert list(system.contexts) == ["loop", "more"]
    assert system.files == (path, path.with_name("arm.toml"))
    whole = {**vars_of(load(path.with_name("arm.toml"))), "contexts": system.contexts}
    assert vars_of(system) == whole


def vars_of(system: SystemFile) -> dict[str, object]:
    return {name: getattr(system, name) for name in ("components", "composites", "connections", "contexts")}


def test_a_prefix_is_put_before_every_name_and_wherever_one_is_meant(put: Put) -> None:
    path = put(robot='[[include]]\nfile = "arm.toml"\nprefix = "left_"\nvars = { speed = 7 }\n', arm=ARM)
    system = load(path)
    assert list(system.components) == ["left_motor", "left_gauge"]
    assert system.components["left_gauge"].params["gain"] == 7
    assert system.components["left_gauge"].start is not None
    assert system.components["left_gauge"].start.after == ("left_motor active",)
    composite = system.composites["left_arm"]
    assert composite.members == ("left_motor", "left_gauge")
    assert composite.exported == {"left_gauge.output": "force", "left_motor.*": "{port}"}
    assert composite.groups == (("left_motor",), ("left_gauge",))
    assert system.contexts["left_loop"].members == ("left_arm",)
    assert wires(system) == [("left_motor.out", "left_gauge.input")]
    assert system.connections[0].options == {"name": "left_wire"}
    prepare(system)


def test_one_file_is_included_twice_and_each_has_names_of_its_own(put: Put) -> None:
    twice = 'include = [{ file = "arm.toml", prefix = "left_" }, { file = "arm.toml", prefix = "right-" }]\n'
    names = list(load(put(robot=twice, arm=ARM)).components)
    assert names == ["left_motor", "left_gauge", "right-motor", "right-gauge"]
    text = refused(put(robot='include = ["arm.toml", "arm.toml"]\n', arm=ARM))
    assert text.startswith("arm.toml:5:13: components.motor: there is 'motor' already, in arm.toml:5:13; choose")
    assert text.endswith("or include with a prefix")


def test_ports_of_an_included_system_have_others_in_their_place(put: Put) -> None:
    arm = ARM + '[[connections]]\nfrom = "pad.out"\nto = ["gauge.input"]\n'
    for remap in ('{ "pad.out" = "stick.out" }', '{ pad.out = "stick.out" }'):
        robot = f'[[include]]\nfile = "arm.toml"\nprefix = "left_"\nremap = {remap}\n'
        path = put(robot=robot + '[components.stick]\ntype = "parts.py:Source"\n', arm=arm)
        assert wires(load(path))[1] == ("stick.out", "left_gauge.input")
    path = put(robot=robot, arm=arm)  # who is named there and is nowhere: it is said where it was named
    assert refused(path).startswith("robot.toml:5:21: connections[2].from: unknown component 'stick'; there are")
    path = put(robot=robot.replace("pad.out", "pad.oud"), arm=arm)
    text = refused(path)
    assert text.startswith(
        "robot.toml:5:15: include[1].remap.pad.oud: no connection in arm.toml has the port 'pad.oud'"
    )
    assert text.endswith("did you mean 'pad.out'?")


def test_the_command_line_puts_a_port_in_the_place_of_another(put: Put) -> None:
    path = put(robot='include = ["arm.toml"]\n[components.other]\ntype = "parts.py:Source"\n', arm=ARM)
    assert wires(load(path, (), Choices(remaps=("motor.out=other.out",)))) == [("other.out", "gauge.input")]
    for text, why in [
        ("motor.oud=other.out", "no connection of the system has the port 'motor.oud'; did you mean 'motor.out'?"),
        ("motor.out", "expected COMPONENT.PORT=COMPONENT.PORT, such as camera.image=player.image"),
        ("motor.out=other", "expected COMPONENT.PORT, got 'other'"),
    ]:
        assert refused(path, Choices(remaps=(text,))) == f"robot.toml: --remap {text}: {why}"


@pytest.mark.fault("F01")
@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            {"robot": 'include = ["arm.toml"]\n'},
            "robot.toml:2:12: include[1].file: arm.toml: cannot be read: No such",
        ),
        (
            {"robot": 'include = ["folder"]\n', "folder__a": ""},
            "2:12: include[1].file: folder: cannot be read: it is a directory",
        ),
        (
            {"robot": 'include = "../x.toml"\n'},
            "2:11: include.file: '../x.toml' is outside the system",
        ),
        (
            {"robot": 'include = ["robot.toml"]\n'},
            "2:12: include[1].file: includes itself: robot.toml -> robot.toml",
        ),
        (
            {"robot": 'include = ["a.toml"]\n', "a": 'include = ["b.toml"]\n', "b": '[[include]]\nfile = "a.toml"\n'},
            "b.toml:3:8: include[1].file: includes itself: a.toml -> b.toml -> a.toml",
        ),
        ({"robot": 'include = ["arm.toml"]\n', "arm": "a = [\n"}, "arm.toml:2:6: not valid TOML"),
        (
            {"robot": 'include = ["arm.toml"]\n', "arm": "schema = 2\n"},
            "arm.toml:1:10: schema: version 2, and this",
        ),
        ({"robot": "include = 3\n"}, "robot.toml:2:11: include: expected files, got 3; write include ="),
        ({"robot": "include = [[]]\n"}, "robot.toml:2:12: include[1]: expected a file, got []; write include ="),
        ({"robot": '[[include]]\nprefix = "a"\n'}, "robot.toml:2:1: include[1]: file is missing; write file ="),
        ({"robot": 'include = [""]\n'}, "robot.toml:2:12: include[1].file: expected the name of a file, got ''"),
        (
            {"robot": '[[include]]\nfile = "arm.toml"\nprefix = "left."\n', "arm": ARM},
            'robot.toml:4:10: include[1].prefix: expected what names may begin with, such as "left_"',
        ),
        (
            {"robot": 'include = ["arm.toml"]\n', "arm": '[components.a]\ntype = "parts.py:Sink"\nparam = {}\n'},
            "arm.toml:4:1: components.a.param: unknown key 'param'; did you mean 'params'?",
        ),
    ],
)
def test_what_is_wrong_is_said_where_it_stands(put: Put, files: dict[str, str], message: str) -> None:
    assert message in refused(put(**files))


@pytest.mark.fault("F03")
@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("prefx = 'a'", "include[1].prefx: unknown key 'prefx'; did you mean 'prefix'?"),
        ("vars = { sped = 1 }", "include[1].vars.sped: arm.toml has no variable 'sped'; did you mean 'speed'?"),
        ("vars = { speed = true }", "include[1].vars.speed: expected a number for speed, got True"),
        ("vars = 3", "include[1].vars: expected values by the file's variables, got 3"),
        ("remap = 3", 'include[1].remap: expected ports by port, such as {"a.out" = "b.out"}, got 3'),
        ("remap = { motor = 'a.b' }", "include[1].remap.motor: expected COMPONENT.PORT, got 'motor'"),
        ("remap = { motor.out = 'b' }", "include[1].remap.motor.out: expected COMPONENT.PORT, got 'b'"),
    ],
)
def test_an_include_that_is_wrong_says_what_was_meant(put: Put, entry: str, message: str) -> None:
    text = refused(put(robot=f'[[include]]\nfile = "arm.toml"\n{entry}\n', arm=ARM))
    assert text.startswith("robot.toml:4:")
    assert message in text


def test_files_and_types_are_counted_from_the_file_that_names_them(put: Put, tmp_path: Path) -> None:
    arm = '[components.motor]\ntype = "parts.py:Source"\nparams.data = "mine.txt"\n'
    path = put(robot='include = ["arms/arm.toml"]\n[components.own]\ntype = "parts.py:Sink"\n', arms__arm=arm)
    (tmp_path / "arms" / "parts.py").write_text((tmp_path / "parts.py").read_text().replace("Makes", "Makes other"))
    plan = prepare(load(path))
    assert plan.types["motor"].__doc__ == "Makes other numbers."
    assert plan.types["own"].__module__ != plan.types["motor"].__module__
    assert plan.params["motor"]["data"] == tmp_path / "arms" / "mine.txt"
    assert wanted(plan).components["motor"].type == f"{tmp_path / 'arms' / 'parts.py'}:Source"


def test_tables_of_services_are_those_of_the_including_file_where_both_have_them(put: Put) -> None:
    table = "[watch_loop]\nlimit = {}\n"
    one, other = table.format(1), table.format(2)
    assert load(put(robot='include = ["a.toml"]\n', a=one)).services["watch_loop"] == {"limit": 1}
    assert load(put(robot='include = ["a.toml"]\n' + other, a=one)).services["watch_loop"] == {"limit": 2}
    text = refused(put(robot='include = ["a.toml", "b.toml"]\n', a=one, b=other))
    assert text.startswith("b.toml:2:2: watch_loop: a.toml:2:2 says something else; write [watch_loop] in robot.toml")
    assert load(put(robot='include = ["a.toml", "b.toml"]\n' + table.format(3), a=one, b=other)).services


def test_a_link_that_leads_out_is_not_followed(
    put: Put, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    outside = tmp_path_factory.mktemp("outside") / "arm.toml"
    outside.write_text(ARM)
    (tmp_path / "arm.toml").symlink_to(outside)
    assert "'arm.toml' is outside the system file's folder" in refused(put(robot='include = ["arm.toml"]\n'))


def test_the_whole_text_says_the_same_system(put: Put) -> None:
    arm = f'{ARM}[components.other]\ntype = "parts.py:Source"\nparams.data = "${{side}}"\n'
    path = put(robot='[[include]]\nfile = "arm.toml"\nprefix = "left_"\nvars = { side = "a $${x}" }\n', arm=arm)
    system = load(path)
    again = path.with_name("again.toml")
    again.write_text(system.text)
    assert vars_of(load(again)) == vars_of(system)
    assert system.components["left_other"].params == {"data": "a ${x}"}


def test_rules_of_included_files_come_together_and_mean_the_names_of_their_file(put: Put) -> None:
    arm = f'{ARM}[[rules]]\nfrom = "*.output"\nto = "log.*"\nmax = 5\n[[rules]]\nif = false\nfrom = "a.b"\nto = "c.d"\n'
    robot = (
        '[[include]]\nfile = "arm.toml"\nprefix = "left_"\n[[include]]\nfile = "arm.toml"\nprefix = "right_"\n'
        '[[rules]]\nrepeat = 2\nfrom = "a{i}.*"\nto = "*.b"\n'
    )
    path = put(robot=robot, arm=arm)
    rules = load(path).services["rules"]["rules"]
    assert [(one["from"], one["to"]) for one in rules] == [
        ("left_*.output", "left_log.*"),
        ("right_*.output", "right_log.*"),
        ("a0.*", "*.b"),
        ("a1.*", "*.b"),
    ]
    prepare(load(path))
    assert dict(load(put(robot='include = ["arm.toml"]\n', arm=arm.replace("max = 5", "max = 0"))).services)
    found = check(path.with_name("robot.toml"))
    assert [one.place.rpartition("/")[2] for one in found if one.severity == "error"] == ["arm.toml:26:7"]
    text = refused(put(robot='include = ["arm.toml"]\n[rules]\nrules = []\n', arm=arm))
    assert text.endswith("robot.toml:3:2 has rules, and no list; write all as [[rules]]")
