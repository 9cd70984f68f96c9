"""The other process of the ROS 2 tests: publishes a dive as topics and writes down what comes back.

Run by a Python that has rclpy and leadline: ``ros2_driver.py gate|play DIVE OUT.json``. ``gate``: configure, activate,
each sample only after the solution of the one before, then the dive once more at its own pace, deactivate. ``play``:
over and over at its own pace until killed, one line for each pose.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from leadline.rig import Rig
from leadline.samples import Sample, StereoFrame
from leadline.sinks.ros2 import ANNOTATED, GUIDANCE, Ros2Samples
from leadline.sources import open_source
from leadline.sources.sync import arrival_ns
from leadline.wire.ros2_definitions import DIAGNOSTICS, TARGET, TOPIC_TYPES
from leadline.wire.ros2_messages import stamp_ns
from leadline.wire.ros2_node import Ros

PATIENCE_S = 240.0
ANSWER_S = 30.0
QUIET_S = 0.3  # for a reading that brings no solution
SERVICE = "/leadline_localizer/change_state"
TRANSITIONS = {"configure": 1, "cleanup": 2, "activate": 3, "deactivate": 4}


def until(true: Callable[[], bool], patience_s: float = PATIENCE_S) -> bool:
    end_s = time.monotonic() + patience_s
    while not true():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.002)
    return True


class Driver:
    def __init__(self, dive: str) -> None:
        self.ros = Ros()
        self.node = self.ros.node("driver")
        self.samples = list(open_source(dive))
        self.poses: dict[int, tuple[float, float, float]] = {}
        self.solved: dict[int, float] = {}
        self.statuses: dict[str, set[int]] = {}
        self.pictures = 0
        self.sender = Ros2Samples(self.node, Rig.load(f"{dive}/rig.yaml"), frames=True, readings=True, reliable=True)
        self.node.subscribe(TARGET, TOPIC_TYPES[TARGET], self._pose, reliable=True)
        self.node.subscribe(GUIDANCE, "std_msgs/msg/String", self._guidance, reliable=True)
        self.node.subscribe(DIAGNOSTICS, TOPIC_TYPES[DIAGNOSTICS], self._diagnostics, reliable=True)
        self.ros.start()

    def watch_pictures(self) -> None:
        def count(_: Any) -> None:
            self.pictures += 1

        self.node.subscribe(ANNOTATED, "sensor_msgs/msg/CompressedImage", count)

    def connected(self) -> bool:
        heard = all(one.get_publisher_count() for one in self.node._subscriptions)
        return heard and all(publisher.get_subscription_count() for publisher in self.node._publishers[:2])

    def change(self, transition: str) -> bool:
        from lifecycle_msgs.srv import ChangeState  # noqa: PLC0415

        client = self.node._node.create_client(ChangeState, SERVICE)
        if not client.wait_for_service(timeout_sec=PATIENCE_S):
            raise RuntimeError(f"no {SERVICE}")
        request = ChangeState.Request()
        request.transition.id = TRANSITIONS[transition]
        future = client.call_async(request)
        if not until(future.done):
            raise RuntimeError(f"{transition}: no answer")
        return bool(future.result().success)

    def in_step(self, shift_ns: int) -> None:
        for sample in self.samples:
            sent = moved(sample, shift_ns)
            self.sender.send(sent)
            patience_s = ANSWER_S if isinstance(sample, StereoFrame) else QUIET_S
            until(lambda t_ns=sent.t_ns: t_ns in self.solved, patience_s)

    def at_pace(self) -> dict[int, float]:
        """When each frame was published, by its stamp."""
        start_s, first_ns, shift_ns = time.time(), arrival_ns(self.samples[0]), 0
        shift_ns = time.time_ns() - first_ns
        published: dict[int, float] = {}
        for sample in self.samples:
            time.sleep(max(0.0, (arrival_ns(sample) - first_ns) / 1e9 - (time.time() - start_s)))
            sent = moved(sample, shift_ns)
            if isinstance(sent, StereoFrame):
                published[sent.t_ns] = time.time()
            self.sender.send(sent)
        return published

    def _pose(self, message: Any) -> None:
        point = message.pose.pose.position
        self.poses[stamp_ns(message)] = point.x, point.y, point.z

    def _guidance(self, message: Any) -> None:
        now_s = time.time()
        stamp = json.loads(message.data)["stamp"]
        self.solved[stamp["sec"] * 10**9 + stamp["nanosec"]] = now_s

    def _diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.statuses.setdefault(status.name, set()).add(status.level[0])


def moved(sample: Sample, by_ns: int) -> Sample:
    return replace(sample, t_ns=sample.t_ns + by_ns, arrival_ns=None)


def gate(driver: Driver, out: Path, rounds: int) -> None:
    changes = [driver.change("configure"), driver.change("activate")]
    assert until(driver.connected)
    shift_ns = time.time_ns() - driver.samples[-1].t_ns
    driver.in_step(shift_ns)
    until(lambda: len(driver.poses) >= len(driver.solved) - 1, 2.0)
    poses = {t_ns - shift_ns: pose for t_ns, pose in driver.poses.items()}
    driver.watch_pictures()
    since_published, since_stamp = [], []
    for _ in range(rounds):
        published = driver.at_pace()
        until(lambda published=published: set(published) <= set(driver.solved), 5.0)
        done = driver.solved
        since_published += [done[t_ns] - sent_s for t_ns, sent_s in published.items() if t_ns in done]
        since_stamp += [done[t_ns] - t_ns / 1e9 for t_ns in published if t_ns in done]
    changes.append(driver.change("deactivate"))
    said = {
        "changes": changes,
        "poses": poses,
        "published": rounds * len([one for one in driver.samples if isinstance(one, StereoFrame)]),
        "since_published_s": since_published,
        "since_stamp_s": since_stamp,
        "statuses": {name: sorted(levels) for name, levels in driver.statuses.items()},
        "pictures": driver.pictures,
    }
    out.write_text(json.dumps(said))


def play(driver: Driver, out: Path) -> None:
    with out.open("w") as stream:
        told = 0
        while True:
            driver.at_pace()
            for t_ns in list(driver.poses)[told:]:
                stream.write(f"{t_ns} {time.time()}\n")
                told += 1
            stream.flush()


def main() -> None:
    mode, dive, out, *rest = sys.argv[1:]
    driver = Driver(dive)
    if mode == "gate":
        gate(driver, Path(out), int(rest[0]) if rest else 1)
        driver.ros.close()
    else:
        play(driver, Path(out))


if __name__ == "__main__":
    main()
