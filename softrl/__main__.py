"""The door: ``python -m softrl stage=...``."""

import os
import signal
import sys
import textwrap
import threading
from pathlib import Path
from types import FrameType
from typing import NoReturn

# errors of the command line are told in one line here, not by hydra
os.environ.setdefault("HYDRA_FULL_ERROR", "1")

import hydra
import yaml
from hydra.core.config_store import ConfigStore
from hydra.errors import ConfigCompositionException, HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from softrl.core.errors import SoftrlError

HERE = Path(__file__).resolve().parent
NOISE = ("full_key:", "object_type=", "reference_type=", "Config search path", "provider=", "Set the environment")
OWN = "own"  # name of the option that a robot's file is
_mistakes: list[SoftrlError] = []
_stopped: list[int] = []  # signals that asked to stop
_home = os.getpid()  # points of a sweep may run in other processes, which get this number with ``run``
CONF = next(folder for folder in (HERE / "conf", HERE.parent / "conf") if folder.is_dir())

os.environ.setdefault("SOFTRL_HOME", str(CONF.parent))  # experiments/ is searched beside conf/


def _choices() -> str:
    """Return the configuration groups and their options for --help; what begins with _ is a part of other options."""
    groups = sorted(folder for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra")
    options = {g.name: sorted(file.stem for file in g.glob("*.yaml") if not file.stem.startswith("_")) for g in groups}
    lines = [textwrap.fill(f"{name}: {', '.join(found)}", 116, subsequent_indent="  ") for name, found in options.items()]
    return "\n".join(lines).replace("\n", "\n  ")


OmegaConf.register_new_resolver("choices", _choices, replace=True)


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
def run(cfg: DictConfig) -> None:
    """Run the stage that the configuration names, or the whole loop; keep a user's mistake for ``main`` to tell."""
    from softrl.loop import run_configured  # imported late: --help answers at once

    try:
        run_configured(cfg)
    except SoftrlError as mistake:
        if cfg.debug or os.getpid() != _home:
            raise  # from another process Hydra brings it back, after the other points
        _mistakes.append(mistake)  # a sweep goes on with its other points


def main() -> None:
    """Run the command line; a user's mistake is one line and exit status 2."""
    sweep = bool({"-m", "--multirun"} & set(sys.argv[1:]))
    sys.argv[1:] = [word for given in sys.argv[1:] for word in _spell_out(given, sweep)]
    signal.signal(signal.SIGTERM, _stop)
    # a terminal that is closed ends a session at a robot as Ctrl-C does
    for heeded in {signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)}:
        if signal.getsignal(heeded) != signal.SIG_IGN:  # as a job in the background ignores the one, nohup the other
            signal.signal(heeded, _stop)
    sys.unraisablehook = _repeat_interrupt
    error: BaseException | None = None
    try:
        run()
        if _mistakes:
            error = _mistakes[0]
            _leave("; ".join(dict.fromkeys(_one_line(mistake) for mistake in _mistakes)), 2)
    except (KeyboardInterrupt, Exception) as failure:
        error = failure
        # a compiler swallows the interrupt and fails later, of what it did not finish
        if _stopped or isinstance(failure, KeyboardInterrupt):
            _leave("stopped; finished stages are kept, run the same command again to go on", 130)
        if "debug=true" in sys.argv or not isinstance(failure, HydraException | OmegaConfBaseException | SoftrlError):
            raise
        _leave(_one_line(failure), 2)
    finally:
        from softrl.core.sweep import close_parents

        close_parents(error)


def _spell_out(word: str, sweep: bool = False) -> list[str]:
    """Turn what is short for an override of Hydra's own grammar into it.

    ``effect=run:<id>`` stands for two overrides, ``launcher=slurm`` for a key of Hydra's, and ``bench=fem,rom`` for a
    list: with commas alone Hydra takes it for a sweep, which it is in a ``sweep``. ``proof.<key>`` is a key of that
    stage. ``robot=<file>.yaml`` is a robot that may lie anywhere.
    """
    if word.startswith("robot=") and word.endswith((".yaml", ".yml")):
        return [f"robot={_own_robot(Path(word.removeprefix('robot=')).expanduser())}"]
    if word.startswith("effect=run:"):
        return ["effect=identified", f"inputs.diagnosis={word.removeprefix('effect=')}"]
    if word.startswith("launcher="):
        return [f"hydra/{word}"]
    if word.startswith("bench=") and "," in word and "[" not in word and not sweep:
        return [f"bench=[{word.removeprefix('bench=')}]"]
    if word.startswith("proof."):
        return [f"stage.{word.removeprefix('proof.')}"]
    return [word]


def _own_robot(path: Path) -> str:
    """Give Hydra the robot in the file ``path`` as one of its options, and return that option's name."""
    try:
        node = OmegaConf.load(path)
        why = "" if isinstance(node, DictConfig) else "it has no keys"
    except (OSError, yaml.YAMLError) as error:
        why = " ".join(str(error).split())
    if why:
        _leave(f"robot={path} cannot be read ({why}); expected a file such as conf/robot/tripod.yaml", 2)
    ConfigStore.instance().store(name=OWN, group="robot", node=node)
    return OWN


def _one_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, ConfigCompositionException) and lines[0].startswith("Could not override"):
        whole = not any(word.startswith("stage=") and word != "stage=all" for word in sys.argv)
        hint = "a key of one stage needs that stage alone: stage=<name>" if whole else "`--cfg job` prints every key"
        if "'inputs." in lines[0]:
            from softrl.artifacts.makers import inputs_in_words

            hint = f"expected one of {inputs_in_words()}"
        return f"{lines[0].rstrip('.')}: there is no such key; {hint}"
    if "Could not load 'hydra/launcher/submitit" in str(error):
        return "launcher=slurm needs a launcher that is not installed; pip install 'softrl[slurm]'"
    shown = [line for line in lines if not line.startswith((*NOISE, "_"))]
    return " ".join(shown)


def _leave(message: str, status: int) -> NoReturn:
    print(f"softrl: {message}", file=sys.stderr)
    sys.exit(status)


def _stop(number: int, frame: FrameType | None) -> None:
    _stopped.append(number)
    signal.default_int_handler(number, frame)


def _repeat_interrupt(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt again if a destructor or a callback swallowed the interrupt; leave the rest to Python.

    On a busy machine the timer may ring before this is left, where the interrupt would be swallowed too. A signal, unlike
    a mere mark, also wakes a main thread that sleeps or waits.
    """
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
        return
    while True:
        try:
            threading.Timer(0.1, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()
            return
        except KeyboardInterrupt:
            continue


if __name__ == "__main__":
    main()
