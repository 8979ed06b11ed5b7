"""What the library and the command line take where nothing is said; it imports nothing."""

#: Independent runs of a scene, and the probability that a right filter fails their verdict.
RUNS, FALSE_ALARM = 20, 0.01
#: Of noise, in the leading frames of a given scene that are audited: seconds. Time grows with the
#: square, to minutes at 2000.
MOST_SCALARS = 500
