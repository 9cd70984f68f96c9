"""The ament package: what can be told of it without colcon."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
import setuptools
import yaml

from leadline.errors import InputError
from leadline.pipeline.ros2 import NODES, LocalizerNode, SensorNode
from leadline.sources.ros2 import StereoTopics

PACKAGE = Path(__file__).parents[1] / "ros2"
LAUNCHES = sorted(PACKAGE.glob("launch/*.launch.py"))


def setup_arguments(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    said: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: said.update(arguments))
    monkeypatch.chdir(PACKAGE)
    runpy.run_path("setup.py")
    return said


def test_the_manifest_names_the_package_and_all_that_it_imports() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    assert [manifest.findtext(tag) for tag in ("name", "license")] == ["leadline_ros", "Apache-2.0"]
    assert manifest.findtext("export/build_type") == "ament_python"
    needed = {one.text for one in manifest.findall("exec_depend")}
    source = Path(__file__).parents[1] / "src" / "leadline"
    texts = [path.read_text() for room in ("wire", "sinks", "sources") for path in (source / room).glob("ros2*.py")]
    used = {name for text in texts for name in re.findall(r"\b(\w+_msgs)/msg/", text)}
    imported = {
        node.module.split(".")[0]
        for path in LAUNCHES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module
    }
    assert used | imported - {"pathlib"} | {"rclpy", "lifecycle_msgs"} <= needed


def test_every_console_script_is_there_and_all_files_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    said = setup_arguments(monkeypatch)
    monkeypatch.syspath_prepend(str(PACKAGE))
    nodes = runpy.run_module("leadline_ros.nodes")
    for script in said["entry_points"]["console_scripts"]:
        name, module, function = re.fullmatch(r"(\w+) = ([\w.]+):(\w+)", script).groups()  # type: ignore[union-attr]
        assert module == "leadline_ros.nodes"
        assert callable(nodes[function]), name
    installed = {Path(file).name for _, files in said["data_files"] for file in files}
    assert {path.name for path in LAUNCHES} | {"package.xml", "leadline.yaml", "leadline_ros"} == installed
    for file in (file for _, files in said["data_files"] for file in files):
        assert (PACKAGE / file).is_file()


@pytest.mark.parametrize("path", LAUNCHES, ids=lambda path: path.name)
def test_launch_files_start_scripts_that_exist(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[dict[str, Any]] = []
    said = setup_arguments(monkeypatch)
    for name, names in {
        "ament_index_python.packages": {"get_package_share_directory": lambda _: str(PACKAGE)},
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": lambda *_, **arguments: arguments},
        "launch.substitutions": {"LaunchConfiguration": str},
        "launch_ros.actions": {"Node": lambda **arguments: started.append(arguments)},
    }.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(path))["generate_launch_description"]()
    assert Path(description[0]["default_value"]).is_file()
    scripts = {script.split(" ")[0] for script in said["entry_points"]["console_scripts"]}
    assert started
    assert {one["executable"] for one in started} <= scripts
    assert {one["package"] for one in started} == {"leadline_ros"}
    assert all(one["respawn"] for one in started)


class FakeNode:
    """Notes which parameters are asked for."""

    name = "/fake"

    def __init__(self, **said: Any) -> None:
        self.said, self.asked = said, {"autostart"}

    def parameter(self, name: str, default: Any) -> Any:
        self.asked.add(name)
        return self.said.get(name, default)


def test_all_parameters_that_are_wrong_are_told_at_once() -> None:
    node = FakeNode(left="/no topic", rig="nosuch.yaml", target="banana", config="none.yaml", water_state="wet")
    with pytest.raises(InputError) as told:
        LocalizerNode().configure(node)  # type: ignore[arg-type]
    for wrong in ("'/no topic'", "nosuch.yaml", "banana", "none.yaml", "'wet'"):
        assert wrong in str(told.value)


def test_the_configuration_sets_parameters_that_the_nodes_read() -> None:
    settings = yaml.safe_load((PACKAGE / "config" / "leadline.yaml").read_text())
    assert settings.keys() <= {f"leadline_{name}" for name in NODES}
    sensor, localizer = FakeNode(source="live:sim:demo"), FakeNode()
    SensorNode(frames=True, readings=True).configure(sensor)  # type: ignore[arg-type]
    LocalizerNode().configure(localizer)  # type: ignore[arg-type]
    for name, said in settings.items():
        asked = localizer.asked if name == "leadline_localizer" else sensor.asked
        assert said["ros__parameters"].keys() <= asked
    topics = {name: value for name, value in settings["leadline_localizer"]["ros__parameters"].items()
              if hasattr(StereoTopics(), name)}  # fmt: skip
    assert StereoTopics(**topics) == StereoTopics()
