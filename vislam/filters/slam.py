"""Joint visual-inertial SLAM, the paper's III.C: one covariance over pose and map.

In recorded data the last sighting of a landmark is known. A landmark that will not be seen again
influences nothing that is still to come, so it leaves the joint covariance there: everything that
stays is exactly what the full filter has, and the cost of a frame depends on the landmarks in
sight, not on the size of the map. On a stream, where nobody knows, `Task.retire_after` frames
without a sighting decide; a landmark that is seen again after that starts as a new one, and what
stays is exactly what a full filter has that gives it a new name there.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from vislam.arrays import Array, IntArray
from vislam.charts import RIGHT
from vislam.filters import model
from vislam.filters.backward import Kept, Later, Seen
from vislam.filters.estimate import Estimate
from vislam.filters.gating import Gate
from vislam.filters.inverse_depth import along_inverse_depth
from vislam.filters.layout import MAP, POSE, diagonal_blocks
from vislam.filters.observation import Observation
from vislam.filters.parts import PAPER, Parts
from vislam.filters.records import Augment, Drop, Linear, Record
from vislam.filters.roster import Retired, slots_of
from vislam.filters.tape import Tape
from vislam.gaussian import reuse_freed_memory
from vislam.types import Belief, Frame, Innovation, Smoothed, Task, Twist


class EkfSlam:
    """EKF-SLAM on SE(3) with landmarks in R^3.

    The estimate is `x`; `P` is the covariance of its error (pose, landmarks in the order of `ids`),
    in the chart of `parts`. Every change of `P` is one record of `vislam.filters.records`; who sets
    `records` to a list finds them there.

    Memory: the living landmarks' covariance, and what the backward pass keeps, about 0.1 MB a frame
    at 60 sightings, within `Task.memory_bytes`.
    """

    batched = True

    def __init__(self, task: Task, parts: Parts = PAPER) -> None:
        """Start at the prior.

        A known map with a joint covariance starts in the state. One with a covariance for each
        landmark waits outside, where it costs nothing: a landmark that is independent of the state
        takes part in no update before it is sighted.
        """
        reuse_freed_memory()
        self.calibration, self.noise = task.calibration, task.noise
        if task.inverse_depth:
            parts = along_inverse_depth(parts)
        self.parts = parts
        self._gate = Gate(calibration=task.calibration, probability=task.gate, within=parts.gate)
        self.records: list[Record] | None = None
        self._past = Tape(task.memory_bytes) if task.memory_bytes else None
        self._retire_after, self._smooth = task.retire_after, task.smooth
        self._waiting: dict[int, tuple[Array, Array]] = {}

        prior = task.prior
        T, batch = prior.T_world_imu, prior.T_world_imu.shape[:-2]
        if prior.joint_covariance is not None:
            self.ids, landmarks, P = prior.ids, prior.landmarks, prior.joint_covariance
        else:
            self.ids, landmarks = prior.ids[:0], np.empty((*batch, 0, 3))
            P = np.zeros((6, 6)) if prior.pose_covariance is None else prior.pose_covariance
            for k, i in enumerate(prior.ids.tolist()):
                covariance = prior.landmark_covariances[..., k, :, :]
                self._waiting[i] = prior.landmarks[..., k, :], covariance
        self.x = Estimate.of(T, landmarks, T @ self.calibration.T_imu_cam)
        self._unseen = np.zeros(len(self.ids), np.int64)  # frames since each was sighted
        self._kept = np.zeros(len(self.ids), bool)  # the way back knows of it
        self.P = np.array(np.broadcast_to(P, (*batch, *P.shape[-2:])), float)
        if parts.from_right is not None:
            A = parts.from_right(T, landmarks)
            self.P = Linear(F=A[..., POSE, :], M=A[..., MAP, :]).forward(self.P)

    def predict(self, motion: Twist, dt: float) -> None:
        """Move by the twist, the paper's III.C.2."""
        x, parts = self.x, self.parts
        T_linear, _ = parts.linearise(x)
        T_next = model.moved(x.T, motion, dt)
        Q = parts.process_noise(self.noise, motion, dt)
        N = None if parts.from_right is None else parts.from_right(T_next, x.landmarks)
        self._apply(Linear(F=parts.transition(T_linear, T_next), Q=Q, N=N))
        x.T = x.T_first = T_next

    def update(self, frame: Frame) -> Innovation:
        """Update by the known landmarks, enter new ones, let go of those seen for the last time."""
        usable = self.parts.valid(self.calibration, frame.readings)
        if self._waiting:
            self._admit(frame.ids[usable])
        slots = slots_of(self.ids, frame.ids)
        known, new = usable & (slots >= 0), usable & (slots < 0)
        innovation = self._correct(frame.ids[known], slots[known], frame.readings[..., known, :])
        self._unseen += 1
        self._unseen[slots[known]] = 0
        if new.any():
            self._give_birth(frame.ids[new], frame.readings[..., new, :])
        self._retire(frame.ids[frame.last])
        unusable = np.flatnonzero(~usable)
        if len(unusable):
            unusable = unusable[~model.unseen(frame.there[..., unusable, :])]
        return replace(innovation, born=frame.ids[new], skipped=frame.ids[unusable])

    def belief(self, joint: bool = False) -> Belief:
        """Pose and living landmarks; without the joint covariance in the paper's chart."""
        own = joint or self.parts.from_right is None
        pose, blocks = self.P[..., POSE, POSE], diagonal_blocks(self.P[..., MAP, MAP])
        if not own:
            pose, blocks = self._to_right(self.x).marginals(self.P)
        return Belief(
            T_world_imu=self.x.T.copy(),
            pose_covariance=pose.copy(),
            ids=self.ids.copy(),
            landmarks=self.x.landmarks.copy(),
            landmark_covariances=blocks.copy(),
            joint_covariance=self.P.copy() if joint else None,
            chart=self.parts.chart.name if own else RIGHT.name,
        )

    def finish(self) -> Smoothed:
        """Pose and every landmark there was, by ascending id, as the full filter has them now.

        What later updates say of a landmark that has left, and of a past pose, comes from one pass
        back over the records.
        """
        retired, poses, later = Retired(), [], Later.nothing(self.P)
        for each in reversed(self._past or ()):
            if isinstance(each, Kept):
                belief = self._smoothed(each, *later.smoothed(each.P, each.rows))
                retired.add(each.ids, belief.landmarks, belief.landmark_covariances)
                poses.append(belief.of_pose)
            later = later.before(each)
        final = retired.joined_to(self.belief())
        return Smoothed(final=final, poses=tuple(reversed(poses)) if self._smooth else ())

    def _smoothed(self, kept: Kept, change: Array, P: Array) -> Belief:
        """What was kept, changed by what came later, in the paper's chart."""
        parts = self.parts
        T, landmarks = parts.retract(parts.chart, kept.x, change)
        last = Linear(F=np.eye(6))
        if parts.from_right is not None:
            last = self._to_right(kept.x)
        elif parts.transport is not None:
            last = replace(last, D=parts.transport(kept.x, T, landmarks).D)
        pose, blocks = last.marginals(P)
        return Belief(
            T_world_imu=T,
            pose_covariance=pose,
            ids=kept.ids,
            landmarks=landmarks,
            landmark_covariances=blocks,
        )

    def _to_right(self, x: Estimate) -> Linear:
        """The error in the paper's chart from that in this one."""
        assert self.parts.from_right is not None
        A = self.parts.from_right(x.T, x.landmarks)
        F = np.asarray(np.linalg.inv(A[..., POSE, :]))
        return Linear(F=F, M=-A[..., MAP, :] @ F)

    def _apply(self, record: Linear | Augment | Drop) -> None:
        """Change the covariance, and note it for the way back."""
        self._change(record)
        if self._past is not None:
            self._past.append(record)

    def _change(self, record: Record) -> None:
        """Change the covariance alone: the way back takes a frame's update as one."""
        self.P = self.parts.change(record, self.P)
        if self.records is not None:
            self.records.append(record)

    def _correct(self, ids: IntArray, slots: IntArray, readings: Array) -> Innovation:
        """The paper's III.C.5 over the known landmarks; ids (k,), readings (..., k, c)."""
        x, parts = self.x, self.parts
        predicted = model.predicted(self.calibration, x.T, x.landmarks[..., slots, :])
        residual = readings - predicted
        front = np.flatnonzero(model.finite(residual))
        slots, W = slots[front], parts.whitening(self.noise, predicted[..., front, :])
        white = model.whitened(W, residual[..., front, :])
        observation = self._observation(*parts.linearise(x), slots, W, white)
        passed = self._gate.accepted(observation, self.P, W, white)
        observation = observation.only(passed)
        if parts.iterate is None:
            delta, whitened = self._update_by(observation)
        else:
            sighted = readings[..., front, :]
            first = parts.correct(observation, self.P)
            last = parts.iterate(
                first,
                lambda delta: self._seen_from(delta, slots, W, sighted).only(passed),
                lambda seen: parts.correct(seen, self.P),
            )
            self._change(last)
            observation, delta, whitened = last.observation, last.delta, first.whitened
        if self._past is not None:
            self._past.append(Seen(observation=observation, delta=delta))
        T, landmarks = parts.retract(parts.chart, x, delta)
        if parts.transport is not None and len(observation.slots):
            self._apply(parts.transport(x, T, landmarks))
        x.T, x.landmarks = T, landmarks

        kept = front[passed] if passed.ndim == 1 else front
        all_whitened = np.zeros(readings.shape)
        all_whitened[..., kept, :3] = whitened.reshape(*passed.shape[:-1], -1, 3)
        all_whitened[..., front, 3:] = white[..., 3:] * passed[..., None]
        accepted = np.zeros(readings.shape[:-1], bool)
        accepted[..., front] = passed
        return Innovation(ids=ids, residual=residual, whitened=all_whitened, accepted=accepted)

    def _update_by(self, observation: Observation) -> tuple[Array, Array]:
        """Update the covariance part by part: the same as at once, in fewer operations.

        Each part is an update of the state that the earlier parts left.

        Returns:
            K r of the whole, shape (..., n), and the whitened residual, (..., 3k).
        """
        delta = np.zeros(self.P.shape[:-1])
        whitened: list[Array] = []
        for part in self.parts.split(observation):
            correction = self.parts.correct(part.less(delta) if whitened else part, self.P)
            self._change(correction)
            delta += correction.delta
            whitened.append(correction.whitened)
        return delta, np.concatenate(whitened, axis=-1)

    def _observation(
        self, T: Array, landmarks: Array, slots: IntArray, W: Array, white: Array
    ) -> Observation:
        """What landmarks at `slots` say, linearised at a pose and all landmarks."""
        H_pose, H_map = self.parts.observation_jacobians(
            self.calibration, T, landmarks[..., slots, :]
        )
        rows = W[..., :3, :]
        return Observation(slots=slots, H_pose=rows @ H_pose, H_map=rows @ H_map, r=white[..., :3])

    def _seen_from(self, delta: Array, slots: IntArray, W: Array, readings: Array) -> Observation:
        """Known landmarks seen from where delta leads: z - h(x + delta) + H delta, by delta.

        The transport turns delta into the error about x + delta, so that what cannot be observed
        from the one cannot be from the other.
        """
        parts, x = self.parts, self.x
        T, landmarks = parts.retract(parts.chart, x, delta)
        residual = readings - model.predicted(self.calibration, T, landmarks[..., slots, :])
        seen = self._observation(T, landmarks, slots, W, model.whitened(W, residual))
        if parts.transport is not None:
            A = parts.transport(x, T, landmarks)
            H_pose, H_map = seen.H_pose @ A.F[..., None, :, :], seen.H_map
            if A.M is not None:
                H_pose = H_pose + H_map @ A.M.reshape(*landmarks.shape, 6)[..., slots, :, :]
            if A.D is not None:
                H_map = H_map @ A.D[..., slots, :, :]
            seen = replace(seen, H_pose=H_pose, H_map=H_map)
        return seen.less(-delta)

    def _give_birth(self, ids: IntArray, readings: Array) -> None:
        """Enter new landmarks by their first sighting, at the updated pose."""
        T_linear, _ = self.parts.linearise(self.x)
        born = self.parts.birth(self.calibration, self.noise, self.x.T, T_linear, readings)
        self._enter(ids, *born)

    def _admit(self, ids: IntArray) -> None:
        """Let landmarks of the known map into the state that are sighted for the first time."""
        known = [i for i in ids.tolist() if i in self._waiting]
        if known:
            landmarks, covariances = zip(*(self._waiting.pop(i) for i in known), strict=True)
            points, R = np.stack(landmarks, axis=-2), np.stack(covariances, axis=-3)
            G = np.zeros((*self.x.T.shape[:-2], len(known), 3, 6))
            if self.parts.from_right is not None:
                A = self.parts.from_right(self.x.T, points)
                G = (A[..., MAP, :] @ np.linalg.inv(A[..., POSE, :])).reshape(G.shape)
            self._enter(np.array(known), points, G, R)

    def _enter(self, ids: IntArray, landmarks: Array, G: Array, R: Array) -> None:
        T = self.x.T
        self._apply(Augment(G=G.reshape(*G.shape[:-3], 3 * len(ids), 6), R=R))
        self.ids = np.concatenate([self.ids, ids])
        self.x = self.x.joined_by(Estimate.of(T, landmarks, T @ self.calibration.T_imu_cam))
        self._unseen = np.concatenate([self._unseen, np.zeros(len(ids), np.int64)])
        self._kept = np.concatenate([self._kept, np.zeros(len(ids), bool)])

    def _retire(self, last: IntArray) -> None:
        """Take landmarks that will not be seen again out of the state."""
        leaves = np.zeros(len(self.ids), bool)
        if len(last):
            slots = slots_of(self.ids, last)
            leaves[slots[slots >= 0]] = True
        if self._retire_after is not None:
            leaves |= self._unseen >= self._retire_after
        if self._past is not None and (self._smooth or not self._kept[leaves].all()):
            self._past.append(self._keep())
        if not leaves.any():
            return
        self._apply(Drop.of(self.P.shape[-1], np.flatnonzero(leaves)))
        stays = ~leaves
        self.ids, self._unseen, self._kept = self.ids[stays], self._unseen[stays], self._kept[stays]
        self.x = self.x.of_landmarks(stays)

    def _keep(self) -> Kept:
        """Note the state for the way back, which gives the landmarks that it meets here first.

        Noted where a landmark leaves of which no note has been made: the fewest moments that meet
        every landmark while it lives.
        """
        due = np.flatnonzero(~self._kept)
        self._kept[:] = True
        return Kept(ids=self.ids[due], slots=due, x=self.x.of_landmarks(due), P=self.P.copy())


#: The paper's own start of a landmark: what it is, inconsistent.
slam_constant_prior = partial(EkfSlam, parts=Parts(birth=model.constant_prior))
