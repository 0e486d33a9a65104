"""Hides what Windows (and partly macOS) lacks, in a process of its own, then imports and runs.

Libraries are imported before, as their versions for other systems need none of it.
"""

import contextlib
import importlib
import os
import pkgutil
import signal
import socket
import sys
from types import ModuleType

MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty", "_posixshmem")
# fmt: off
SIGNALS = (
    "SIGALRM", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGSTOP",
    "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGUSR1", "SIGUSR2", "SIGWINCH", "alarm", "pause",
    "pthread_kill", "pthread_sigmask", "setitimer", "getitimer", "sigpending", "sigtimedwait",
    "sigwait", "sigwaitinfo", "siginterrupt",
)
SYSTEM = (
    "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "chown", "fchmod",
    "fchown", "fork", "forkpty", "getegid", "geteuid", "getgid", "getgroups", "getloadavg",
    "getpgid", "getpgrp", "getpriority", "getsid", "getuid", "killpg", "lchown", "mkfifo",
    "nice", "openpty", "posix_fadvise", "posix_fallocate", "pread", "pwrite",
    "sched_setaffinity", "sched_setscheduler", "sched_yield", "setpgid", "setpgrp",
    "setpriority", "setsid", "statvfs", "sync", "tcgetpgrp", "tcsetpgrp", "ttyname", "uname",
    "wait", "wait3", "wait4", "waitid",
)
# fmt: on
SOCKETS = ("AF_CAN", "AF_UNIX", "CAN_RAW", "PF_CAN", "socketpair")
# fmt: off
LIBRARIES = (
    "can", "canopen", "cantools", "click", "cmaes", "jinja2", "lz4.frame", "matplotlib.figure",
    "mcap.reader", "mcap.writer", "numba", "numpy", "pyarrow.parquet", "pydantic", "scipy.io",
    "scipy.optimize", "scipy.signal", "scipy.stats", "serial", "tqdm", "yaml", "asyncio",
    "subprocess", "tempfile", "concurrent.futures", "multiprocessing",
    "matplotlib.backends.backend_agg", "can.interfaces.virtual", "zstandard", "pathlib",
)
# fmt: on


def hide() -> None:
    """Hide modules, signals and functions."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for module, names in ((signal, SIGNALS), (os, SYSTEM), (socket, SOCKETS)):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)


def import_all() -> None:
    """Import every module of the packages; prints those that fail."""
    count = 0
    for package in ("drivers", "identification", "rig"):
        root = importlib.import_module(package)
        count += 1
        for item in pkgutil.walk_packages(root.__path__, f"{package}."):
            try:
                _imported(item.name)
            except Exception as error:  # noqa: BLE001 - all of them are listed
                print(f"{item.name}: {type(error).__name__}: {error}")
            count += 1
    print(f"{count} modules")


def _imported(name: str) -> ModuleType:
    return importlib.import_module(name)


def main() -> None:
    """Hide, import everything, then run the command lines that stand in standard input."""
    hide()
    import_all()
    from identification.plots import style
    from rig.cli.entry import status

    # What draws is a library, which needs none of it.
    style.png = lambda made, dpi=110: b""

    for line in sys.stdin:
        print(f"{line.strip()}: {status(line.split())}", flush=True)


if __name__ == "__main__":
    main()
