"""A stage in a process of its own, beside others that do not take what it makes."""

import logging
import multiprocessing
import os
import signal
import sys
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from softrl.core.errors import SoftrlError, SolverError
from softrl.pipeline import Outcome, run_stage

log = logging.getLogger(__name__)
STOP_S = 10.0  # in which a process that is told to stop writes down that it was


class Aside:
    """One stage that was started; its log goes to a file, ``folder/softrl.log``, and its progress with it."""

    def __init__(self, stage: str, config: Mapping[str, Any], folder: Path, made: Mapping[str, str]) -> None:
        self._stage, self._log, context = stage, folder / "softrl.log", multiprocessing.get_context("spawn")
        self._answer, send = context.Pipe(duplex=False)
        folder.mkdir(parents=True, exist_ok=True)
        self._process = context.Process(target=_work, args=(send, self._log, stage, config, folder, dict(made)))
        self._process.start()
        send.close()
        log.info("%s: started beside what follows; its log is %s", stage, self._log)

    def check(self) -> None:
        """Raise what ended the stage, if it has ended so: what follows need not be waited for."""
        if not self._process.is_alive() and self._process.exitcode != 0:
            self.outcome()

    def outcome(self) -> Outcome:
        """Return what the stage left, once it has ended.

        Raises
        ------
        SoftrlError
            What ended it.
        """
        try:
            found = self._answer.recv()
        except EOFError as lost:
            raise SolverError(f"stage={self._stage} was killed; run the same command again to go on, see {self._log}") from lost
        self._process.join()
        if isinstance(found, BaseException):
            raise found
        return found  # type: ignore[no-any-return]

    def stop(self) -> None:
        """End the stage if it still runs; what it kept it goes on from."""
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(STOP_S)
            self._process.kill()


def _work(
    answer: Connection, file: Path, stage: str, config: Mapping[str, Any], folder: Path, made: Mapping[str, str]
) -> None:
    """Run the stage and send what it left, or the error that ended it.

    No traceback goes from process to process, nor does every error: of one that is no message to the user the log holds all.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is for the process that started this one
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with file.open("a") as own:
        os.dup2(own.fileno(), sys.stdout.fileno())
        os.dup2(own.fileno(), sys.stderr.fileno())
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("softrl").setLevel(logging.INFO)
    try:
        answer.send(run_stage(stage, config, folder, made))
    except SoftrlError as error:
        answer.send(error)
        sys.exit(1)
    except Exception as error:
        log.exception("%s ended", stage)
        answer.send(SolverError(f"stage={stage} ended by {type(error).__name__}: {error}; {file} says where"))
        sys.exit(1)
