"""Further bugs: plainer ones, that a bench catches if it catches anything."""

from types import MappingProxyType

from simbench.bugs.bug import Bug, Trace

_PARTS, _FEED = "simbench.bugs.parts", "simbench.bugs.feed"

FURTHER = MappingProxyType(
    {
        "process-blocks-swapped": Bug(
            what="The blocks of W in (phi, rho) order.",
            source="RossHartley/invariant-ekf 149bee4",
            make=f"{_FEED}:process_blocks_swapped",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 0", block="pose covariance"),
        ),
        "process-sigma-for-variance": Bug(
            what="W is sigma, not sigma squared.",
            source="PX4/PX4-ECL ac71ec5",
            make=f"{_FEED}:process_sigma_for_variance",
            checks=("audit", "nis"),
            audit=Trace(scene="births", call="predict 0", block="pose covariance"),
        ),
        "process-noise-never-added": Bug(
            what="A prediction adds no noise.",
            source="none found",
            make=f"{_PARTS}:process_noise_never_added",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 0", block="pose covariance"),
        ),
        "process-noise-of-ones": Bug(
            what="A variance added to the whole matrix: all noise of a step fully correlated.",
            source="none found",
            make=f"{_FEED}:process_noise_of_ones",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 0", block="pose covariance"),
        ),
        "mean-interval": Bug(
            what="The mean interval for each interval, in motion and noise.",
            source="none found",
            make=f"{_FEED}:MeanInterval",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 1", block="estimate"),
        ),
        "first-order-pose": Bug(
            what="The pose moves by I + tau u^ for exp(tau u^), and leaves SE(3).",
            source="none found",
            make=f"{_FEED}:FirstOrderPose",
            checks=("audit",),
            audit=Trace(scene="births", call="predict 0", block="estimate"),
        ),
        "no-transition": Bug(
            what="F = I: errors do not turn with the body.",
            source="none found",
            make=f"{_PARTS}:no_transition",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space"),
            audit=Trace(
                scene="births",
                call="predict 0",
                block="pose-landmark cross-covariance (landmark of age 1)",
            ),
        ),
        "no-pose-jacobian": Bug(
            what="H_pose = 0: landmarks take all the blame.",
            source="none found",
            make=f"{_PARTS}:no_pose_jacobian",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space", "nis"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "world-point-in-odot": Bug(
            what="H_pose = -d m^odot, m of the world, not of the body: seen far from the origin.",
            source="FASTLIO2_ROS2#43",
            make=f"{_PARTS}:world_point_in_odot",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space"),
            audit=Trace(scene="births", call="update 1", block="pose covariance"),
        ),
        "baseline-of-wrong-sign": Bug(
            what="In the projection's Jacobian the right camera stands on the left.",
            source="rtabmap_ros#1142 (akin)",
            make=f"{_PARTS}:baseline_of_wrong_sign",
            checks=("audit", "jacobian", "nees"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "extrinsics-inverted": Bug(
            what="The camera's pose in the IMU frame is told inverted.",
            source="Kimera-VIO#117",
            make=f"{_FEED}:extrinsics_inverted",
            checks=("audit", "nees", "gate-rate"),
            audit=Trace(scene="births", call="update 0", block="estimate"),
        ),
        "unseen-landmarks-left": Bug(
            what="An update changes the pose and the landmarks in sight, and no other.",
            source="none found",
            make=f"{_PARTS}:unseen_landmarks_left",
            checks=("audit", "covariance-laws", "raises"),
            audit=Trace(
                scene="births",
                call="update 2",
                block="landmark-landmark cross-covariance (ages 2 and 2)",
            ),
        ),
        "first-estimate-of-the-pose-alone": Bug(
            what="First estimates of the pose, present ones of the landmarks.",
            source="rpng/MINS#78",
            make=f"{_PARTS}:first_estimate_of_the_pose_alone",
            base="slam-fej",
            checks=("null-space",),
            blind="without noise the two linearisation points are one: it is of second order",
        ),
    }
)
