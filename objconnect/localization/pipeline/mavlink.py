"""Poses as MAVLink messages in a telemetry log (.tlog), the format of ground stations.

This is the one module that imports pymavlink, which the extra ``[robot]`` installs.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from types import ModuleType
from typing import Final

import numpy as np
import torch

from objconnect.localization.pipeline.stamped_pose import StampedPose
from objconnect.scene.geometry.pose import quaternion_from_rotation
from objconnect.scene.runtime.extras import import_extra

# Rotation from the map's axes (east, north, up) to north, east and down.
_NED_FROM_ENU: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Rotation from forward (optical axis), right and down to the axes of the camera.
_CAM_FROM_FRD: Final = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# MAVLink's system number of the vehicle that sends the messages.
_SYSTEM: Final = 1


def import_dialect() -> ModuleType:
    """Return the dialect ``common`` of MAVLink 2.

    Raises:
        InputError: pymavlink is not installed.
    """
    return import_extra("pymavlink.dialects.v20.common", "robot", "a telemetry log (.tlog)")


def encode_telemetry_log(
    poses: Sequence[StampedPose], undulation_m: float | None, program: str
) -> bytes:
    """Return a telemetry log, in which each message follows its time (8 bytes, microseconds).

    Each pose is written as two messages. GLOBAL_POSITION_SENSOR is what PX4 uses as auxiliary
    global position; its ``eph`` and ``epv`` are the absolute accuracy. ODOMETRY has the position
    from the map's origin in MAV_FRAME_LOCAL_NED and the attitude of the camera, not of the vehicle
    (MAV_FRAME_BODY_FRD: forward is the optical axis); its covariance is relative to the map, about
    the axes of the local frame. Unknown values are NaN, as MAVLink specifies.

    Args:
        poses: sorted by time.
        undulation_m: height of the geoid above the ellipsoid, metres; if None, altitudes above sea
            level are NaN.
        program: name of the program that made the log.

    Raises:
        InputError: pymavlink is not installed.
    """
    common = import_dialect()
    link = common.MAVLink(None, _SYSTEM, common.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)
    first = poses[0].microseconds if poses else 0
    text = common.MAVLink_statustext_message(common.MAV_SEVERITY_INFO, program.encode())
    messages = [(first, text)]
    for stamped in poses:
        messages.append((stamped.microseconds, _global_position(common, stamped, undulation_m)))
        messages.append((stamped.microseconds, _odometry(common, stamped)))
    log = bytearray()
    for number, (microseconds, message) in enumerate(messages):
        link.seq = number % 256
        log += struct.pack(">Q", microseconds) + message.pack(link)
    return bytes(log)


def _global_position(
    common: ModuleType, stamped: StampedPose, undulation_m: float | None
) -> object:
    eph_m, epv_m = stamped.accuracy.eph_m, stamped.accuracy.epv_m
    return common.MAVLink_global_position_sensor_message(
        target_system=0,  # everyone
        target_component=0,
        id=0,
        time_usec=stamped.microseconds,
        processing_time=0,
        source=common.GLOBAL_POSITION_SRC_VISION,
        flags=0,
        lat=round(stamped.place.latitude * 1e7),
        lon=round(stamped.place.longitude * 1e7),
        alt_ellipsoid=stamped.place.altitude,
        alt=math.nan if undulation_m is None else stamped.place.altitude - undulation_m,
        eph=math.nan if eph_m is None else eph_m,
        epv=math.nan if epv_m is None else epv_m,
    )


def _odometry(common: ModuleType, stamped: StampedPose) -> object:
    ned_from_frd = _NED_FROM_ENU @ stamped.world_from_cam @ _CAM_FROM_FRD
    x, y, z = (_NED_FROM_ENU @ stamped.centre).tolist()
    upper = np.full(21, math.nan)
    if stamped.covariance is not None:
        rotation = np.kron(np.eye(2), _NED_FROM_ENU)
        upper = (rotation @ stamped.covariance @ rotation.T)[np.triu_indices(6)]
    unknown = math.nan
    return common.MAVLink_odometry_message(
        time_usec=stamped.microseconds,
        frame_id=common.MAV_FRAME_LOCAL_NED,
        child_frame_id=common.MAV_FRAME_BODY_FRD,
        x=x,
        y=y,
        z=z,
        q=quaternion_from_rotation(torch.from_numpy(ned_from_frd)).tolist(),
        vx=unknown,
        vy=unknown,
        vz=unknown,
        rollspeed=unknown,
        pitchspeed=unknown,
        yawspeed=unknown,
        pose_covariance=upper.tolist(),
        velocity_covariance=[unknown] * 21,
        reset_counter=0,
        estimator_type=common.MAV_ESTIMATOR_TYPE_VISION,
        quality=0,  # unknown
    )
