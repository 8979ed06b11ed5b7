"""The process in which filters run, whose one argument is LOG.

Reads pickled work from standard input, writes pickled rows to standard output and None behind
those of one piece of work. What the filters print goes to standard error. Where a row takes longer
than its time limit the process ends, having written to LOG where it was; so it does on a fatal
signal. A watchdog in C does it: it also ends a filter that hangs in compiled code, and one that
nobody waits for any more.
"""

import faulthandler
import os
import pickle
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from simbench.campaign.rows import Work
from simbench.limits import limited_to


def main() -> None:
    """Serve until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it is interrupted, and ends it
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with Path(sys.argv[1]).open("w", encoding="utf-8") as log, suppress(EOFError, BrokenPipeError):
        faulthandler.enable(log)
        while True:
            work: Work = pickle.load(sys.stdin.buffer)
            faulthandler.dump_traceback_later(work.time_limit_s, exit=True, file=log)
            with limited_to(work.limit_bytes):
                for row in work.rows():
                    faulthandler.cancel_dump_traceback_later()
                    _send(row, answers)
                    faulthandler.dump_traceback_later(work.time_limit_s, exit=True, file=log)
            faulthandler.cancel_dump_traceback_later()
            _send(None, answers)


def _send(answer: object, answers: BinaryIO) -> None:
    pickle.dump(answer, answers)
    answers.flush()
