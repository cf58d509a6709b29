"""Files that are none, too large, too deep, or want more than to be read: refused with file and line, and quickly."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts_openrtm import Conf, OpenRTMError, RtcProfile, read_system
from openrtm_parts import SPACES, component, configuration, context, profile, prop, step

LAUGHS = (
    '<?xml version="1.0"?>\n<!DOCTYPE lolz [\n<!ENTITY lol "lol">\n'
    + "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10 if n else "&lol;"}">\n' for n in range(12))
    + f"]>\n<rts:RtsProfile {SPACES}>&l11;</rts:RtsProfile>"
)
YAML_LAUGHS = "rtsProfile:\n  a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"  a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
)


def refused(folder: Path, text: str | bytes, name: str = "bad.xml") -> str:
    """What is said of a file that is not taken."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    before = time.process_time()
    with pytest.raises(OpenRTMError) as caught:
        read_system(path)
    assert time.process_time() - before < 20
    return str(caught.value).replace(f"{folder}{os.sep}", "")


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LAUGHS, "bad.xml:2: a document type has no place in a profile; take it away"),
        (
            f'<?xml version="1.0"?>\n<!DOCTYPE a SYSTEM "http://localhost:1/x.dtd">\n<rts:RtsProfile {SPACES}/>',
            "bad.xml:2: a document type",
        ),
        (
            f'<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]>\n<rts:RtsProfile {SPACES}>&e;</rts:RtsProfile>',
            "bad.xml:1: a document type",
        ),
        (f"<rts:RtsProfile {SPACES}>&nothing;</rts:RtsProfile>", "bad.xml:1: not valid XML: undefined entity"),
        (f"<rts:RtsProfile {SPACES}>" + "<a>" * 64, "bad.xml:1: more than 64 elements inside each other"),
        (f"<rts:RtsProfile {SPACES}>\n<a></b>", "bad.xml:2: not valid XML: mismatched tag"),
        ("<x:RtsProfile/>", "bad.xml:1: the prefix of 'x:RtsProfile' is not declared"),
        ("<RtsProfile xmlns='urn:other'/>", "bad.xml:1: expected an RtsProfile of"),
        ("<a " + " ".join(f'xmlns:p{n}="u"' for n in range(80)) + "/>", "bad.xml:1: more than 64 name spaces"),
        ("<?xml version='1.0' encoding='ebcdic-cp-us'?><a/>", "bad.xml:1: encoding 'ebcdic-cp-us' is not known"),
        (b"<a>\n\xff\xfe</a>", "bad.xml:2: not utf-8; save the file as UTF-8"),
        ("<", "bad.xml:1: not valid XML"),
        (b"\0\0\0", "bad.xml:1: not valid XML"),
    ],
)
def test_xml_that_is_not_taken(tmp_path: Path, text: str | bytes, said: str) -> None:
    assert refused(tmp_path, text).startswith(said)


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F02")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (YAML_LAUGHS, "bad.yaml:7: more than 100 aliases, or aliases for more than 100000 values"),
        ("rtsProfile: &a {b: *a}", "bad.yaml:1: the alias 'a' stands for nothing, or for what it is in"),
        ("rtsProfile: " + "[" * 70 + "]" * 70, "bad.yaml:1: more than 64 values inside each other"),
        ("rtsProfile: !!python/object/apply:os.system ['true']", "bad.yaml:1: the tag 'tag:yaml.org,2002:python/"),
        ("rtsProfile:\n  a: 1\n  a: 2", "bad.yaml:3: 'a' stands there twice; take one away"),
        ("rtsProfile:\n  <<: {a: 1}", "bad.yaml:2: '<<' has no place in a profile"),
        ("rtsProfile:\n  ? [1]\n  : 2", "bad.yaml:2: a key is a word"),
        ("rtsProfile:\n  'a b': 1", "bad.yaml:2: 'a b' cannot be a name in a profile"),
        ("rtsProfile:\n\t- x", "bad.yaml:2: not valid YAML"),
        ("a: 1", "bad.yaml:1: not a profile of a system: expected rtsProfile at the top"),
        ("rtsProfile: {}\nother: 1", "bad.yaml:1: 'other' beside rtsProfile has no place"),
        ("--- {}\n--- {}", "bad.yaml:1: expected one document, got 2"),
        ("rtsProfile:\n  components: [[b]]", "bad.yaml:2: Components: expected a table, got a list"),
        ("rtsProfile:\n  creationDate: {year: x}", "bad.yaml:2: expected year, month"),
    ],
)
def test_yaml_that_is_not_taken(tmp_path: Path, text: str, said: str) -> None:
    pytest.importorskip("yaml")
    assert refused(tmp_path, text, "bad.yaml").startswith(said)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (component("A0", context(rate=-1.0)), "ExecutionContexts: rate = '-1.0': expected a number from 0 on"),
        (component("A0", context()).replace("100.0", "nan"), "ExecutionContexts: rate = 'nan': expected a number"),
        (component("A0") * 2, "a second component 'A0'; the first is at"),
        (component("A0", instanceName=""), "Components: instanceName is missing"),
        (component("A0", compositeType="Odd"), "compositeType = 'Odd': expected None, PeriodicECShared"),
        (
            "".join(component(f"A{n}") for n in range(400))
            + f"<rts:Activation>{''.join(step(1 + n % 2, f'A{n}') for n in range(400))}</rts:Activation>",
            "Activation: steps that wait for more than 20000 components in all",
        ),
        ("<rts:DataPortConnectors/>", "DataPortConnectors: expected one sourceDataPort, got 0"),
        ("<rts:Activation><rts:targets rts:sequence='1'/></rts:Activation>", "expected a TargetComponent"),
    ],
)
def test_profiles_that_cannot_be(tmp_path: Path, inside: str, said: str) -> None:
    found = refused(tmp_path, profile(inside))
    assert found.startswith("bad.xml:")
    assert said in found


def test_files_that_are_no_files_are_not_opened(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.xml"
    os.mkfifo(pipe)
    for path, said in ((pipe, "no regular file"), (tmp_path, "no regular file"), (tmp_path / "none", "No such file")):
        with pytest.raises(OpenRTMError, match=said):
            read_system(path)
    large = tmp_path / "large.xml"
    with large.open("wb") as file:
        file.truncate(10_000_001)
    for read in (read_system, Conf.read, RtcProfile.read):
        with pytest.raises(OpenRTMError, match="larger than 10000000 bytes"):
            read(large)


def test_a_profile_names_no_file_outside_of_its_folder(tmp_path: Path) -> None:
    """Neither by a path, nor by a link, nor by the name of a module that is installed."""
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "near.py").write_text("import aiorts\nclass Near: pass\n")
    (tmp_path / "far.py").write_text("import aiorts\nclass Far: pass\n")
    (tmp_path / "lab" / "link.py").symlink_to(tmp_path / "far.py")
    for stated in ("../far.py:Far", f"{tmp_path}/far.py:Far", "link.py:Far", "os:system", "subprocess:Popen", "/etc:x"):
        text = profile(component("A0", context() + prop("aiorts.type", f'"{stated}"')))
        (tmp_path / "lab" / "p.xml").write_text(text)
        wanted, notes = read_system(tmp_path / "lab" / "p.xml", folder=tmp_path)
        assert wanted.components["A0"].type == "A"
        assert any("is not below a folder that may be named (--module-path)" in note.text for note in notes)
    (tmp_path / "lab" / "p.xml").write_text(profile(component("A0", context() + prop("aiorts.type", '"near.py:Near"'))))
    wanted, notes = read_system(tmp_path / "lab" / "p.xml", folder=tmp_path)
    assert wanted.components["A0"].type == f"{tmp_path.resolve()}/lab/near.py:Near"
    assert notes == ()


def test_properties_of_ours_that_others_wrote_are_taken_with_care(tmp_path: Path) -> None:
    odd = "".join(
        prop(f"aiorts.{key}", value)
        for key, value in (
            ("start", '{"after": ["A0 active"]}'),
            ("supervision", '{"restart": "explode"}'),
            ("options", "[" * 5000),
            ("type", "5"),
        )
    )
    (tmp_path / "p.xml").write_text(profile(component("A0", context() + odd)))
    wanted, notes = read_system(tmp_path / "p.xml")
    one = wanted.components["A0"]
    assert (one.start, one.supervision, one.options, one.type) == (None, None, (), "A")
    assert sum("left out" in note.text for note in notes) == 4


def test_a_constraint_that_a_value_breaks_is_said_with_its_line(tmp_path: Path) -> None:
    sets = configuration("default", gain="7", odd="1") + configuration("__constraints__", gain="x<5", odd="x ~ 3")
    (tmp_path / "p.xml").write_text(profile(component("A0", sets + configuration("__type__", gain="int") + context())))
    wanted, notes = read_system(tmp_path / "p.xml")
    assert dict(wanted.components["A0"].params) == {"gain": 7, "odd": "1"}
    said = [str(note) for note in notes if "its constraint" in note.text]
    assert len(said) == 2
    assert all(f"{tmp_path}/p.xml:4: A0." in line for line in said)


def test_the_command_says_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.xml").write_text(LAUGHS)
    assert run_command(["import", str(tmp_path / "bad.xml")]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert (
        said.err
        == f"aiorts: E-OPENRTM: {tmp_path}/bad.xml:2: a document type has no place in a profile; take it away\n"
    )
