"""Camera, laser and localizer in one process."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("leadline_ros"))


def generate_launch_description() -> LaunchDescription:
    params = DeclareLaunchArgument("params", default_value=str(SHARE / "config" / "leadline.yaml"))
    together = Node(
        package="leadline_ros",
        executable="together",
        parameters=[LaunchConfiguration("params")],
        output="screen",
        respawn=True,
        respawn_delay=1.0,
    )
    return LaunchDescription([params, together])
