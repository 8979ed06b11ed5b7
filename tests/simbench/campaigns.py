"""A small study, and what compares tables of campaigns."""

import csv

STUDY = """\
name: small
scenarios:
  - name: room
    seed: 5
    duration_s: 1.0
    trajectory: {kind: hover, sway_m: [0.3, 0.2, 0.1]}
    landmarks: {kind: box, count: 8, size_m: [4.0, 6.0, 3.0], center_m: [8.0, 0.0, 1.0]}
filters: [slam, dead-reckoning]
runs: 3
sweep: {imu.velocity.sigma: [0.1, 0.2]}
"""

FILTERS = '''\
"""Filters that end in every way; the odd runs are right."""

import ctypes
import os
import time
from pathlib import Path

from vislam.filters import EkfSlam


def even(task):
    """Decided by the data, since a filter is not told the run's number."""
    return int(task.prior.T_world_imu[0, 3] * 1e9) % 2 == 0


class Ends(EkfSlam):
    def __init__(self, task, end=None):
        super().__init__(task)
        self.end = end if even(task) else None

    def predict(self, motion, dt):
        if self.end is not None and motion.time_s >= 0.2:
            self.end()
        super().predict(motion, dt)


def hangs(task):
    return Ends(task, lambda: time.sleep(1000))


def hangs_and_lets_nobody_else_run(task):
    return Ends(task, lambda: ctypes.PyDLL(None).sleep(1000))


def crashes(task):
    return Ends(task, lambda: ctypes.string_at(0))


def exits(task):
    return Ends(task, lambda: os._exit(3))


def raises(task):
    return Ends(task, lambda: 1 / 0)


def counted(task):
    """Leaves a line for each run."""
    with Path("counted").open("a") as file:
        file.write("run\\n")
    print("a filter may print")
    time.sleep(0.05)
    return EkfSlam(task)
'''


def table(out):
    """The rows of a campaign, without what differs between machines."""
    with (out / "results.csv").open(newline="") as file:
        return [
            {name: cell for name, cell in row.items() if not name.startswith("wall_")}
            for row in csv.DictReader(file)
        ]
