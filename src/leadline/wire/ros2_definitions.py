"""Topics of a recording and the ROS 2 (Jazzy) definitions of their messages, as they stand in the file."""

from __future__ import annotations

LEFT_IMAGE = "/leadline/left/image/compressed"
RIGHT_IMAGE = "/leadline/right/image/compressed"
LEFT_INFO = "/leadline/left/camera_info"
RIGHT_INFO = "/leadline/right/camera_info"
LASER = "/leadline/laser/range"
MOTION = "/leadline/motion"
DETECTIONS = "/leadline/detections"
TARGET = "/leadline/target"
DIAGNOSTICS = "/diagnostics"
# What the standard messages have no field for (or only a float32): one message after each sample, all that is exact.
SAMPLE_INFO = "/leadline/sample_info"

TOPIC_TYPES = {
    LEFT_IMAGE: "sensor_msgs/msg/CompressedImage",
    RIGHT_IMAGE: "sensor_msgs/msg/CompressedImage",
    LEFT_INFO: "sensor_msgs/msg/CameraInfo",
    RIGHT_INFO: "sensor_msgs/msg/CameraInfo",
    LASER: "sensor_msgs/msg/Range",
    MOTION: "geometry_msgs/msg/TwistWithCovarianceStamped",
    DETECTIONS: "vision_msgs/msg/Detection2DArray",
    TARGET: "geometry_msgs/msg/PoseWithCovarianceStamped",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    SAMPLE_INFO: "diagnostic_msgs/msg/DiagnosticArray",
}

# Each type's own fields; ``definition`` appends those of the types inside, as a recording wants them.
_FIELDS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify",
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/Range": (
        "uint8 ULTRASOUND=0\nuint8 INFRARED=1\nstd_msgs/Header header\nuint8 radiation_type\nfloat32 field_of_view\n"
        "float32 min_range\nfloat32 max_range\nfloat32 range\nfloat32 variance"
    ),
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovarianceStamped": "std_msgs/Header header\ngeometry_msgs/TwistWithCovariance twist",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n"
        "string hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    "vision_msgs/Point2D": "float64 x\nfloat64 y",
    "vision_msgs/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "vision_msgs/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox2D bbox\n"
        "string id"
    ),
    "vision_msgs/Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections",
}
_SEPARATOR = "\n" + "=" * 80 + "\n"


def definition(message_type: str) -> str:
    """The full text of ``package/msg/Name``: its fields, then those of every type inside, once each."""
    first = message_type.replace("/msg/", "/")
    order = [first]
    for name in order:  # grows while we walk it
        types = (line.split()[0].split("[")[0] for line in _FIELDS[name].splitlines())
        order += [inner for inner in dict.fromkeys(types) if inner in _FIELDS and inner not in order]
    return _SEPARATOR.join([_FIELDS[first], *(f"MSG: {name}\n{_FIELDS[name]}" for name in order[1:])])
