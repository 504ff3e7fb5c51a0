"""The geometry of the project: poses, cameras, projection and world coordinates.

Arrays are NumPy arrays or torch tensors; lengths are metres; pixels are COLMAP's (the centre of the
top-left pixel is (0.5, 0.5)); a pose named ``a_from_b`` maps points of frame b into frame a.

- ``pose``: rigid transforms in batches, with the exponential map and its Jacobian.
- ``camera``: one calibrated camera in one of COLMAP's models; it loads torch only to project.
- ``colmap_models``: conversion of further COLMAP camera models.
- ``projection``: batched projection and unprojection with analytic Jacobians.
- ``views``: images rotated, resized or levelled, with their cameras.
- ``gimbal``: attitudes as yaw, pitch and roll.
- ``geodesy``: conversion between WGS84 and local east-north-up metres.
- ``sampson``: refinement of a pose from 2D-2D matches.
- ``rays``: a pose from directions and attitudes relative to known cameras.
- ``correlation``: correlated residuals and their effect on a covariance.
- ``robust``: constants of robust statistics.
- ``nearest``: nearest neighbours among many points on a plane.
- ``rectangle``: corners and overlap of rectangles on the ground.
"""
