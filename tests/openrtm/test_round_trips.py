"""What is imported and exported again is what it was, but for its date; what changed in between is changed there."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import canonicalize

import pytest
from hypothesis import HealthCheck, given, settings

from aiorts.cli.app import run_command
from openrtm_parts import (
    REAL,
    canonical,
    component,
    configuration,
    connector,
    context,
    preceding,
    profile,
    profiles,
    prop,
    step,
)

ARM = profile(
    component(
        "Arm0", configuration("default", gain="2.5", name="a b") + context(rate=500.0) + "        <!-- mine -->\n"
    )
    + component("Eye0", configuration("default") + context())
    + connector("Eye0.pose", "Arm0.target", prop("dataport.odd", "kept"), subscriptionType="new")
    + "    <rts:Activation>"
    + step(1, "Eye0", '<rts:WaitTime rts:waitTime="0"/>')
    + step(2, "Arm0", preceding("Eye0"))
    + "</rts:Activation>\n"
)


def converted(folder: Path, text: str, form: str = "rtsprofile", suffix: str = ".xml") -> str:
    """A profile that went through a system file."""
    (folder / f"old{suffix}").write_text(text, encoding="utf-8")
    assert run_command(["import", str(folder / f"old{suffix}"), "-o", str(folder / "s.toml"), "--force"]) == 0
    return exported(folder, form)


def exported(folder: Path, form: str = "rtsprofile") -> str:
    assert run_command(["export", str(folder / "s.toml"), "--format", form, "-o", str(folder / "new"), "--force"]) == 0
    return (folder / "new").read_text(encoding="utf-8")


def edited(folder: Path, old: str, new: str) -> str:
    """The profile of the system file of ARM with a change in it."""
    converted(folder, ARM)
    text = (folder / "s.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "s.toml").write_text(text.replace(old, new), encoding="utf-8")
    return exported(folder)


@pytest.mark.row(107)
def test_a_profile_comes_back_as_it_was(tmp_path: Path) -> None:
    """Order, comments, unknown elements, ids: all of it."""
    assert canonicalize(converted(tmp_path, ARM), with_comments=True) == canonicalize(ARM, with_comments=True)


@pytest.mark.slow(kept_by="test_a_profile_comes_back_as_it_was")
@pytest.mark.row(107)
@given(text=profiles())
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_generated_profiles_come_back_as_they_were(tmp_path: Path, text: str) -> None:
    assert canonicalize(converted(tmp_path, text), with_comments=True) == canonicalize(text, with_comments=True)


@pytest.mark.slow(kept_by="openrtm/test_mapping.py::test_systems_of_the_examples_go_over_and_come_back")
@given(text=profiles())
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_yaml_says_the_same_system_and_comes_back(tmp_path: Path, text: str) -> None:
    pytest.importorskip("yaml")
    as_yaml = converted(tmp_path, text, "yaml")
    system = (tmp_path / "s.toml").read_text(encoding="utf-8").replace("old.xml", "old.yaml")
    assert converted(tmp_path, as_yaml, "yaml", ".yaml") == as_yaml
    assert (tmp_path / "s.toml").read_text(encoding="utf-8") == system


@pytest.mark.skipif(REAL is None, reason="the files of the robot arm are not here")
@pytest.mark.row(107)
def test_the_profile_of_a_real_arm_comes_back(tmp_path: Path) -> None:
    assert REAL is not None
    text = (REAL / "mycobot_system.xml").read_text(encoding="utf-8")
    assert canonicalize(converted(tmp_path, text)) == canonicalize(text)
    system = (tmp_path / "s.toml").read_text(encoding="utf-8")
    assert "baudrate = 115200" in system
    assert 'from = "GUI_mycobot0.poseOut"\nto = "myCobotAruco0.poseIn"\nsubscription = "new"' in system


def test_a_changed_parameter_alone_is_changed(tmp_path: Path) -> None:
    new = edited(tmp_path, 'params.gain = "2.5"', "params.gain = 3.5")
    assert canonical(new) == canonical(ARM.replace('rts:data="2.5"', 'rts:data="3.5"'))
    assert re.search(r'updateDate="([^"]*)"', new)[1] != "2026-01-02T03:04:05"  # type: ignore[index]


def test_two_ports_that_are_connected_twice_stay_so_which_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A system file takes a second connection of two ports with `allow_duplicate` alone: the whole import failed."""
    again = connector("Eye0.pose", "Arm0.target", prop("dataport.odd", "again"), subscriptionType="new")
    twice = ARM.replace("    <rts:Activation>", f"{again}    <rts:Activation>", 1)
    assert canonical(converted(tmp_path, twice)) == canonical(twice)
    assert (tmp_path / "s.toml").read_text(encoding="utf-8").count("allow_duplicate = true") == 1
    assert "are connected twice; allow_duplicate keeps both" in "".join(capsys.readouterr())


def test_a_changed_rate_alone_is_changed(tmp_path: Path) -> None:
    new = edited(tmp_path, "rate = 500.0", "rate = 250.0")
    assert canonical(new) == canonical(ARM.replace('rts:rate="500.0"', 'rts:rate="250.0"'))


def test_a_connection_that_is_gone_is_gone(tmp_path: Path) -> None:
    converted(tmp_path, ARM)
    text = (tmp_path / "s.toml").read_text(encoding="utf-8")
    (tmp_path / "s.toml").write_text(re.sub(r"\[\[connections\]\]\n(?:.+\n)+", "", text), encoding="utf-8")
    new = exported(tmp_path)
    assert "DataPortConnectors" not in new
    assert "<!-- mine -->" in new


def test_a_changed_option_leaves_other_properties(tmp_path: Path) -> None:
    new = edited(tmp_path, 'subscription = "new"', 'subscription = "periodic"\npush_rate = 10.0')
    assert 'rts:subscriptionType="periodic"' in new
    assert 'rts:pushInterval="10.0"' in new
    assert prop("dataport.publisher.push_rate", "10.0") in new
    assert prop("dataport.odd", "kept") in new


def test_a_component_that_is_gone_takes_its_connections(tmp_path: Path) -> None:
    converted(tmp_path, ARM)
    left = "".join(
        part
        for part in re.split(r"(?m)^(?=\[)", (tmp_path / "s.toml").read_text(encoding="utf-8"))
        if "Eye0" not in part or "components.Arm0" in part
    )
    (tmp_path / "s.toml").write_text(re.sub(r"start = .*\n", "", left), encoding="utf-8")
    new = exported(tmp_path)
    assert "Eye0" not in new
    assert 'rts:instanceName="Arm0"' in new


@pytest.mark.slow
def test_order_of_starting_goes_over_and_comes_back(tmp_path: Path) -> None:
    """A rule that is changed is in the sequence; read again it is the same rule."""
    converted(tmp_path, ARM)
    assert 'start = { after = ["Eye0 active"], timeout = 5.0 }' in (tmp_path / "s.toml").read_text(encoding="utf-8")
    new = edited(
        tmp_path, 'after = ["Eye0 active"], timeout = 5.0', 'after = ["Eye0 active"], wait = 0.5, timeout = 7.0'
    )
    assert 'rts:timeout="7000"' in new
    before = (tmp_path / "s.toml").read_text(encoding="utf-8")
    converted(tmp_path, new)
    assert (tmp_path / "s.toml").read_text(encoding="utf-8") == before


def test_without_its_old_profile_a_new_one_is_made_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    converted(tmp_path, ARM)
    (tmp_path / "old.xml").unlink()
    system = (tmp_path / "s.toml").read_text(encoding="utf-8")
    new = exported(tmp_path)
    assert "old.xml is not there: ids, layout" in capsys.readouterr().err
    converted(tmp_path, new)
    assert (tmp_path / "s.toml").read_text(encoding="utf-8") == system
