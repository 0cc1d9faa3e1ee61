"""An interrupt stops the command even where it falls into code that swallows exceptions."""

import subprocess
import sys

SWALLOWED = """
import _thread, signal, sys, time
from softrl.__main__ import _repeat_interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it, and so do their children
sys.unraisablehook = _repeat_interrupt

class Part:
    def __del__(self):
        _thread.interrupt_main()
        time.sleep(0.05)

try:
    Part()
    time.sleep(20.0)
except KeyboardInterrupt:
    print("stopped")
"""


def test_an_interrupt_that_a_destructor_swallows_comes_again() -> None:
    done = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout.strip() == "stopped" and "Exception ignored" not in done.stderr


# the timer's thread is up, and rings, before whoever started it goes on
LATE = """
import threading, time
first, start = [True], threading.Timer.start

def late(timer):
    start(timer)
    if first.pop() if first else False:
        time.sleep(0.5)

threading.Timer.start = late
"""


def test_an_interrupt_that_comes_while_it_is_repeated_comes_again() -> None:
    done = subprocess.run([sys.executable, "-c", LATE + SWALLOWED], capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout.strip() == "stopped" and "Exception ignored" not in done.stderr


WAITS = """
import os, signal, sys, time
signal.signal(signal.SIGHUP, signal.SIG_IGN if sys.argv[1] == "nohup" else signal.SIG_DFL)  # tests may run behind nohup, too
from softrl import __main__ as door

def work():
    try:
        os.kill(os.getpid(), signal.SIGHUP)
        time.sleep(0.5)
    finally:
        print("left in order", flush=True)

door.run = work
door.main()
"""


def test_a_closed_terminal_stops_in_order_unless_it_is_to_be_survived() -> None:
    def run(how: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", WAITS, how], capture_output=True, text=True, check=False, timeout=60
        )

    closed, survived = run("closed"), run("nohup")
    assert (closed.returncode, closed.stdout) == (130, "left in order\n"), closed.stderr
    assert (survived.returncode, survived.stdout) == (0, "left in order\n"), survived.stderr


FAILS_LATER = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from softrl import __main__ as door

def swallow():
    try:
        if sys.argv[1:]:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(20.0)
    except KeyboardInterrupt:
        pass
    raise RuntimeError("no compiled object yet")

door.run = swallow
door.main()
"""


def test_a_failure_that_an_interrupt_causes_is_told_as_a_stop() -> None:
    command = [sys.executable, "-c", FAILS_LATER]
    done = subprocess.run([*command, "interrupt"], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 130 and done.stderr.startswith("softrl: stopped") and "Traceback" not in done.stderr
    failed = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert failed.returncode == 1 and "RuntimeError: no compiled object yet" in failed.stderr
