"""`aiorts log export`: writes a recording in the format of another system."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from aiorts import exits
from aiorts_log.commands.output import FILE, UNLIMITED, number, safe, say_unclosed
from aiorts_log.commands.working import WritingCommand

if TYPE_CHECKING:
    from aiorts_log.foreign.exporting import ExportReport


@click.command("export", cls=WritingCommand, short_help="Write a recording as a ROS 2 bag.")
@click.argument("source", type=FILE, metavar="FILE")
@click.option("-o", "--output", "target", type=FILE, required=True, metavar="FOLDER", help="The bag: a new folder.")
@click.option(
    "--to", "system", type=click.Choice(["ros2"]), default="ros2", show_default=True, help="The system to export for."
)
@click.option("--port", "ports", multiple=True, metavar="NAME", help="Only this port; may be given more than once.")
@click.option("--skip-others", is_flag=True, help="Leave out ports that the other system has no messages for.")
@click.option(
    "--storage",
    type=click.Choice(["mcap", "sqlite3"]),
    default="mcap",
    show_default=True,
    help="The bag's kind of file.",
)
@click.option("--json", "as_json", is_flag=True, help="One JSON document.")
@UNLIMITED
def export_command(source: Path, target: Path, ports: tuple[str, ...], as_json: bool, **how: Any) -> int:
    """Write a new folder, a bag of ROS 2, from FILE, a recording of ports with messages of ROS 2.

    \b
      aiorts log import rosbag2_2026_03_01/ run.mcap
      aiorts log export --to ros2 run.mcap -o again/

    The messages: Imu, LaserScan, Image, CompressedImage, PointCloud2, JointState and NavSatFix of sensor_msgs, Twist,
    TwistStamped, PoseStamped and TransformStamped of geometry_msgs, Odometry of nav_msgs. Needs rosbags: pip install
    "aiorts[ros]".
    """
    from aiorts_log.foreign.exporting import export_ros2  # loads numpy, which no other command needs

    del how["system"]
    report = export_ros2(source, target, ports=ports or None, **how)
    click.echo(json.dumps(asdict(report), indent=1) if as_json else "\n".join(_lines(target, report)))
    for name, why in report.left.items():
        click.echo(f"  left out: {safe(name)}: {safe(why)}", err=True)
    return exits.FAILED if say_unclosed(report.not_closed) else exits.DONE


def _lines(target: Path, report: ExportReport) -> list[str]:
    total = number(sum(report.messages.values()), "message")
    lines = [f"{safe(target)}: {total} of {number(len(report.messages), 'topic')}"]
    for topic, count in report.messages.items():
        lines.append(f"  {safe(topic)}: {number(count, 'message')} of {safe(report.topics[topic])}")
    return lines
