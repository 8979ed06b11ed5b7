"""What a failed check usually means, and the command that shows it."""

import shlex

from simbench.checks.conformance import CHECKS, NOT_HUNTED
from simbench.report.saved import HowMade, SavedFinding

#: By the call that an audit names and the start of the block's name; the first that fits.
_AUDIT = (
    (
        "",
        "estimate",
        "The estimate is wrong where nothing is noisy: a frame or its inverse, the lever arm of "
        "the camera, the sign of a correction, or an interval that is not the data's.",
    ),
    ("", "exception", "The filter raises on ordinary data. Its own message comes first."),
    ("start", "", "The filter claims no covariance. Without a claim there is nothing to judge."),
    (
        "predict",
        "pose covariance",
        "The prediction of the pose: F (an adjoint the wrong way round, a sign), or the process "
        "noise (its frame, its unit, its power of the interval).",
    ),
    (
        "predict",
        "pose-landmark",
        "The prediction leaves the cross-covariance behind, or moves it by a wrong F.",
    ),
    ("predict", "", "A prediction changes the map, which stands still."),
    (
        "update",
        "innovation covariance",
        "S = H P H^T + R does not fit: a wrong H, sigma where its square belongs, or noise counted "
        "twice or not at all.",
    ),
    (
        "update",
        "innovation whiteness",
        "Innovations follow from earlier ones: a measurement used twice, a reading of another "
        "time, or a gain that is not the optimal one.",
    ),
    (
        "update",
        "pose-landmark",
        "At age 0 the landmark was born without its correlation with the pose; later, an update "
        "that leaves the cross-covariance as it was.",
    ),
    (
        "update",
        "landmark covariance (age 0)",
        "A landmark is born with a wrong covariance: without the pose's, or without its pixels'.",
    ),
    (
        "update",
        "",
        "The correction of the covariance: a wrong H or gain, noise counted twice, or a state that "
        "is corrected by more or less than the covariance says.",
    ),
    ("", "", "The covariance that is claimed is not that of the errors."),
)

#: By the name of a check of `simbench.checks.conformance`.
_LAWS = {
    "move-the-world": "Something is measured from the world's origin: a frame was mixed up, or an "
    "angle wraps.",
    "rename-the-landmarks": "Ids are used as places in an array, or as an order.",
    "shift-the-clock": "An absolute time is used where an interval belongs, or single precision.",
    "reorder-the-features": "Features are matched by their place in the frame, not by id.",
    "run-twice": "Something is kept from one run to the next, or random numbers are not seeded.",
    "keep-what-was-handed-out": "A belief shares its arrays with the filter, which changes them.",
    "divide-the-frame": "The features of a frame are not fused at one linearisation point.",
    "hide-a-landmark": "A landmark that was never seen reaches the state.",
    "ignore-an-empty-frame": "The -1 of a missing feature is taken for a pixel, or a prediction is "
    "made by the update.",
    "ignore-a-half-missing-feature": "A feature is used as soon as one of its pixels is there.",
    "ignore-what-a-mask-hides": "The pixels of a feature that is skipped still reach the state.",
    "state-covariances": "The covariance is not symmetric or not positive: the short form of the "
    "update in finite precision, or blocks that are updated apart.",
    "find-the-place": "The covariance loses its last digits where very much is learnt at once: use "
    "Joseph's form or a factor.",
    "refuse-as-often-as-told": "The gate has wrong degrees of freedom, or another probability.",
    "jacobians": "A Jacobian is not the derivative of its function: a sign, a side of the "
    "perturbation, a frame.",
    "keep-the-known-map": "The retraction moves landmarks with the pose: right to first order, and "
    "wrong by the square of a turn.",
    "move-by-the-correction": "The retraction is not the inverse of the error whose covariance the "
    "filter states: another side, another chart.",
    "follow-the-records": "The covariance is changed by something that the filter does not show.",
    "null-space": "Jacobians are taken at estimates that disagree, so the filter takes a motion of "
    "the whole world for something it sees.",
    "nullity": "Fewer than six directions stay unobservable: the filter learns where it is from "
    "nothing.",
    "gauge-information": "A call adds information about where the whole world is.",
    "rest-teaches-nothing": "At rest the pose becomes surer by looking at new landmarks.",
    "a-step-teaches-nothing": "A step between sightings makes the pose surer than its start.",
}


def of_audit(first: SavedFinding) -> str:
    """What the first deviation of an audit usually means."""
    return next(
        meaning
        for call, block, meaning in _AUDIT
        if first.call.startswith(call) and first.block.startswith(block)
    )


def of_law(name: str) -> str:
    """What a failure of a check without chance usually means."""
    must = f"It must hold: {CHECKS[name]}." if name in CHECKS else ""
    return " ".join(filter(None, (_LAWS.get(name, ""), must)))


def finding_text(first: SavedFinding) -> str:
    """A finding as the audit prints it."""
    if first.reason or first.claimed is None or first.true is None:
        return f"{first.call} {first.reason or first.block}"
    return f"{first.call}: {first.block}, claimed {first.claimed:.4g}, true {first.true:.4g}"


def show_law(name: str, filter_: str) -> str:
    """The command that shows a failed check, in the smallest scene where one can be found."""
    if name in CHECKS and name not in NOT_HUNTED:
        return command("hunt", "--filter", filter_, "--check", name)
    return shlex.join(["pytest", "--simbench-filter", filter_, "-k", f"simbench and {name}"])


def show_run(made: HowMade, run: int) -> str | None:
    """The command that runs the filter in the scene, and leaves a recording to look at."""
    if made.scenario is None:
        return None
    seed = [] if made.seed is None else ["--seed", str(made.seed)]
    sets = [word for override in made.overrides for word in ("--set", override)]
    filter_ = ["--filter", made.filter]
    return command("run", made.scenario, *filter_, *seed, "--run", str(run), *sets)


def command(*words: str) -> str:
    """A command of simbench, for a shell."""
    return shlex.join(["simbench", *words])


def commands(*each: str | None) -> tuple[str, ...]:
    """Those that there are."""
    return tuple(one for one in each if one is not None)
