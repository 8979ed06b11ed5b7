"""The names of what a scene can hold, with a line on each.

Apart from the models, so that a command that only lists them loads nothing.
"""

TRAJECTORIES = {
    "hover": "stays about a point: a slow sway of position and heading",
    "straight": "straight ahead at constant speed",
    "circle": "a level circle to the left, at constant speed",
    "figure8": "a level figure of eight that starts where it crosses itself",
    "helix": "a circle that climbs evenly",
    "waypoints": "through given points, in time, by a spline with continuous acceleration",
    "random": "smooth and bounded: sums of sinusoids with seeded phases",
    "file": "a recorded trajectory: a TUM file, through a spline",
}

LANDMARKS = {
    "box": "evenly in a box along the world's axes",
    "shell": "evenly between two spheres",
    "walls": "on two upright walls along the path: a corridor",
    "ground": "on level ground under the path and around it",
    "path": "beside the path, on both sides, and ahead of its end",
    "file": "given positions: a text file of x y z, or a .npy array",
}
