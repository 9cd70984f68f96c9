"""ament_python package: the nodes themselves are leadline's (`leadline.pipeline.ros2`)."""

from glob import glob

from setuptools import setup

NAME = "leadline_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),  # noqa: PTH207  setup.py runs in its own folder
        (f"share/{NAME}/config", glob("config/*.yaml")),  # noqa: PTH207
    ],
    install_requires=["setuptools", "leadline"],
    zip_safe=True,
    maintainer="The leadline authors",
    maintainer_email="maintainers@leadline.invalid",
    description="Lifecycle nodes of leadline",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"camera = {NAME}.nodes:camera",
            f"laser = {NAME}.nodes:laser",
            f"sensors = {NAME}.nodes:sensors",
            f"localizer = {NAME}.nodes:localizer",
            f"together = {NAME}.nodes:together",
        ]
    },
)
