"""What of a profile becomes what of a system, and back: composites, contexts, options, order, types of components."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from aiorts.cli.app import run_command
from aiorts.system import Wanted, parse, said_keys, system_text
from aiorts_openrtm import RtcProfile, RtsProfile, read_system
from openrtm_parts import REAL, canonical, component, configuration, connector, context, preceding, profile, prop, step

ROOT = Path(__file__).parents[2]


def read(folder: Path, *parts: str) -> tuple[Wanted, list[str]]:
    """The system of a profile, and the notes without their file."""
    (folder / "p.xml").write_text(profile("".join(parts)), encoding="utf-8")
    wanted, notes = read_system(folder / "p.xml", folder=folder)
    said = [str(note).replace(f"{folder}/", "") for note in notes]
    return wanted, [line for line in said if "no plugin offers it" not in line]


# -- options of connections --------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("given", "options"),
    [
        ({"subscription_type": "new"}, {"subscription": "new"}),
        ({"subscription_type": "Flush", "dataflow_type": "PUSH"}, {}),
        ({"dataflow_type": "pull"}, {"dataflow": "pull"}),
        (
            {"subscription_type": "periodic", "publisher.push_rate": "20", "publisher.push_policy": "all"},
            {"subscription": "periodic", "push": "all", "push_rate": 20.0},
        ),
        (
            {"subscription_type": "new", "publisher.push_policy": "skip", "publisher.skip_count": "4"},
            {"subscription": "new", "push": "skip", "skip": 4},
        ),
        ({"subscription_type": "flush", "publisher.push_policy": "all", "publisher.push_rate": "5"}, {}),
        (
            {"inport.buffer.length": "64", "inport.buffer.write.full_policy": "do_nothing"},
            {"length": 64, "full": "reject"},
        ),
        ({"buffer.write.full_policy": "block", "buffer.write.timeout": "0.5"}, {"full": "block", "timeout": 0.5}),
        ({"timestamp_policy": "on_received"}, {"stamp": "received"}),
        ({"sync_readwrite": "YES"}, {"length": 0}),
    ],
)
def test_options_go_by_their_names_here(tmp_path: Path, given: dict[str, str], options: dict[str, Any]) -> None:
    properties = "".join(prop(f"dataport.{key}", value) for key, value in given.items())
    wanted, notes = read(
        tmp_path, component("A0", context()), component("B0", context()), connector("A0.out", "B0.into", properties)
    )
    (one,) = wanted.connections
    assert one.ports == ("A0.out", "B0.into")
    assert {key: value for key, value in one.options.items() if key != "name"} == options
    assert notes == []


def test_an_option_that_cannot_be_is_said_and_left_out(tmp_path: Path) -> None:
    wanted, notes = read(
        tmp_path,
        component("A0", context()),
        connector(
            "A0.out",
            "A0.into",
            prop("dataport.inport.buffer.length", "many") + prop("dataport.serializer.cdr.endian", "little"),
        ),
    )
    assert dict(wanted.connections[0].options) == {"name": "A0_out_A0_into"}
    assert notes == [
        "p.xml:6: inport.buffer.length = 'many': expected a whole number from 1 to 1000000; it is left out",
        "p.xml:6: serializer.cdr.endian: of OpenRTM's transports and tools; nothing here acts on them",
    ]


def test_a_connection_of_what_is_not_there_is_said(tmp_path: Path) -> None:
    wanted, notes = read(tmp_path, component("A0", context()), connector("A0.out", "Gone0.into"))
    assert wanted.connections == ()
    assert notes == ["p.xml:6: connection of 'Gone0': no such component or port"]


# -- contexts ----------------------------------------------------------------------------------------------------------


def test_kinds_and_rates_of_contexts(tmp_path: Path) -> None:
    wanted, notes = read(
        tmp_path,
        component("A0", context(0, 500.0) + context(1, 0.0, "EVENT_DRIVEN")),
        component("B0", context(0, 0.0, "ExtTrigExecutionContext")),
        component("C0", context(0, 0.0, "PeriodicExecutionContext")),
        component("D0", context(0, 1.0, "Odd")),
        component("E0"),
        component("F0", context(0, 20000.0)),
    )
    assert {name: (one.kind, dict(one.options)) for name, one in wanted.contexts.items()} == {
        "A0_ec0": ("periodic", {"rate": 500.0}),
        "A0_ec1": ("event", {}),
        "B0_ec0": ("external", {}),
        "C0_ec0": ("periodic", {"rate": 1000.0}),
        "D0_ec0": ("periodic", {"rate": 1.0}),
        "F0_ec0": ("periodic", {"rate": 20000.0, "max_rate": 20000.0}),
    }
    assert notes == [
        "p.xml:11: C0_ec0: no rate; it is 1000 Hz here",
        "p.xml:14: D0_ec0: kind 'Odd' is not known; it is periodic here",
        "p.xml:16: E0: has no execution context, and never runs",
    ]


def test_components_of_others_that_take_part_in_a_context(tmp_path: Path) -> None:
    others = '<rts:Participants rts:componentId="x" rts:instanceName="B0"/>'
    wanted, notes = read(tmp_path, component("A0", context(inside=others)), component("B0"))
    assert wanted.contexts["A0_ec0"].members == ("A0", "B0")
    assert notes == []


# -- composites --------------------------------------------------------------------------------------------------------


def test_a_composite_and_its_exported_ports(tmp_path: Path) -> None:
    members = "".join(
        f'<rts:Participants><rts:Participant rts:componentId="x" rts:instanceName="{name}"/></rts:Participants>'
        for name in ("A0", "B0")
    )
    sets = configuration("default", members="A0,B0", exported_ports="A0.out,B0.into")
    wanted, notes = read(
        tmp_path,
        component("A0", context()),
        component("B0", context()),
        component("Both0", sets + context(rate=50.0) + members, compositeType="PeriodicECShared"),
        component("C0", context()),
        connector("Both0.A0.out", "C0.into"),
    )
    assert list(wanted.components) == ["A0", "B0", "C0"]
    assert wanted.composites["Both0"].members == ("A0", "B0")
    assert said_keys(wanted.composites["Both0"]) == {"exported": {"A0.out": "{port}", "B0.into": "{port}"}}
    assert wanted.connections[0].ports == ("A0.out", "C0.into")
    assert {name: one.members for name, one in wanted.contexts.items()} == {"Both0_ec0": ("Both0",), "C0_ec0": ("C0",)}
    assert notes == []


# -- order -------------------------------------------------------------------------------------------------------------


def test_options_of_a_composite_that_cannot_be_are_said_and_left_out(tmp_path: Path) -> None:
    given = {"order": "dataflow", "own_schedule": True, "errors": "nope", "groups": "A0", "exported": ["x"], "ordr": 1}
    told = prop("aiorts.options", json.dumps(given))
    sets = configuration("default", members="A0")
    composite = component("Both0", sets + context() + told, compositeType="PeriodicECShared")
    wanted, notes = read(tmp_path, component("A0", context()), composite)
    assert said_keys(wanted.composites["Both0"]) == {"order": "dataflow", "own_schedule": True}
    said = [note.partition("aiorts.options: ")[2] for note in notes if "aiorts.options: " in note]
    assert said == [
        "errors = 'nope': expected one of stop, report, isolate",
        'groups = \'A0\': expected lists of members, such as [["a", "b"], ["c"]]',
        'exported = (\'x\',): expected names by pattern, such as {"a.out": "{port}"}',
        "ordr: no option of a composite; did you mean 'order'?",
    ]


def rules(wanted: Wanted) -> dict[str, tuple[Any, ...]]:
    found = {name: one.start for name, one in wanted.components.items()}
    return {name: (one.after, one.wait, one.timeout) for name, one in found.items() if one is not None}


def test_sequences_become_rules_of_starting(tmp_path: Path) -> None:
    """By numbers, by those that precede, by time; of several sequences Activation counts."""
    components = [component(f"{name}0", context()) for name in "ABCD"]
    activation = (
        step(1, "A0", '<rts:WaitTime rts:waitTime="1500"/>')
        + step(1, "B0")
        + step(2, "C0")
        + step(3, "D0", preceding("A0", "C0", timeout=2500))
    )
    wanted, notes = read(
        tmp_path,
        *components,
        f"<rts:StartUp>{step(1, 'D0')}</rts:StartUp><rts:ShutDown>{step(1, 'D0')}</rts:ShutDown>",
        f"<rts:Activation>{activation}</rts:Activation>",
    )
    assert rules(wanted) == {
        "A0": ((), 1.5, 10.0),
        "B0": ((), 0.0, 10.0),
        "C0": (("A0 active", "B0 active"), 0.0, 10.0),
        "D0": (("A0 active", "C0 active"), 0.0, 2.5),
    }
    assert [line.partition(": ")[2] for line in notes] == [
        "StartUp: stays in the profile; here the order of Activation counts",
        "ShutDown: stays in the profile; here components stop in the reverse of the order in which they started",
    ]


def test_components_that_wait_for_each_other_are_said(tmp_path: Path) -> None:
    steps = step(1, "A0", preceding("B0")) + step(2, "B0", preceding("A0")) + step(3, "Gone0")
    wanted, notes = read(
        tmp_path, component("A0", context()), component("B0", context()), f"<rts:Activation>{steps}</rts:Activation>"
    )
    assert rules(wanted) == {"A0": ((), 0.0, 5.0), "B0": (("A0 active",), 0.0, 5.0)}
    assert len(notes) == 2
    assert parse(system_text(wanted, tmp_path), tmp_path / "s.toml")


def test_rules_that_no_sequence_can_say_come_back_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'schema = 1\n[components.a]\ntype = "FlexiDump"\noptions = "-p TimedLong"\n'
        '[components.b]\ntype = "FlexiDump"\noptions = "-p TimedLong"\n'
        'start = { after = ["a added", "a inactive"], wait = 0.0005 }\nsupervision = { restart = "reset" }\n'
        '[contexts.loop]\nkind = "event"\nmembers = ["a", "b"]\nevery = 0.5\n'
    )
    assert run_command(["export", str(tmp_path / "s.toml"), "-o", str(tmp_path / "p.xml")]) == 0
    wanted, notes = read_system(tmp_path / "p.xml", folder=tmp_path)
    there = parse((tmp_path / "s.toml").read_text(), tmp_path / "s.toml")
    assert (wanted.components, wanted.contexts) == (there.components, there.contexts)
    assert notes == ()


# -- other systems -----------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(107)
@pytest.mark.parametrize(
    "file", ["hello/system.toml", "pid/system.toml", "manipulator/sim.toml", "roomba/system.toml", "flexi/vector.toml"]
)
@pytest.mark.parametrize("form", ["rtsprofile", "yaml"])
def test_systems_of_the_examples_go_over_and_come_back(tmp_path: Path, file: str, form: str) -> None:
    path = ROOT / "examples" / file
    system = parse(path.read_text(), path)
    new = tmp_path / f"new.{'xml' if form == 'rtsprofile' else 'yaml'}"
    assert run_command(["export", str(path), "--format", form, "-o", str(new)]) == 0
    wanted, notes = read_system(new, module_paths=[path.parent], folder=path.parent)
    assert notes == ()
    plain = replace(wanted, plugin_paths=(), services=MappingProxyType({}))
    assert _pairs(system_text(plain, path.parent)) == _pairs(
        system_text(
            Wanted(system.components, system.connections, system.contexts, composites=system.composites), path.parent
        )
    )


def _pairs(text: str) -> list[str]:
    """The lines of a system, sorted; a list of readers as one connection each, without names that were made up."""
    import tomllib

    found = []
    for table, value in tomllib.loads(text).items():
        if table != "connections":
            found.append(f"{table} {value}")
            continue
        for one in value:
            readers = one["to"] if isinstance(one["to"], list) else [one["to"]]
            rest = {key: value for key, value in one.items() if key not in ("to", "name")}
            found += [f"{rest} {reader}" for reader in readers]
    return sorted(found)


def test_a_named_connection_keeps_its_name(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'schema = 1\n[components.a]\ntype = "FlexiDupe"\noptions = "-p TimedLong:1"\n'
        '[[connections]]\nfrom = "a.output0"\nto = "a.input"\nname = "loop"\nlifespan = 0.5\n'
        'full = "block"\ntimeout = inf\n'
    )
    assert run_command(["export", str(tmp_path / "s.toml"), "-o", str(tmp_path / "p.xml")]) == 0
    wanted, _ = read_system(tmp_path / "p.xml", folder=tmp_path)
    expected = {"full": "block", "lifespan": 0.5, "name": "loop", "timeout": float("inf")}
    assert dict(wanted.connections[0].options) == expected


@pytest.mark.slow(kept_by="test_rules_that_no_sequence_can_say_come_back_all_the_same")
def test_other_tools_read_what_is_written_and_write_what_is_read(tmp_path: Path) -> None:
    rtsprofile = pytest.importorskip("rtsprofile.rts_profile", reason="rtsprofile-aist is not installed")
    (tmp_path / "s.toml").write_text(
        'schema = 1\n[components.a]\ntype = "FlexiDump"\noptions = "-p TimedLong"\nparams.format = "values"\n'
        '[components.b]\ntype = "FlexiDump"\noptions = "-p TimedLong"\nstart.after = "a active"\n'
        '[contexts.loop]\nkind = "event"\nmembers = ["a", "b"]\n'
    )
    for form, word in (("rtsprofile", "xml"), ("yaml", "yaml")):
        new = tmp_path / f"p.{word}"
        assert run_command(["export", str(tmp_path / "s.toml"), "--format", form, "-o", str(new)]) == 0
        theirs = rtsprofile.RtsProfile(**{f"{word}_spec": new.read_text()})
        assert [one.instance_name for one in theirs.components] == ["a", "b"]
        new.write_text(getattr(theirs, f"save_to_{word}")())
        wanted, _ = read_system(new, folder=tmp_path)
        there = parse((tmp_path / "s.toml").read_text(), tmp_path / "s.toml")
        assert (wanted.components, wanted.contexts) == (there.components, there.contexts)


# -- RTC.xml -----------------------------------------------------------------------------------------------------------

RTC = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<rtc:RtcProfile rtc:version="0.3" rtc:id="RTC:lab:arm:Arm:1.2.0" xmlns:rtc="http://www.openrtp.org/namespaces/rtc"
  xmlns:rtcExt="http://www.openrtp.org/namespaces/rtc_ext" xmlns:rtcDoc="http://www.openrtp.org/namespaces/rtc_doc">
 <rtc:BasicInfo rtc:name="Arm" rtc:vendor="lab" rtc:category="arm" rtc:version="1.2.0" rtc:description="moves"
  rtc:componentType="STATIC" rtc:activityType="PERIODIC" rtc:componentKind="DataFlowComponent" rtc:maxInstances="1"
  rtc:executionType="PeriodicExecutionContext" rtc:executionRate="500.0"/>
 <rtc:Actions><rtc:OnInitialize rtc:implemented="true"/><rtc:OnStateUpdate rtc:implemented="true"/>
  <rtc:OnError rtc:implemented="false"/></rtc:Actions>
 <rtc:ConfigurationSet>
  <rtc:Configuration rtc:name="gain" rtc:type="double" rtc:defaultValue="2.5" rtc:unit="N">
   <rtcDoc:Doc rtcDoc:description="how hard"/>
   <rtc:Constraint><rtc:ConstraintUnitType><rtc:And>
    <rtc:Constraint><rtc:ConstraintUnitType><rtc:propertyIsGreaterThanOrEqualTo rtc:matchCase="false">
     <rtc:Literal>0</rtc:Literal></rtc:propertyIsGreaterThanOrEqualTo></rtc:ConstraintUnitType></rtc:Constraint>
    <rtc:Constraint><rtc:ConstraintUnitType><rtc:propertyIsLessThan rtc:matchCase="false">
     <rtc:Literal>10</rtc:Literal></rtc:propertyIsLessThan></rtc:ConstraintUnitType></rtc:Constraint>
   </rtc:And></rtc:ConstraintUnitType></rtc:Constraint>
   <rtcExt:Properties rtcExt:name="__widget__" rtcExt:value="slider.0.1"/>
  </rtc:Configuration>
  <rtc:Configuration rtc:name="mode" rtc:type="string" rtc:defaultValue="soft">
   <rtc:Constraint><rtc:ConstraintUnitType><rtc:Or>
    <rtc:Constraint><rtc:ConstraintUnitType><rtc:propertyIsEqualTo rtc:matchCase="false"><rtc:Literal>soft</rtc:Literal>
     </rtc:propertyIsEqualTo></rtc:ConstraintUnitType></rtc:Constraint>
    <rtc:Constraint><rtc:ConstraintUnitType><rtc:propertyIsEqualTo rtc:matchCase="false">
     <rtc:Literal>hard one</rtc:Literal>
     </rtc:propertyIsEqualTo></rtc:ConstraintUnitType></rtc:Constraint>
   </rtc:Or></rtc:ConstraintUnitType></rtc:Constraint>
  </rtc:Configuration>
 </rtc:ConfigurationSet>
 <rtc:DataPorts rtc:portType="DataInPort" rtc:name="target" rtc:type="RTC::TimedPose3D" rtc:unit="m"/>
 <rtc:DataPorts rtc:portType="DataOutPort" rtc:name="pose" rtc:type="RTC::TimedPose3D"/>
 <rtc:ServicePorts rtc:name="middle">
  <rtc:ServiceInterface rtc:name="move" rtc:direction="Provided" rtc:type="JARA_ARM::Middle"/>
 </rtc:ServicePorts>
 <rtc:Language rtc:kind="Python"/>
</rtc:RtcProfile>
"""


def test_a_component_type_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "RTC.xml").write_text(RTC)
    arm = RtcProfile.read(tmp_path / "RTC.xml")
    assert (arm.name, arm.id, arm.rate, arm.language) == ("Arm", "RTC:lab:arm:Arm:1.2.0", 500.0, "Python")
    assert arm.hooks == ("on_initialize", "on_state_update")
    assert [(one.name, one.type, one.default, one.unit, one.constraint, one.widget) for one in arm.parameters] == [
        ("gain", "double", "2.5", "N", "x>=0 and x<10", "slider.0.1"),
        ("mode", "string", "soft", "", '(soft, "hard one")', ""),
    ]
    assert arm.parameters[0].doc == "how hard"
    assert [(one.name, one.direction, one.record, one.unit) for one in arm.data_ports] == [
        ("target", "in", "TimedPose3D", "m"),
        ("pose", "out", "TimedPose3D", ""),
    ]
    (middle,) = arm.service_ports
    assert [(one.name, one.type, one.provided) for one in middle.interfaces] == [("move", "JARA_ARM::Middle", True)]


def test_a_component_type_becomes_a_system_of_one(tmp_path: Path) -> None:
    (tmp_path / "RTC.xml").write_text(RTC)
    wanted, _ = read_system(tmp_path / "RTC.xml", folder=tmp_path)
    assert dict(wanted.components["Arm0"].params) == {"gain": 2.5, "mode": "soft"}
    assert dict(wanted.contexts["Arm0_ec0"].options) == {"rate": 500.0}


@pytest.mark.skipif(REAL is None, reason="the files of the robot arm are not here")
def test_the_component_type_of_a_real_arm() -> None:
    assert REAL is not None
    gui = RtcProfile.read(REAL / "gui_mycobot_RTC.xml")
    assert (gui.name, gui.rate, gui.hooks) == (
        "GUI_mycobot",
        1000.0,
        ("on_initialize", "on_activated", "on_deactivated", "on_execute"),
    )
    assert [(one.name, one.direction, one.record) for one in gui.data_ports] == [("poseOut", "out", "TimedPose3D")]


def test_names_that_are_none_here_are_said_and_come_back(tmp_path: Path) -> None:
    parts = (component("Arm 0", context()), component("Arm_0", context()), connector("Arm_0.a b", "Arm_0.c"))
    wanted, notes = read(tmp_path, *parts)
    assert list(wanted.components) == ["Arm_0", "Arm_0_2"]
    assert wanted.connections[0].ports == ("Arm_0_2.a_b", "Arm_0_2.c")
    assert len(notes) == 3
    text = system_text(wanted, tmp_path).replace("schema = 1\n", 'schema = 1\n[openrtm]\nprofile = "p.xml"\n')
    (tmp_path / "s.toml").write_text(text)
    assert run_command(["export", str(tmp_path / "s.toml"), "-o", str(tmp_path / "q.xml")]) == 0
    assert canonical((tmp_path / "q.xml").read_text()) == canonical((tmp_path / "p.xml").read_text())


def test_the_tree_of_a_profile_can_be_looked_at(tmp_path: Path) -> None:
    """Python has what the commands have."""
    (tmp_path / "p.xml").write_text(profile(component("A0", context())))
    from aiorts_openrtm.markup.xml_in import element_of_xml

    found = RtsProfile.of(element_of_xml((tmp_path / "p.xml").read_text(), "p.xml"))
    assert (found.id, found.components[0].id_parts) == ("RTSystem:lab:arm:1.0.0", ("lab", "test", "A", "1.0.0"))
    assert found.components[0].where == "p.xml:3"
