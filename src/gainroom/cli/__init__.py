"""The command line: one file per command, each parse, call, show. Heavy imports wait until a command runs.

Even the light ones wait until signals are heeded and standard streams are open.
"""

import ctypes
import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress

from .interrupts import INTERRUPTED, Stopped, leave_quietly, leave_when_asked
from .streams import give_up, open_closed, say, show_everything

# Our matrices are small: on a busy machine, threads inside the linear algebra make each of them a hundred times slower.
# Read when numpy loads, so it is set before; a value of the user's own stays.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# pydantic would look through every installed package for plug-ins, which takes as long as a joint's margins.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Parameters of glibc's malloc.h."""
RETAINED_BYTES = 1 << 25
"""Size of freed memory that is not returned to the system [bytes]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `gainroom` with `arguments` and return the exit status.

    Without `arguments` it takes the process's own, and the process for its own: signals end it in one line, and what nobody foresaw is not
    status 1, which says "unstable".
    """
    if arguments is not None:
        return _run(arguments)
    leave_when_asked()
    open_closed()
    gc.set_threshold(200_000)  # modules and schemas are no garbage: looking for it every 700 objects takes a tenth of a short command
    # Threads of a search take and free large arrays: with a heap for each, what one has freed another does not get, which is a quarter of
    # the memory of a humanoid's study. What goes back to the system is cleared before it comes again. Only glibc knows these settings.
    with suppress(OSError, AttributeError, TypeError):
        for setting, value in ((M_ARENA_MAX, 1), (M_MMAP_THRESHOLD, RETAINED_BYTES), (M_TRIM_THRESHOLD, 2 * RETAINED_BYTES)):
            ctypes.CDLL(None).mallopt(setting, value)
    from ..design.parallel import own_process

    try:
        with own_process():
            return _run(None)
    except Exception as error:  # noqa: BLE001 - a fault of the program, reported in full
        sys.excepthook(type(error), error, error.__traceback__)
        return 2
    finally:
        leave_quietly()
        gc.freeze()  # or Python looks for garbage in all that it holds before it ends, which takes a twentieth of a short command


def _run(arguments: Sequence[str] | None) -> int:
    import typer

    from ..io.run_files import forget_read
    from .front import command
    from .listed import with_lists
    from .progress import followed

    show_everything()
    forget_read()
    try:
        with warnings.catch_warnings(), followed():
            # numpy's remarks about overflow say nothing to a user; what is not finite in a result is shown as such
            warnings.simplefilter("ignore", RuntimeWarning)
            status = command()(arguments, prog_name="gainroom", standalone_mode=False) or 0
        if status == 128 + signal.SIGINT:  # what typer makes of a KeyboardInterrupt
            say(INTERRUPTED)
        return status
    except Stopped as stop:
        say(str(stop))
        return stop.status
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)  # of the command that was called wrongly, where it was found
        message, missing = error.format_message(), type(error).__name__ == "MissingParameter"
        if missing and (text := getattr(getattr(error, "param", None), "help", None)):  # what it is, so that nobody has to look it up
            message = f"{message.rstrip('.')}: {with_lists(text).rstrip('.')}"
        names = getattr(getattr(context, "command", None), "commands", None) if message.startswith("No such command") else None
        if names and context is not None:
            message = f"{message.rstrip('.')}; commands: {', '.join(names)}"
        return _complain(f"{message} (see {'gainroom' if context is None else context.command_path} --help)")
    except typer.Abort as error:  # what typer makes of an EOFError, wherever that came from
        raise error.__cause__ or error from None
    except SystemExit:  # typer's way out where the reader of a help text has left
        give_up(sys.__stdout__ or sys.stdout)
        return 0
    except MemoryError:
        return _complain("not enough memory")
    except OSError as error:
        if error.filename is None:  # a help text, which typer prints by itself
            give_up(sys.stdout)
        return _complain(f"{error.filename or 'standard output'}: {(error.strerror or str(error)).lower()}")
    except ValueError as error:
        from ..errors import GainroomError

        if not isinstance(error, GainroomError):
            raise
        return _complain(*error.problems)


def _complain(*problems: str) -> int:
    """Prints a line for each problem, up to a maximum; returns the exit status."""
    from ..errors import printable, shown_problems

    for text in shown_problems(problems):
        say(f"gainroom: error: {printable(text).strip()}")
    return 2
