"""Parameters that come and go at run time, by standard names; what a tool is told of a component's parameters."""

from __future__ import annotations

import dataclasses
import enum
import json
import logging
from pathlib import Path
from typing import Any, ClassVar

import pytest

from aiorts import Component, ExternalContext, Kernel, Param
from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError
from aiorts.events import ParameterAdded, ParameterChanged, ParameterRemoved
from aiorts.model.configuration.constraint_text import parse_constraint
from aiorts.model.configuration.standard_names import STANDARD_NAMES
from aiorts.model.values import parse_type
from aiorts.testing import simulated
from config_parts import Arm, hear


@simulated
async def test_a_property_comes_and_goes_while_the_component_runs() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        context = await kernel.start(ExternalContext(), arm, activate=True)
        await context.tick()
        heard = hear(kernel, ParameterAdded, ParameterRemoved, ParameterChanged)
        await arm.add_param("baud_rate", Param(9600, constraint="(9600, 19200)", unit="Bd"))
        assert (arm.baud_rate, arm.params["baud_rate"].value, arm.params["baud_rate"].unit) == (9600, 9600, "Bd")  # type: ignore[attr-defined]
        await arm.configure(baud_rate=19200)
        await arm.configuration.change("stiff", {"baud_rate": 9600})
        await arm.configuration.activate("stiff")
        with pytest.raises(ConfigurationError, match="must be one of 9600, 19200"):
            await arm.configure(baud_rate=1)
        await arm.remove_param("baud_rate")
        assert not hasattr(arm, "baud_rate")
        assert all("baud_rate" not in values for values in arm.configuration.sets.values())
        with pytest.raises(ConfigurationError, match="no such parameter"):
            await arm.configure(baud_rate=9600)
        assert [
            (type(event).__name__, getattr(event, "new", "")) for event in heard if event.parameter == "baud_rate"
        ] == [
            ("ParameterAdded", ""),
            ("ParameterChanged", 19200),
            ("ParameterChanged", 9600),
            ("ParameterRemoved", ""),
        ]


@simulated
async def test_a_component_adds_what_its_device_tells_it() -> None:
    class Laser(Component):
        async def on_initialize(self) -> None:
            await self.add_param("serial_number", Param("A-17"))

    async with Kernel() as kernel:
        laser: Any = await kernel.add(Laser("laser"))
        assert laser.serial_number == "A-17"
        other = await kernel.add(Component("other"))
        assert (list(laser.params), list(other.params)) == (["serial_number"], [])


@pytest.mark.parametrize(
    ("name", "param", "error", "why"),
    [
        ("low", Param(1), ConfigurationError, "there is a parameter of that name already"),
        ("ports", Param(1), ConfigurationError, "has something of that name already"),
        ("on_execute", Param(1), ConfigurationError, "has something of that name already"),
        ("seen", Param(1), ConfigurationError, "has something of that name already"),
        ("a-b", Param(1), ConfigurationError, "cannot be used as one"),
        ("class", Param(1), ConfigurationError, "cannot be used as one"),
        ("_rt", Param(1), ConfigurationError, "cannot be used as one"),
        ("a b", Param(1), InvalidNameError, "parameter name 'a b'"),
        ("fine", 1, DeclarationError, r"expected Param\(...\), got 1"),
        ("fine", Param(1, ge=2), DeclarationError, "must be >= 2"),
    ],
)
@simulated
async def test_a_property_that_cannot_be_is_refused(name: str, param: Any, error: type[Exception], why: str) -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        before = arm.params._state, dict(vars(arm))
        with pytest.raises(error, match=why):
            await arm.add_param(name, param)
        assert (arm.params._state, dict(vars(arm))) == before


@simulated
async def test_what_the_class_declares_cannot_be_removed() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        with pytest.raises(ConfigurationError, match="is declared by its class"):
            await arm.remove_param("low")
        with pytest.raises(ConfigurationError, match=r"no such parameter; did you mean low\?"):
            await arm.remove_param("lo")


@simulated
async def test_names_that_are_no_standard_are_allowed_and_reported_with_near_ones(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, "aiorts.kernel")
    async with Kernel() as kernel:
        one = await kernel.add(Component("one"))
        heard = hear(kernel, ParameterAdded)
        for name, param in (
            ("frame_id", Param("base")),
            ("frameid", Param("base")),
            ("colour_of_luck", Param("red")),
            ("mass", Param(1.0, unit="g")),
            ("serial_number", Param(17)),
            ("device", Param(None, type=Path | None)),
        ):
            await one.add_param(name, param)
        remarks = {event.parameter: event.remark for event in heard}
        assert remarks["frameid"].startswith("no standard name; did you mean frame_id")
        assert remarks["colour_of_luck"] == "no standard name"
        assert remarks["mass"] == "a standard name, but its unit is kg, not g"
        assert remarks["serial_number"] == "a standard name, but its type is str, not int"
        assert (remarks["frame_id"], remarks["device"]) == ("", "")
        assert len([line for line in caplog.messages if "standard name" in line]) == 4


def test_every_standard_name_has_a_type_that_a_parameter_can_have() -> None:
    for name, standard in STANDARD_NAMES.items():
        assert name.isidentifier()
        assert parse_type(standard.type) is not None
        assert standard.doc


class Parity(enum.Enum):
    NONE = 0
    EVEN = 2


class Shown(Component):
    gain = Param(1.0, ge=0.0, lt=float("inf"), unit="N", doc="how much", widget="slider.0.1")
    mode = Param("slow", choices=("slow", "fast"), widget="radio")
    parity = Param(Parity.NONE)
    device = Param(Path("/dev/x"), pattern="/dev/.*")
    limits = Param((1.0, float("inf")), constraint="x>=0, x>1")
    configurations: ClassVar = {"fast": {"mode": "fast", "parity": "EVEN"}}


@pytest.mark.row(74)
@simulated
async def test_everything_a_tool_needs_to_know_of_parameters_is_plain_data() -> None:
    """OpenRTM has an interface for it that nobody implemented: `get_configuration_parameters` is empty."""
    async with Kernel() as kernel:
        shown = await kernel.add(Shown("shown"))
        await shown.configuration.activate("fast")
        await shown.add_param("framid", Param("base"))
        profile = shown.configuration.profile
        plain = json.loads(json.dumps(dataclasses.asdict(profile), allow_nan=False))
        assert plain["active"] == "fast"
        assert plain["sets"]["fast"] == {"mode": "fast", "parity": "EVEN"}
        parameters = {one["name"]: one for one in plain["parameters"]}
        assert parameters["gain"] == {
            "name": "gain",
            "type": "float",
            "value": 1.0,
            "default": 1.0,
            "unit": "N",
            "doc": "how much",
            "constraint": "0.0<=x<inf",
            "lower": 0.0,
            "lower_included": True,
            "upper": "inf",
            "upper_included": False,
            "choices": None,
            "pattern": None,
            "widget": "slider.0.1",
            "file": "",
            "declared": True,
            "remark": "",
        }
        assert (parameters["mode"]["value"], parameters["mode"]["choices"]) == ("fast", ["slow", "fast"])
        assert (parameters["parity"]["value"], parameters["parity"]["type"]) == ("EVEN", "Parity")
        assert parameters["limits"]["value"] == [1.0, "inf"]
        assert parameters["framid"]["declared"] is False
        assert "frame_id" in parameters["framid"]["remark"]
        # What was shown is what the parameter takes.
        before = shown.params._state.values
        await shown.configure(**{name: one["value"] for name, one in parameters.items()})
        assert repr(shown.params._state.values) == repr(before)
        for name, one in parameters.items():
            parse_constraint(one["constraint"])
            assert shown.params[name].unit == one["unit"]
        with pytest.raises(dataclasses.FrozenInstanceError):
            profile.active = "default"  # type: ignore[misc]
