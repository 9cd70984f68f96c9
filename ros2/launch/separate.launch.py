"""Camera, laser and localizer, each in a process of its own that is started again when it dies."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("leadline_ros"))
NODES = ("camera", "laser", "localizer")


def generate_launch_description() -> LaunchDescription:
    params = DeclareLaunchArgument("params", default_value=str(SHARE / "config" / "leadline.yaml"))
    nodes = [
        Node(
            package="leadline_ros",
            executable=name,
            parameters=[LaunchConfiguration("params")],
            output="screen",
            respawn=True,
            respawn_delay=1.0,
        )
        for name in NODES
    ]
    return LaunchDescription([params, *nodes])
