"""Random numbers by name: a stream depends on what it is for, never on the order of calls."""

import hashlib

import numpy as np


def stream(seed: int, run: int, *name: str | int) -> np.random.Generator:
    """The generator of one purpose.

    Streams of different seeds, runs or names are independent; equal ones are equal on every
    machine. ``stream(seed, run, "camera.noise", frame)``: adding a draw elsewhere changes nothing
    here.

    Args:
        seed: of the scenario.
        run: the run number.
        name: what it is for; numbers may follow a name.
    """
    words = hashlib.sha256("/".join(map(str, (seed, run, *name))).encode()).digest()
    return np.random.Generator(np.random.PCG64(np.frombuffer(words, np.uint32).tolist()))
