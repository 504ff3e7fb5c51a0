"""Poses as ROS 2 messages in a bag of one MCAP file.

This is the one module that imports rosbags, which the extra ``[robot]`` installs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
import torch

from objconnect.localization.pipeline.stamped_pose import StampedPose
from objconnect.scene.geometry.pose import quaternion_from_rotation
from objconnect.scene.runtime.extras import import_extra

# Rotation from the axes of a body by REP 103, which point forward (here along the optical axis),
# left and up, to the axes of the camera.
_CAM_FROM_BODY: Final = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# Prefix of the topics.
_TOPIC: Final = "/objconnect"
# Names of the frames of the map and of the camera.
_MAP_FRAME: Final = "map"
_CAMERA_FRAME: Final = "camera_link"


def import_rosbags() -> tuple[ModuleType, ModuleType]:
    """Return the modules of rosbags for bags and for message types.

    Raises:
        InputError: rosbags is not installed.
    """
    purpose = "a ROS 2 bag (.mcap)"
    bags = import_extra("rosbags.rosbag2", "robot", purpose)
    return bags, import_extra("rosbags.typesys", "robot", purpose)


def encode_bag(poses: Sequence[StampedPose], mark: str) -> bytes:
    """Return a bag (MCAP), for ``ros2 bag play``.

    Each pose is written as a ``sensor_msgs/NavSatFix``. The altitude is above the ellipsoid. The
    covariance is on earth; its type is unknown unless the covariance of the pose and the map's
    horizontal and vertical accuracy on earth are known. If the covariance of the pose is known, the
    pose is also written as a ``geometry_msgs/PoseWithCovarianceStamped`` in the frame ``map``, with
    its covariance within the map: metres east, north and up from the map's origin. Body axes follow
    REP 103 (x forward along the optical axis, y left, z up), and rotations of the covariance are
    about the fixed axes of the map.

    Args:
        poses: sorted by time.
        mark: name of the program that made the bag.

    Raises:
        InputError: rosbags is not installed.
    """
    bags, typesys = import_rosbags()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with bags.Writer(path, version=9, storage_plugin=bags.StoragePlugin.MCAP) as writer:
            _write(writer, store, poses, mark)
        (file,) = path.glob("*.mcap")
        return file.read_bytes()


def _write(writer: Any, store: Any, poses: Sequence[StampedPose], mark: str) -> None:
    def topic(name: str, kind: str) -> Any:
        return writer.add_connection(f"{_TOPIC}/{name}", kind, typestore=store)

    def put(connection: Any, microseconds: int, message: Any) -> None:
        data = store.serialize_cdr(message, connection.msgtype)
        writer.write(connection, microseconds * 1000, data)

    # This message comes first, so that the beginning of the file names the program.
    text = store.types["std_msgs/msg/String"](data=mark)
    put(topic("made_by", "std_msgs/msg/String"), poses[0].microseconds if poses else 0, text)
    position = topic("fix", "sensor_msgs/msg/NavSatFix")
    pose = topic("pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    for stamped in poses:
        put(position, stamped.microseconds, _position(store.types, stamped))
        # An unknown covariance would have to be zeros, which a filter would take for certainty.
        if stamped.covariance is not None:
            put(pose, stamped.microseconds, _pose(store.types, stamped))


def _header(types: Any, stamped: StampedPose, frame: str) -> Any:
    seconds, rest = divmod(stamped.microseconds, 1_000_000)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest * 1000)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _position(types: Any, stamped: StampedPose) -> Any:
    kind = types["sensor_msgs/msg/NavSatFix"]
    status = types["sensor_msgs/msg/NavSatStatus"]
    covariance = stamped.accuracy.covariance
    return kind(
        header=_header(types, stamped, _CAMERA_FRAME),
        status=status(status=status.STATUS_FIX, service=0),  # no satellites
        latitude=stamped.place.latitude,
        longitude=stamped.place.longitude,
        altitude=stamped.place.altitude,
        position_covariance=np.zeros(9) if covariance is None else covariance.ravel(),
        position_covariance_type=kind.COVARIANCE_TYPE_UNKNOWN
        if covariance is None
        else kind.COVARIANCE_TYPE_KNOWN,
    )


def _pose(types: Any, stamped: StampedPose) -> Any:
    assert stamped.covariance is not None
    x, y, z = stamped.centre.tolist()
    world_from_body = torch.from_numpy(stamped.world_from_cam @ _CAM_FROM_BODY)
    qw, qx, qy, qz = quaternion_from_rotation(world_from_body).tolist()
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )
    covariance = np.ascontiguousarray(stamped.covariance).ravel()
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](
        header=_header(types, stamped, _MAP_FRAME),
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
    )
