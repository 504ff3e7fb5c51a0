"""The geometry of the project: poses, cameras, projection and world coordinates.

Arrays are NumPy or torch tensors; lengths are metres, pixels are COLMAP's (the centre of the
top-left pixel is (0.5, 0.5)), and a pose named ``a_from_b`` maps points of frame b into frame a.

- ``pose``: rigid transforms in batches, with the exponential map and its Jacobian.
- ``camera``: one calibrated camera in one of COLMAP's models; it loads torch only to project.
- ``projection``: batched projection and unprojection with analytic Jacobians.
- ``geodesy``: conversion between WGS84 and local east-north-up metres.
- ``nearest``: nearest neighbours among many points on a plane.
- ``rectangle``: corners and overlap of rectangles on the ground.
"""
