"""Configuration files of managers and components: which keys act, what each does, and which are only listed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.cli.app import run_command
from aiorts.errors import MissingExtra
from aiorts.system import build, load, said_keys, wanted
from aiorts.testing import simulate
from aiorts_openrtm import Conf, OpenRTMError, read_system
from openrtm_parts import REAL

TALK = """
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong


class Talker(Component):
    out = OutPort(TimedLong)
    step = Param(1)

    async def on_execute(self) -> None:
        await self.out.write(TimedLong(0, self.step))
        self.finish()


class Listener(Component):
    into = InPort(TimedLong)

    def on_execute(self) -> None:
        for sample in self.into.drain():
            print(self.name, "got", sample.data)
"""


def entries(text: str) -> list[tuple[str, str, str]]:
    return [(one.key, one.value, one.where) for one in Conf.parse(text, Path("x.conf")).entries]


def test_lines_are_read_as_the_manager_reads_them() -> None:
    """Comments, both separators, continued lines, escapes, the comma of RTCBuilder's files; each with its line."""
    text = "# no\n! no\n\na: 1\n  b = x:y  \nc: 1, \\\n   2, \\\n# not this\n 3\nd\\:e: t\\tn\\\\\nf g h\ni\n"
    text += "conf.__constraints__.x, x>=100\r\nconf.__widget__.p, text"
    assert entries(text) == [
        ("a", "1", "x.conf:4"),
        ("b", "x:y", "x.conf:5"),
        ("c", "1,2,3", "x.conf:6"),
        ("d:e", "t\tn\\", "x.conf:10"),
        ("f", "g h", "x.conf:11"),
        ("i", "", "x.conf:12"),
        ("conf.__constraints__.x", "x>=100", "x.conf:13"),
        ("conf.__widget__.p", "text", "x.conf:14"),
    ]


@pytest.mark.slow(kept_by="test_lines_are_read_as_the_manager_reads_them")
@given(st.text(max_size=200))
def test_any_text_is_read(text: str) -> None:
    for key, value, where in entries(text.replace("\0", "")):
        assert key
        assert "\n" not in value or "\\n" in text
        assert int(where.removeprefix("x.conf:")) <= text.count("\n") + text.count("\r") + 1


def test_japanese_files_of_old_tools_are_read(tmp_path: Path) -> None:
    for encoding in ("utf-8", "cp932", "euc_jp"):
        (tmp_path / "rtc.conf").write_bytes("# 設定ファイル\nmanager.name: ロボット\n".encode(encoding))
        assert Conf.read(tmp_path / "rtc.conf").value("manager.name") == "ロボット"
    (tmp_path / "rtc.conf").write_bytes(b"a: b\nmanager.name: \x81 \n")
    with pytest.raises(OpenRTMError, match=r"rtc.conf:\d: neither UTF-8 nor Shift JIS nor EUC-JP; save"):
        Conf.read(tmp_path / "rtc.conf")


def lab(folder: Path, conf: str, **files: str) -> str:
    """A laboratory's folder with a manager's configuration; what the import of it says."""
    (folder / "rtc").mkdir(exist_ok=True)
    for kind in ("Talker", "Listener"):
        (folder / "rtc" / f"{kind}.py").write_text(TALK)
    for name, text in files.items():
        (folder / f"{name}.conf").write_text(text)
    (folder / "rtc.conf").write_text(conf)
    return conf


RTC_CONF = """manager.name: lab
corba.nameservers: localhost:2809
naming.formats: %h.host_cxt/%M.mgr/%n.rtc, %n.rtc
logger.file_name: ./rtc%p.log
manager.modules.load_path: ./rtc
manager.modules.preload: Talker.py, Listener.py
manager.components.precreate: Talker, Listener?instance_name=ear&exec_cxt.periodic.rate=50
manager.components.preconnect: Talker0.out?port=ear.into&subscription_type=new&interface_type=corba_cdr
manager.components.preactivation: Talker0, ear
exec_cxt.periodic.rate: 200
Talking.Talker.config_file: talker.conf
Talking.Talker0.conf.default.step: 7
"""


@pytest.mark.slow(kept_by="test_contexts_of_one_name_are_one")
@pytest.mark.row(89)
def test_a_managers_configuration_becomes_a_system_that_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab(tmp_path, RTC_CONF, talker="conf.default.step: 3\nconf.fast.step: 9\nconf.__type__.step: int\n")
    assert run_command(["import", str(tmp_path / "rtc.conf"), "-o", str(tmp_path / "system.toml")]) == 0
    said = capsys.readouterr().err.replace(f"{tmp_path}/", "")
    assert said.splitlines() == [
        "note: rtc.conf:2: corba.nameservers = 'localhost:2809': nothing here acts on it",
        "note: rtc.conf:4: logger.file_name = './rtc%p.log': nothing here acts on it",
    ]
    text = (tmp_path / "system.toml").read_text()
    assert text == (
        'schema = 1\n\n[openrtm]\nprofile = "rtc.conf"\n\n'
        '[components.Talker0]\ntype = "rtc/Talker.py:Talker"\nparams.step = 7\nsets.fast = { step = 9 }\n\n'
        '[components.ear]\ntype = "rtc/Listener.py:Listener"\n\n'
        '[[connections]]\nfrom = "Talker0.out"\nto = "ear.into"\nsubscription = "new"\n\n'
        '[contexts.Talker0_ec0]\nkind = "periodic"\nrate = 200.0\nmembers = ["Talker0"]\n\n'
        '[contexts.ear_ec0]\nkind = "periodic"\nrate = 50.0\nmembers = ["ear"]\n'
    )
    assert run_command(["run", str(tmp_path / "system.toml"), "--simulate", "--control=off"]) == 0
    assert "ear got 7" in capsys.readouterr().out


PRECONNECT = "manager.components.preconnect: Talker0.out?port=ear.into&subscription_type=new&interface_type=corba_cdr"
FORMS = {
    "2.0": ("Talker0.out?port=ear.into&subscription_type=new", 'subscription = "new"\n'),
    "1.1": ("Talker0.out:ear.into(subscription_type=new&interface_type=corba_cdr)", 'subscription = "new"\n'),
    "1.1, with a comma": (
        "Talker0.out:ear.into(data_type=x, subscription_type=new)",
        'subscription = "new"\n',
    ),
    "1.1, with no options": ("Talker0.out:ear.into", ""),
    "1.1, with blanks": ("Talker0.out : ear.into ()", ""),
    "an address": ("rtcname://localhost:2809/Talker0.rtc.out?port=rtcname://localhost:2809/ear.rtc.into", ""),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("more", ["", ", ear.more?interface_type=ros&topic=chatter", ", ear.more?interface_type=ros2"])
def test_a_connection_is_read_in_each_form_beside_ports_of_other_interfaces(
    form: str, more: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, options = FORMS[form]
    lab(tmp_path, RTC_CONF.replace(PRECONNECT, f"manager.components.preconnect: {text}{more}"), talker="")
    assert run_command(["import", str(tmp_path / "rtc.conf"), "-o", str(tmp_path / "system.toml")]) == 0
    assert f'from = "Talker0.out"\nto = "ear.into"\n{options}\n' in (tmp_path / "system.toml").read_text()
    notes = [line for line in capsys.readouterr().err.splitlines() if "rtc.conf:8" in line]
    if more:
        (note,) = notes
        assert "a port without a partner, of the interface 'ros" in note
    else:
        assert notes == []


def test_a_set_that_the_class_declares_is_active(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    conf = f"{RTC_CONF}Talking.Talker0.configuration.active_config: fast\n"
    lab(tmp_path, conf, talker="conf.default.step: 3\n")
    assert run_command(["import", str(tmp_path / "rtc.conf"), "-o", str(tmp_path / "system.toml")]) == 0
    assert 'active = "fast"' in (tmp_path / "system.toml").read_text()
    assert "no configuration set 'fast' stands here, which is to be active; its class has to have it" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("change", [("rtc.conf", "other.conf"), ('[openrtm]\nprofile = "rtc.conf"\n\n', "")])
def test_where_a_system_came_from_is_no_difference(
    change: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab(tmp_path, RTC_CONF, talker="")
    one, two = tmp_path / "system.toml", tmp_path / "other.toml"
    assert run_command(["import", str(tmp_path / "rtc.conf"), "-o", str(one)]) == 0
    two.write_text(one.read_text().replace(*change))
    assert two.read_text() != one.read_text()
    for old, new in ((one, two), (two, one)):
        assert run_command(["plan", str(old), str(new)]) == 0
    two.write_text(two.read_text().replace("rate = 50.0", "rate = 60.0"))
    assert run_command(["plan", str(one), str(two)]) == 1
    capsys.readouterr()

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(one))
            applied = await kernel.apply(wanted(load(two)))
            assert applied.done
            assert [step.text for step in applied.plan.steps] == ["retime ear_ec0: rate 50.0 -> 60.0"]

    simulate(main())


def test_the_name_that_name_servers_have_goes_into_the_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab(tmp_path, RTC_CONF, talker="")
    assert run_command(["export", str(tmp_path / "rtc.conf")]) == 0
    assert 'rts:pathUri="localhost/localhost.host_cxt/lab.mgr/ear.rtc"' in capsys.readouterr().out


def test_files_win_over_what_is_said_of_a_type_and_instances_over_both(tmp_path: Path) -> None:
    """Type's file, type's keys, instance's file, instance's keys: the later ones win."""
    conf = "manager.components.precreate: Talker\nT.Talker.config_file: a.conf\nT.Talker0.config_file: b.conf\n"
    conf += "T.Talker.conf.default.two: keys of the type\nT.Talker0.conf.default.four: keys of the instance\n"
    every = {"one": "1", "two": "2", "three": "3", "four": "4"}
    a = "".join(f"conf.default.{key}: file of the type\n" for key in every)
    b = "".join(f"conf.default.{key}: file of the instance\n" for key in ("three", "four"))
    lab(tmp_path, conf, a=a, b=b)
    wanted, _ = read_system(tmp_path / "rtc.conf", folder=tmp_path)
    assert dict(wanted.components["Talker0"].params) == {
        "one": "file of the type",
        "two": "keys of the type",
        "three": "file of the instance",
        "four": "keys of the instance",
    }


@pytest.mark.row(89)
def test_who_is_not_preactivated_is_not_activated(tmp_path: Path) -> None:
    conf = "manager.components.precreate: Talker, Talker, Listener\nmanager.components.preactivation: Talker1\n"
    lab(tmp_path, f"{conf}manager.modules.load_path: rtc\n")
    wanted, notes = read_system(tmp_path / "rtc.conf", folder=tmp_path)
    assert {name: one.activate for name, one in wanted.contexts.items()} == {
        "Talker0_ec0": False,
        "Talker1_ec0": True,
        "Listener0_ec0": False,
    }
    assert notes == ()


def test_contexts_of_one_name_are_one(tmp_path: Path) -> None:
    conf = (
        "manager.components.precreate: Talker, Listener\nmanager.components.preactivation: Talker0, Listener0\n"
        "execution_contexts: PeriodicExecutionContext(loop), ExtTrigExecutionContext(extra)\nec.loop.rate: 25\n"
    )
    lab(tmp_path, conf)
    wanted, _ = read_system(tmp_path / "rtc.conf", folder=tmp_path)
    assert {name: (one.kind, one.members, dict(one.options)) for name, one in wanted.contexts.items()} == {
        "loop": ("periodic", ("Talker0", "Listener0"), {"rate": 25.0}),
        "extra": ("external", ("Talker0", "Listener0"), {}),
    }


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("conf", "said"),
    [
        ("exec_cxt.periodic.rate: fast\n", "rtc.conf:2: exec_cxt.periodic.rate = 'fast': expected Hz"),
        ("exec_cxt.periodic.rate: 0\n", "rtc.conf:2: exec_cxt.periodic.rate = '0': expected Hz"),
        ("execution_contexts: (a)\n", "Talker0: '(a)': expected KIND(NAME)"),
        ("manager.components.preconnect: a.b\n", "rtc.conf:2: 'a.b': expected A.out?port=B.in"),
        ("manager.components.preconnect: a?port=b.c\n", "rtc.conf:2: 'a': expected COMPONENT.PORT"),
        ("manager.components.precreate: RTC:a:b\n", "rtc.conf:2: 'RTC:a:b': expected TYPE, or RTC:vendor"),
        ("manager.components.precreate: A?instance_name=x, B?instance_name=x\n", "rtc.conf:2: a second component 'x'"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(tmp_path: Path, conf: str, said: str) -> None:
    lab(tmp_path, f"manager.components.precreate: Talker\n{conf}")
    with pytest.raises(OpenRTMError) as caught:
        read_system(tmp_path / "rtc.conf")
    assert said in str(caught.value)


def test_nothing_is_loaded_expanded_or_read_outside_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET", "geheim")
    (tmp_path / "out.conf").write_text("conf.default.step: 5\n")
    (tmp_path / "lab").mkdir()
    (tmp_path / "Far.py").write_text("import aiorts\nraise SystemExit\nclass Far: pass\n")
    conf = (
        "manager.components.precreate: Talker, Far\nmanager.modules.load_path: .., /etc, ${SECRET}\n"
        "manager.modules.preload: ../Far.py, /bin/sh, libC.so(Init)\nmanager.components.preactivation: Talker0, Far0\n"
        "T.Talker0.config_file: ../out.conf\nT.Talker0.conf.default.key: ${SECRET}\nT.Far.config_file: $(SECRET).conf\n"
    )
    lab(tmp_path / "lab", conf)
    (tmp_path / "lab" / "rtc" / "Talker.py").write_text("raise SystemExit\n")
    wanted, notes = read_system(tmp_path / "lab" / "rtc.conf", folder=tmp_path)
    assert dict(wanted.components["Talker0"].params) == {"key": "${SECRET}"}
    assert wanted.components["Far0"].type == "Far"
    said = [str(note).replace(f"{tmp_path}/lab/", "") for note in notes]
    assert sum("no folder, or none below one that may be named" in line for line in said) == 3
    assert "rtc.conf:3: '/bin/sh': no Python module; nothing here loads it" in said
    assert "rtc.conf:5: '../out.conf': is not there, or not below a folder that may be named (--module-path)" in said
    assert "rtc.conf:7: '$(SECRET).conf': no environment is looked up; write it out" in said
    assert any(line.startswith("rtc.conf:6: T.Talker0.conf.default.key = ") or "key" in line for line in said)
    assert "geheim" not in " ".join(said)
    wanted, notes = read_system(tmp_path / "lab" / "rtc.conf", module_paths=[tmp_path], folder=tmp_path)
    assert wanted.components["Far0"].type == f"{os.path.realpath(tmp_path)}/Far.py:Far"
    assert wanted.components["Talker0"].params["step"] == "5"


def test_the_conf_of_a_component_becomes_a_system_of_it(tmp_path: Path) -> None:
    conf = (
        "conf.default.com_port: /dev/ttyACM0\nconf.default.baudrate: 9600\nconf.__type__.baudrate: int\n"
        "conf.__constraints__.baudrate, (9600, 115200)\nconf.__widget__.baudrate, radio\n"
        "conf.mode1.baudrate: 115200\nconfiguration.active_config: mode1\nexec_cxt.periodic.rate:500.0\n"
        "corba.nameservers: localhost\nport.inport.dataport.connection_limit: 1\n"
    )
    (tmp_path / "Arm3.conf").write_text(conf)
    wanted, notes = read_system(tmp_path / "Arm3.conf", folder=tmp_path)
    arm = wanted.components["Arm3"]
    assert (arm.type, dict(arm.params), arm.active) == ("Arm", {"com_port": "/dev/ttyACM0", "baudrate": 9600}, "mode1")
    assert dict(arm.sets["mode1"]) == {"baudrate": 115200}
    assert [(one.kind, dict(one.options), one.activate) for one in wanted.contexts.values()] == [
        ("periodic", {"rate": 500.0}, True)
    ]
    said = [str(note).replace(f"{tmp_path}/", "") for note in notes]
    assert said[:2] == [
        "Arm3.conf:9: corba.nameservers = 'localhost': nothing here acts on it",
        "Arm3.conf:10: port.inport.dataport.connection_limit: of OpenRTM's ports; nothing here acts on it",
    ]


@pytest.mark.skipif(REAL is None, reason="the files of the robot arm are not here")
def test_the_configuration_of_a_real_arm(tmp_path: Path) -> None:
    assert REAL is not None
    wanted, notes = read_system(REAL / "rtc_py.conf", folder=tmp_path)
    assert list(wanted.components) == ["myCobot0", "myCobotAruco0", "GUI_mycobot0"]
    listed = {note.where.rpartition(":")[2] for note in notes if "nothing here acts on it" in note.text}
    assert listed == {"61", "68", "70", "78", "79", "136", "309", "316", "384"}
    (tmp_path / "conf").mkdir()
    for file in ("rtc_py.conf", "myCobot0.conf"):
        place = tmp_path / ("conf" if file == "myCobot0.conf" else ".") / file
        place.write_bytes((REAL / file).read_bytes())
    wanted, _ = read_system(tmp_path / "rtc_py.conf", folder=tmp_path)
    assert dict(wanted.components["myCobot0"].params) == {"com_port": "/dev/ttyACM0"}
    wanted, _ = read_system(REAL / "myCobot0.conf", folder=tmp_path)
    assert dict(wanted.contexts["myCobot0_ec0"].options) == {"rate": 1000.0}


def test_a_text_that_is_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("# A page\n\nIt says: nothing of this.\n")
    with pytest.raises(OpenRTMError, match=r"README.md:1: has no key that OpenRTM knows: expected rtc.conf, or"):
        read_system(tmp_path / "README.md")


def test_a_composite_that_a_manager_makes(tmp_path: Path) -> None:
    conf = "manager.components.precreate: Talker, Listener, PeriodicECSharedComposite?instance_name=Both\n"
    conf += "composite.Both.config_file: both.conf\nmanager.modules.load_path: rtc\n"
    conf += "manager.components.preactivation: Both\n"
    both = "conf.default.members: Talker0, Listener0\nconf.default.exported_ports: Talker0.out\n"
    lab(tmp_path, conf, both=f"{both}exec_cxt.periodic.rate: 10\n")
    wanted, notes = read_system(tmp_path / "rtc.conf", folder=tmp_path)
    assert wanted.composites["Both"].members == ("Talker0", "Listener0")
    assert said_keys(wanted.composites["Both"]) == {"exported": {"Talker0.out": "{port}"}}
    assert {name: (one.members, dict(one.options)) for name, one in wanted.contexts.items()} == {
        "Both_ec0": (("Both",), {"rate": 10.0})
    }
    assert notes == ()


@pytest.mark.parametrize(("file", "package"), [("p.xml", "defusedxml"), ("p.yaml", "pyyaml")])
def test_without_the_extra_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, package: str
) -> None:
    for module in ("defusedxml", "yaml"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / file).write_text("<a/>")
    with pytest.raises(MissingExtra, match=rf'needs {package}, .*; pip install "aiorts\[openrtm\]"'):
        read_system(tmp_path / file)
