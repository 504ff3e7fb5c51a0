"""Cameras the tests share: every model, mild and strong distortion."""

from __future__ import annotations

from objconnect.scene.geometry.camera import Camera

CAMERAS = {
    "simple_pinhole": Camera("SIMPLE_PINHOLE", 640, 480, (500.0, 322.0, 237.5)),
    "pinhole": Camera("PINHOLE", 640, 480, (500.0, 510.0, 322.0, 237.5)),
    "simple_radial": Camera("SIMPLE_RADIAL", 640, 480, (500.0, 322.0, 237.5, 0.05)),
    "radial_pincushion": Camera("RADIAL", 640, 480, (500.0, 322.0, 237.5, 0.2, 0.1)),
    "radial_barrel": Camera("RADIAL", 640, 480, (600.0, 322.0, 237.5, -0.25, 0.03)),
    # The distortion of the cameras of Extended CMU Seasons.
    "opencv_strong": Camera(
        "OPENCV", 640, 480, (543.0, 541.0, 328.0, 262.0, -0.4, 0.19, -1.5e-4, 2e-4)
    ),
    "opencv_tangential": Camera(
        "OPENCV", 640, 480, (500.0, 510.0, 322.0, 237.5, -0.1, 0.02, 0.01, -0.02)
    ),
    "full_opencv_polynomial": Camera(
        "FULL_OPENCV",
        640,
        480,
        (500.0, 510.0, 322.0, 237.5, -0.27, 0.11, 2e-4, -3e-4, -0.03, 0.0, 0.0, 0.0),
    ),
    "full_opencv_rational": Camera(
        "FULL_OPENCV",
        640,
        480,
        (500.0, 510.0, 322.0, 237.5, 0.6, 0.1, 1e-3, -2e-3, 0.02, 0.9, 0.25, 0.03),
    ),
    "fisheye": Camera(
        "OPENCV_FISHEYE", 640, 480, (280.0, 282.0, 322.0, 237.5, 0.05, -0.01, 2e-3, -5e-4)
    ),
    "fisheye_barrel": Camera(
        "OPENCV_FISHEYE", 640, 480, (350.0, 350.0, 322.0, 237.5, -0.03, -5e-3, 0.0, 0.0)
    ),
}
