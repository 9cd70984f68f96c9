"""ROS 2 through the robot's own rclpy: nodes, topics, lifecycle. The only file that knows rclpy and message packages.

rclpy is not installed by pip beside us: it is the robot's, and is imported when the first node is made.
"""

from __future__ import annotations

import array
import re
import threading
import traceback
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Protocol

from leadline.errors import InputError

SPIN_S = 0.1
DEPTH = 10
_SEQUENCE = re.compile(r"sequence<(\w+)/(\w+)(?:, \d+)?>")
Take = Callable[[Any], None]


class Activity(Protocol):
    """What a lifecycle node does. Each method may raise InputError: the transition fails, and the log says why."""

    def configure(self, node: RosNode) -> None: ...

    def activate(self) -> None: ...

    def deactivate(self) -> None:
        """Also called when it is not active; never raises."""


def message_class(name: str) -> Any:
    """Of ``package/msg/Name``; None where this robot has no such package."""
    package, _, kind = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except ImportError:
        return None


def fill(message: Any, fields: dict[str, Any]) -> Any:
    """A message with its fields from a dictionary, as ``ros2_messages`` gives it."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif isinstance(value, bytes):
            setattr(message, name, array.array("B", value))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            found = _SEQUENCE.fullmatch(message.get_fields_and_field_types()[name])
            assert found is not None, name
            inner = message_class(f"{found[1]}/msg/{found[2]}")
            setattr(message, name, [fill(inner(), one) for one in value])
        elif message.get_fields_and_field_types()[name] == "octet":
            setattr(message, name, bytes([value]))
        else:
            setattr(message, name, value)
    return message


class Publisher:
    def __init__(self, publisher: Any, kind: Any) -> None:
        self._publisher, self._kind = publisher, kind

    def send(self, fields: dict[str, Any]) -> None:
        self._publisher.publish(fill(self._kind(), fields))

    @property
    def listeners(self) -> int:
        return int(self._publisher.get_subscription_count())


class Ros:
    """One DDS participant and its executor. arguments: ROS's own (``--ros-args ...``)."""

    def __init__(self, arguments: Sequence[str] = ()) -> None:
        self._rclpy = _rclpy()
        self._context = self._rclpy.context.Context()
        self._rclpy.init(args=list(arguments), context=self._context)
        self._executor = import_module("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._nodes: list[RosNode] = []

    def node(self, name: str, activity: Activity | None = None) -> RosNode:
        """A plain node, or with an activity one with a lifecycle."""
        if activity is None:
            inner = self._rclpy.create_node(name, context=self._context)
        else:
            inner = _lifecycle_node(name, self._context, activity)
        node = RosNode(inner)
        self._executor.add_node(inner)
        self._nodes.append(node)
        return node

    def spin(self) -> None:
        """Until ``stop``, or until ROS itself is shut down."""
        while not self._stop.is_set() and self._context.ok():
            self._executor.spin_once(timeout_sec=SPIN_S)

    def start(self) -> None:
        """Spin in a thread."""
        self._thread = threading.Thread(target=self.spin, name="ros2", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """From any thread or a signal handler."""
        self._stop.set()

    def close(self) -> None:
        """Safe to call twice."""
        self.stop()
        if self._thread is not None:
            self._thread.join(2.0)
        for node in self._nodes:
            node.close()
        self._nodes.clear()
        self._executor.shutdown(timeout_sec=1.0)
        if self._context.ok():
            self._context.shutdown()


class RosNode:
    def __init__(self, node: Any) -> None:
        self._node = node
        self._subscriptions: list[Any] = []
        self._publishers: list[Any] = []

    @property
    def name(self) -> str:
        return str(self._node.get_fully_qualified_name())

    def parameter(self, name: str, default: Any) -> Any:
        """The parameter's value, of the default's type. InputError for a value of another type."""
        if not self._node.has_parameter(name):
            try:
                self._node.declare_parameter(name, default)
            except Exception as error:  # rclpy's own types of it
                raise InputError(f"parameter {name}: {error}", self.name, f"give it like {default!r}") from error
        return self._node.get_parameter(name).value

    def subscribe(self, topic: str, kind: str, take: Take, *, reliable: bool = False) -> None:
        """take: called with each message, in the thread that spins. InputError where the package is missing."""
        made = message_class(kind)
        if made is None:
            raise InputError(f"{kind} is not installed", topic, f"apt install ros-$ROS_DISTRO-{_package(kind)}")
        self._subscriptions.append(self._node.create_subscription(made, _named(topic), take, _qos(reliable)))

    def publisher(self, topic: str, kind: str, *, reliable: bool = True, latched: bool = False) -> Publisher | None:
        """None where this robot has no such message."""
        made = message_class(kind)
        if made is None:
            return None
        publisher = self._node.create_publisher(made, _named(topic), _qos(reliable, latched))
        self._publishers.append(publisher)
        return Publisher(publisher, made)

    def release(self) -> None:
        """Let go of all topics. From the spinning thread, or when none spins."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)
        self._subscriptions.clear()
        self._publishers.clear()

    def info(self, text: str) -> None:
        self._node.get_logger().info(text)

    def error(self, text: str) -> None:
        self._node.get_logger().error(text)

    def bring_up(self) -> None:
        """A lifecycle node goes from unconfigured to active by itself, as far as it comes."""
        success = import_module("rclpy.lifecycle").TransitionCallbackReturn.SUCCESS
        if self._node.trigger_configure() == success:
            self._node.trigger_activate()

    def close(self) -> None:
        self._node.destroy_node()


def _rclpy() -> Any:
    try:
        import_module("rclpy.executors")
        import_module("rclpy.lifecycle")
        return import_module("rclpy")
    except ImportError as error:
        fix = "source /opt/ros/$ROS_DISTRO/setup.bash, and run with the Python that ROS runs with"
        raise InputError(f"ROS 2 is not here ({error})", "rclpy", fix) from None


def _named(topic: str) -> str:
    """Our own topics follow the node's namespace; without one they are where a recording has them."""
    return topic.removeprefix("/") if topic.startswith("/leadline/") else topic


def _package(kind: str) -> str:
    return kind.partition("/")[0].replace("_", "-")


def _qos(reliable: bool, latched: bool = False) -> Any:
    """Sensor data: the newest few, and what is lost is lost; reliable: sent again until it has come."""
    qos = import_module("rclpy.qos")
    return qos.QoSProfile(
        depth=1 if latched else DEPTH,
        reliability=qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT,
        durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE,
    )


def _lifecycle_node(name: str, context: Any, activity: Activity) -> Any:
    lifecycle = import_module("rclpy.lifecycle")
    returned = lifecycle.TransitionCallbackReturn

    class Managed(lifecycle.LifecycleNode):  # type: ignore[misc, name-defined]
        def on_configure(self, _state: Any) -> Any:
            return self._try(lambda: activity.configure(RosNode(self)))

        def on_activate(self, state: Any) -> Any:
            super().on_activate(state)
            return self._try(activity.activate)

        def on_deactivate(self, state: Any) -> Any:
            activity.deactivate()
            return super().on_deactivate(state)

        def on_cleanup(self, _state: Any) -> Any:
            activity.deactivate()
            return returned.SUCCESS

        on_shutdown = on_cleanup
        on_error = on_cleanup

        def destroy_node(self) -> None:
            activity.deactivate()
            super().destroy_node()

        def _try(self, do: Callable[[], None]) -> Any:
            try:
                do()
            except InputError as error:
                self.get_logger().error(str(error))
                return returned.FAILURE
            except Exception:  # rclpy would say nothing at all
                self.get_logger().error(traceback.format_exc())
                return returned.ERROR
            return returned.SUCCESS

    return Managed(name, context=context)
