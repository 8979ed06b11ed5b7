"""Bugs in a formula: the production filter with one of its parts replaced.

Each name of the catalogue is a function of (task, parts) that makes the filter of these parts with
the bug in it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from vislam import camera
from vislam.arrays import Array, BoolArray
from vislam.charts import LEFT, RIGHT, Chart
from vislam.filters import model
from vislam.filters.estimate import Estimate
from vislam.filters.layout import MAP, POSE, rows_of
from vislam.filters.observation import Observation
from vislam.filters.parts import Parts
from vislam.filters.records import Augment, Correct, Linear, Record
from vislam.filters.slam import EkfSlam
from vislam.gaussian import gate_threshold, subtract_gram, transposed
from vislam.lie import se3, so3
from vislam.lie.series import polynomial
from vislam.types import Calibration, Noise, Task, Twist

Make: TypeAlias = Callable[[Task, Parts], EkfSlam]


def replacing(**bugs: Any) -> Make:
    """The filter with some fields of its parts replaced."""

    def make(task: Task, parts: Parts) -> EkfSlam:
        return EkfSlam(task, replace(parts, **bugs))

    return make


# Prediction


def _transition_of_swapped_twist(T: Array, T_next: Array) -> Array:
    xi = se3.log(se3.inverse(T) @ T_next)
    return se3.adjoint(se3.exp(-np.roll(xi, 3, axis=-1)))


def _transition_of_wrong_sign(T: Array, T_next: Array) -> Array:
    return se3.adjoint(se3.inverse(T) @ T_next)


def _no_transition(_: Array, T_next: Array) -> Array:
    return np.broadcast_to(np.eye(6), (*T_next.shape[:-2], 6, 6))


def _transition_by_the_4x4_formula(T: Array, T_next: Array) -> Array:
    """I + X + c2 X^2 + c3 X^3: exact for X = u^, for X = u check but for a term in X^4."""
    xi = se3.log(se3.inverse(T_next) @ T)
    _, _, c2, c3 = so3.coefficients(xi[..., 3:], 3)
    return polynomial(se3.ad(xi), 1, 1, c2, c3)


def _process_noise_by_dt_once_too_often(noise: Noise, motion: Twist, dt: float) -> Array:
    return dt * model.process_noise(noise, motion, dt)


def _no_process_noise(noise: Noise, motion: Twist, dt: float) -> Array:
    return np.zeros_like(model.process_noise(noise, motion, dt))


swapped_twist_in_adjoint = replacing(transition=_transition_of_swapped_twist)
adjoint_of_wrong_sign = replacing(transition=_transition_of_wrong_sign)
no_transition = replacing(transition=_no_transition)
adjoint_by_the_4x4_formula = replacing(transition=_transition_by_the_4x4_formula)
process_noise_by_dt_squared = replacing(process_noise=_process_noise_by_dt_once_too_often)
process_noise_never_added = replacing(process_noise=_no_process_noise)


# Observation

Jacobians: TypeAlias = tuple[Array, Array]


def _without_lever_arm(calibration: Calibration, T: Array, landmarks: Array) -> Jacobians:
    H_pose, H_map = model.observation_jacobians(calibration, T, landmarks)
    s = model.to_imu(T, landmarks) - calibration.T_imu_cam[:3, 3]
    return H_pose[..., :3] @ se3.odot(s), H_map


def _world_point_in_odot(calibration: Calibration, T: Array, landmarks: Array) -> Jacobians:
    H_pose, H_map = model.observation_jacobians(calibration, T, landmarks)
    return H_pose[..., :3] @ se3.odot(landmarks), H_map


def _no_pose_jacobian(calibration: Calibration, T: Array, landmarks: Array) -> Jacobians:
    H_pose, H_map = model.observation_jacobians(calibration, T, landmarks)
    return np.zeros_like(H_pose), H_map


def _without_division_by_depth(calibration: Calibration, T: Array, landmarks: Array) -> Jacobians:
    H_pose, H_map = model.observation_jacobians(calibration, T, landmarks)
    z = model.to_cam(calibration, model.to_imu(T, landmarks))[..., 2, None, None]
    return z * H_pose, z * H_map


def _baseline_of_wrong_sign(calibration: Calibration, T: Array, landmarks: Array) -> Jacobians:
    s, rig = model.to_imu(T, landmarks), calibration.stereo
    q = model.to_cam(calibration, s)
    d_pixel_d_q = camera.d_project_d_point(rig, q)
    d_pixel_d_q[..., 2, 2] = -rig.fx_px * (q[..., 0] + rig.baseline_m) / q[..., 2] ** 2
    d_pixel_d_s = d_pixel_d_q @ so3.inverse(calibration.T_imu_cam[:3, :3])
    return -d_pixel_d_s @ se3.odot(s), d_pixel_d_s @ so3.inverse(T[..., None, :3, :3])


def _any_for_all(calibration: Calibration, pixels: Array) -> BoolArray:
    """A feature is there if any of its coordinates is."""
    found = camera.validity(calibration.stereo, pixels)
    usable: BoolArray = np.isin(found, (camera.Validity.VALID, camera.Validity.PARTIAL))
    return np.asarray(usable.all(axis=tuple(range(usable.ndim - 1))))


def _gate_of_two_dof(distance_squared: Array, probability: float, _: int) -> BoolArray:
    return distance_squared <= gate_threshold(probability, 2)


def _pose_first_map_now(x: Estimate) -> tuple[Array, Array]:
    return x.T_first, x.landmarks


jacobian_without_lever_arm = replacing(observation_jacobians=_without_lever_arm)
world_point_in_odot = replacing(observation_jacobians=_world_point_in_odot)
no_pose_jacobian = replacing(observation_jacobians=_no_pose_jacobian)
jacobian_without_division_by_depth = replacing(observation_jacobians=_without_division_by_depth)
baseline_of_wrong_sign = replacing(observation_jacobians=_baseline_of_wrong_sign)
missing_pixels_taken_as_pixels = replacing(valid=_any_for_all)
gate_of_wrong_dof = replacing(gate=_gate_of_two_dof)
first_estimate_of_the_pose_alone = replacing(linearise=_pose_first_map_now)


# Update


def _at_once(observation: Observation) -> tuple[Observation, ...]:
    """For a mistake about what is not seen in a frame, of which a part would see less."""
    return (observation,)


def _pose_block_kept(record: Record, P: Array) -> Array:
    P_next = record.forward(P)
    if isinstance(record, Correct):
        P_next[..., POSE, POSE] = P[..., POSE, POSE]
    return P_next


def _seen_block_kept(record: Record, P: Array) -> Array:
    """`P[rows][:, rows] = ...` writes into a copy."""
    P_next = record.forward(P)
    if isinstance(record, Correct):
        rows = rows_of(record.observation.slots).ravel()
        P_next[..., rows[:, None], rows] = P[..., rows[:, None], rows]
    return P_next


def _never_symmetrised(record: Record, P: Array) -> Array:
    """(I - K H) P, with the product K H multiplied out."""
    if not isinstance(record, Correct):
        return record.forward(P)
    seen, H = record.observation, np.zeros_like(record.Y_T)
    for k, slot in enumerate(seen.slots.tolist()):
        rows = slice(3 * k, 3 * k + 3)
        H[..., rows, POSE] = seen.H_pose[..., k, :, :]
        H[..., rows, 6 + 3 * slot : 9 + 3 * slot] = seen.H_map[..., k, :, :]
    K = transposed(np.asarray(np.linalg.solve(transposed(record.L), record.Y_T)))
    return np.asarray((np.eye(P.shape[-1]) - K @ H) @ P)


def _reset_by_right_jacobian(
    x: Estimate,
    T_next: Array,
    landmarks_next: Array,  # noqa: ARG001
) -> Linear:
    return Linear(F=se3.right_jacobian(se3.log(se3.inverse(x.T) @ T_next)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _TwoCorrections(Correct):
    """One correction of the pose, and another of the map, by the same residual."""

    of_map: Correct

    def forward(self, P: Array) -> Array:
        return self.of_map.onto(subtract_gram(P.copy(), self.Y_T))

    @property
    def delta(self) -> Array:
        of_pose = (transposed(self.Y_T) @ self.whitened[..., None])[..., 0]
        return of_pose + self.of_map.delta


def _pose_and_map_apart(observation: Observation, P: Array) -> Correct:
    HP = observation.of_state(P)
    HP_pose, HP_map = HP.copy(), HP.copy()
    HP_pose[..., MAP], HP_map[..., POSE] = 0, 0
    pose, of_map = (
        Correct.of_products(observation, part, observation.innovation_covariance(part))
        for part in (HP_pose, HP_map)
    )
    return _TwoCorrections(
        observation=observation,
        L=pose.L,
        whitened=pose.whitened,
        Y_T=pose.Y_T,
        of_map=of_map,
    )


def _unseen_landmarks_left(observation: Observation, P: Array) -> Correct:
    HP = observation.of_state(P)
    S = observation.innovation_covariance(HP)
    unseen = np.ones(P.shape[-1], bool)
    unseen[POSE] = unseen[rows_of(observation.slots)] = False
    HP[..., unseen] = 0
    return Correct.of_products(observation, HP, S)


posterior_pose_covariance_not_stored = replacing(change=_pose_block_kept)
fancy_index_write_into_a_copy = replacing(change=_seen_block_kept, split=_at_once)
covariance_never_symmetrised = replacing(change=_never_symmetrised)
unseen_landmarks_left = replacing(correct=_unseen_landmarks_left, split=_at_once)


def _landmarks_moved_with_the_pose(chart: Chart, x: Estimate, delta: Array) -> tuple[Array, Array]:
    """Exp(theta) (f + zeta) + p, zeta = xi_f - rho: exp(xi) of a landmark that moved before."""
    T, _ = chart.retract(x.T, x.landmarks, delta)
    zeta = delta[..., MAP].reshape(x.landmarks.shape) - delta[..., None, :3]
    return T, se3.apply(se3.exp(delta[..., POSE]), x.landmarks + zeta)


landmarks_moved_with_the_pose = replacing(retract=_landmarks_moved_with_the_pose)
left_retraction = replacing(chart=Chart(RIGHT.name, RIGHT.error, LEFT.retract))
reset_by_right_jacobian = replacing(transport=_reset_by_right_jacobian)


# Birth, and what it correlates


def _without_pose(
    calibration: Calibration, noise: Noise, T: Array, T_linear: Array, pixels: Array
) -> tuple[Array, Array, Array]:
    landmarks, G, R = model.inverse_observation(calibration, noise, T, T_linear, pixels)
    return landmarks, np.zeros_like(G), R


def _born_uncorrelated(record: Record, P: Array) -> Array:
    P_next = record.forward(P)
    if isinstance(record, Augment):
        n = P.shape[-1]
        P_next[..., n:, :n], P_next[..., :n, n:] = 0, 0
    return P_next


def _cross_covariance_left(record: Record, P: Array) -> Array:
    P_next = record.forward(P)
    if isinstance(record, Linear):
        P_next[..., POSE, MAP], P_next[..., MAP, POSE] = P[..., POSE, MAP], P[..., MAP, POSE]
    return P_next


birth_without_pose_uncertainty = replacing(birth=_without_pose)
birth_without_cross_covariance = replacing(change=_born_uncorrelated)
cross_covariance_not_propagated = replacing(change=_cross_covariance_left)
pose_and_map_as_two_filters = replacing(
    change=_born_uncorrelated, correct=_pose_and_map_apart, split=_at_once
)
