"""Visual-inertial localisation and mapping by extended Kalman filters on SE(3).

The estimators of the paper *Visual Inertial SLAM* (IMU localisation by EKF
prediction, landmark mapping by EKF update, joint SLAM), with numpy and scipy
alone.

Conventions, stated once for both packages:

* ``T_a_b`` in SE(3), shape (..., 4, 4), maps coordinates in b to coordinates
  in a: ``p_a = T_a_b @ p_b``, so inner names cancel.
* Frames: ``world`` is x forward at the start, y left, z up. ``imu`` is the
  body, x forward, y left, z up. ``cam`` is the left camera, optical: x right,
  y down, z forward. The right camera stands at +baseline along the left one's x.
* Tangent vectors are (rho, phi), translation first: u = [v; omega].
* The pose error is a right perturbation, T = T_hat exp(xi^), unless a belief
  names another chart (`vislam.charts`).
* A joint covariance has the pose first, then the landmarks in the order of
  their ids. (The paper writes the landmarks first; pose first grows at its end.)
* The twist sample i moves the pose over [t_i, t_i+1); frame i is seen from pose i.
* Pixels are (uL, vL, uR, vR); all four are -1 where a landmark is not seen.
* A point sensor stands in place of the left camera, in its frame; NaN where it sees nothing.
* Metres, seconds, radians, pixels; another unit stands in the name.
* Arrays may carry leading batch axes where a shape is given as (..., n).
"""

__version__ = "0.1.0"
