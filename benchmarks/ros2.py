"""Latency over ROS 2: from publishing an image, and from its stamp, to the solution; two processes over DDS.

python -m benchmarks.ros2 DIVE [--rounds 10]    with $LEADLINE_ROS_PYTHON, or .venv-ros (`make ros`)

The dive is given at its own pace by one process to a localizer node in another. The time from the stamp has the
dive's own camera latency in it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).parents[1]
LOCALIZER = "from leadline_ros.nodes import localizer; localizer()"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ros2")
    parser.add_argument("dive")
    parser.add_argument("--target", default="sphere:0.34")
    parser.add_argument("--rounds", type=int, default=10)
    asked = parser.parse_args()
    python = os.environ.get("LEADLINE_ROS_PYTHON", str(REPOSITORY / ".venv-ros" / "bin" / "python"))
    paths = [REPOSITORY / "src", REPOSITORY / "ros2", sysconfig.get_paths()["purelib"]]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    parameters = {"rig": f"{asked.dive}/rig.yaml", "target": asked.target, "reliable": "true"}
    options = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    node = subprocess.Popen([python, "-c", LOCALIZER, "--ros-args", *options], env=environment)
    try:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "driver.json"
            driver = [python, str(REPOSITORY / "tests" / "ros2_driver.py"), "gate", asked.dive, str(out)]
            subprocess.run([*driver, str(asked.rounds)], env=environment, check=True)
            said = json.loads(out.read_text())
    finally:
        node.terminate()
        node.wait()
    for name, what in (("since_published_s", "publishing"), ("since_stamp_s", "the image's stamp")):
        p50, p90, p99 = 1e3 * np.percentile(said[name], [50, 90, 99])
        print(f"from {what:18} p50 {p50:6.0f} ms   p90 {p90:6.0f} ms   p99 {p99:6.0f} ms")
    print(f"{len(said['since_published_s'])} of {said['published']} frames answered")
    return 0


if __name__ == "__main__":
    sys.exit(main())
