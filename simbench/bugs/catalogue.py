"""The bugs that a bench should catch, most telling first, and two controls that must survive.

A table of strings: it imports none of what it names.
"""

from types import MappingProxyType

from simbench.bugs.bug import Bug, Trace

_PARTS, _FEED = "simbench.bugs.parts", "simbench.bugs.feed"

CATALOGUE = MappingProxyType(
    {
        "birth-without-cross-covariance": Bug(
            what="A new landmark enters with a covariance of its own, uncorrelated with the rest.",
            source="RossHartley/invariant-ekf 15f1ee7 (akin); seen in courses",
            make=f"{_PARTS}:birth_without_cross_covariance",
            checks=("audit", "nees", "landmark-nees"),
            audit=Trace(
                scene="births",
                call="update 0",
                block="pose-landmark cross-covariance (landmark of age 0)",
            ),
        ),
        "first-estimates-in-h-alone": Bug(
            what="First estimates in H, but F from the posterior pose.",
            source="rpng/open_vins#39 (discussion)",
            make=f"{_FEED}:TransitionFromPosterior",
            base="slam-fej",
            checks=("null-space",),
            blind="without noise the two linearisation points are one: it is of second order",
        ),
        "pixel-sigma-for-variance": Bug(
            what="R is sigma, not sigma squared.",
            source="PX4/PX4-ECL 2df2ded, unmannedlab/ekf_cal 5efe42b",
            make=f"{_FEED}:pixel_sigma_for_variance",
            checks=("audit", "nis"),
            audit=Trace(scene="births", call="update 0", block="landmark covariance (age 0)"),
        ),
        "birth-without-pose-uncertainty": Bug(
            what="A new landmark has its pixels' covariance J R J^T, as if the pose were known.",
            source="none found",
            make=f"{_PARTS}:birth_without_pose_uncertainty",
            checks=("audit", "nees", "landmark-nees"),
            audit=Trace(scene="births", call="update 0", block="landmark covariance (age 0)"),
        ),
        "jacobian-without-lever-arm": Bug(
            what="H_pose = -d (T^-1 m - t_imu_cam)^odot, which leaves the lever arm out.",
            source="KumarRobotics/msckf_vio#115, KumarRobotics/msckf_vio#116",
            make=f"{_PARTS}:jacobian_without_lever_arm",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space"),
            audit=Trace(scene="births", call="update 1", block="pose covariance"),
        ),
        "swapped-twist-in-adjoint": Bug(
            what="(omega, v) for (v, omega) in the adjoint of F.",
            source="pvangoor/pylie#1, rail-berkeley/hil-serl#36",
            make=f"{_PARTS}:swapped_twist_in_adjoint",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space", "nees"),
            audit=Trace(
                scene="births",
                call="predict 0",
                block="pose-landmark cross-covariance (landmark of age 1)",
            ),
        ),
        "input-of-another-interval": Bug(
            what="The twist moves the pose over the interval next to its own.",
            source="seen in courses",
            make=f"{_FEED}:InputOfAnotherInterval",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 1", block="estimate"),
        ),
        "posterior-pose-covariance-not-stored": Bug(
            what="After an update the pose keeps its old covariance.",
            source="alirezaahmadi/KalmanFilter-Vehicle-GNSS-INS#2",
            make=f"{_PARTS}:posterior_pose_covariance_not_stored",
            checks=("audit", "nees"),
            audit=Trace(scene="births", call="update 1", block="pose covariance"),
        ),
        "gate-of-wrong-dof": Bug(
            what="The gate's threshold is that of 2 degrees of freedom, for a residual of 4.",
            source="KumarRobotics/msckf_vio#58, rlabbe/filterpy#155",
            make=f"{_PARTS}:gate_of_wrong_dof",
            checks=("gate-rate",),
            blind="the audit's noise is small, so that gates stay open",
        ),
        "process-noise-by-dt-squared": Bug(
            what="W tau^2 where it is W tau: the process noise has one factor of dt too many.",
            source="Mayitzin/ahrs#97, cra-ros-pkg/robot_localization#881",
            make=f"{_PARTS}:process_noise_by_dt_squared",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="predict 0", block="pose covariance"),
        ),
        "pixel-noise-twice": Bug(
            what="The filter adds noise to pixels that have theirs already.",
            source="seen in courses",
            make=f"{_FEED}:PixelNoiseTwice",
            checks=("audit", "nis"),
            audit=Trace(scene="births", call="update 0", block="estimate"),
        ),
        "birth-fused-again": Bug(
            what="The pixels that made a landmark update it in the same frame.",
            source="seen in courses",
            make=f"{_FEED}:BirthFusedAgain",
            checks=("audit", "nees"),
            audit=Trace(scene="births", call="update 0", block="landmark covariance (age 0)"),
        ),
        "process-noise-of-mean-interval": Bug(
            what="Process noise tuned to the mean interval, while intervals jitter.",
            source="borglab/gtsam#2315 (convention)",
            make=f"{_FEED}:process_noise_of_mean_interval",
            checks=("audit", "nis-vs-dt"),
            audit=Trace(scene="births", call="predict 1", block="pose covariance"),
        ),
        "fused-twice": Bug(
            what="One measurement updates the state twice.",
            source="rpng/open_vins#275",
            make=f"{_FEED}:FusedTwice",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "covariance-never-symmetrised": Bug(
            what="(I - K H) P multiplied out, and never symmetrised: shows in a vague start.",
            source="zauberzeug/feldfreund_devkit#47, decargroup/navlie 1e79363",
            make=f"{_PARTS}:covariance_never_symmetrised",
            checks=("covariance-laws",),
            blind="the formula is right; only rounding differs",
        ),
        "pose-and-map-as-two-filters": Bug(
            what="Two uncorrelated filters, of pose and map, take the same innovation.",
            source="PetWorm/LARVIO#6 (remark); seen in courses",
            make=f"{_PARTS}:pose_and_map_as_two_filters",
            checks=("audit", "nees"),
            audit=Trace(
                scene="births",
                call="update 0",
                block="pose-landmark cross-covariance (landmark of age 0)",
            ),
        ),
        "cross-covariance-not-propagated": Bug(
            what="A prediction moves the pose's covariance, and not what it shares with the map.",
            source="AtsushiSakai/PythonRobotics#972, AtsushiSakai/PythonRobotics#973, "
            "unmannedlab/ekf_cal 300471e",
            make=f"{_PARTS}:cross_covariance_not_propagated",
            checks=("audit",),
            audit=Trace(
                scene="births",
                call="predict 0",
                block="pose-landmark cross-covariance (landmark of age 1)",
            ),
        ),
        "adjoint-of-wrong-sign": Bug(
            what="F = exp(+tau u check) for exp(-tau u check).",
            source="colmap/colmap#3155, microsoft/lamar-benchmark#84",
            make=f"{_PARTS}:adjoint_of_wrong_sign",
            base="slam-fej",
            checks=("audit", "jacobian", "null-space", "nees"),
            audit=Trace(
                scene="births",
                call="predict 0",
                block="pose-landmark cross-covariance (landmark of age 1)",
            ),
        ),
        "fancy-index-write-into-a-copy": Bug(
            what="P[rows][:, rows] = ... leaves the block of the landmarks in sight as it was.",
            source="seen in courses",
            make=f"{_PARTS}:fancy_index_write_into_a_copy",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "mask-of-residual-alone": Bug(
            what="What is not seen has residual zero, but its H: the covariance still shrinks.",
            source="seen in courses",
            make=f"{_FEED}:MaskOfResidualAlone",
            checks=("audit", "masking", "nees", "nis"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "missing-pixels-taken-as-pixels": Bug(
            what="-1 is taken for a pixel where only some of a feature is missing: any for all.",
            source="seen in courses",
            make=f"{_PARTS}:missing_pixels_taken_as_pixels",
            checks=("audit", "masking", "raises"),
            audit=Trace(scene="births", call="update 2", block="innovation covariance"),
        ),
        "features-of-another-frame": Bug(
            what="Features meet the pose of the next frame.",
            source="seen in courses",
            make=f"{_FEED}:FeaturesOfAnotherFrame",
            checks=("audit", "nees", "nis"),
            audit=Trace(scene="births", call="update 1", block="estimate"),
        ),
        "left-retraction": Bug(
            what="The update is exp(d) T, with the H of T exp(d).",
            source="bitcraze/crazyflie-firmware#1531, decargroup/navlie 0b838f1",
            make=f"{_PARTS}:left_retraction",
            checks=("audit", "retraction", "nees"),
            audit=Trace(scene="additive", call="update 1", block="pose covariance"),
        ),
        "jacobian-without-division-by-depth": Bug(
            what="The projection's Jacobian lacks its factor 1 / z.",
            source="seen in courses",
            make=f"{_PARTS}:jacobian_without_division_by_depth",
            checks=("audit", "jacobian", "nees", "whiteness"),
            audit=Trace(scene="births", call="update 1", block="landmark covariance (age 1)"),
        ),
        "landmarks-moved-with-the-pose": Bug(
            what="An invariant filter's landmark goes to Exp(theta) (f + zeta) + p, as the pose.",
            source="none found; akin to the divergence of Zhang et al., RA-L 2(2), 2017",
            make=f"{_PARTS}:landmarks_moved_with_the_pose",
            base="slam-invariant",
            checks=("retraction",),
            blind="the retraction is right to first order, and without noise nothing is corrected",
        ),
        "control-adjoint-4x4": Bug(
            what="The adjoint's exponential by the formula of 4x4 matrices: without its last term.",
            source="a control",
            make=f"{_PARTS}:adjoint_by_the_4x4_formula",
            checks=(),
            blind="off by 2e-5 of a standard deviation, which is below every tolerance",
        ),
        "control-reset": Bug(
            what="The covariance carried through the right Jacobian of each correction, or not.",
            source="a control: borglab/gtsam#2373",
            make=f"{_PARTS}:reset_by_right_jacobian",
            checks=(),
            blind="without noise there is no correction: it is of second order",
        ),
    }
)
