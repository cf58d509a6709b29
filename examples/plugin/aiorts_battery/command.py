"""The command `aiorts battery-life`: any click command can be one."""

from __future__ import annotations

import click

__all__ = ("battery_life",)


@click.command()
@click.option("--capacity", type=click.FloatRange(min=0.0, min_open=True), required=True, help="Ah")
@click.option("--current", type=click.FloatRange(min=0.0, min_open=True), required=True, help="A")
def battery_life(capacity: float, current: float) -> None:
    """Say how long a battery lasts."""
    minutes = round(60.0 * capacity / current)
    click.echo(f"{minutes // 60} h {minutes % 60:02} min")
