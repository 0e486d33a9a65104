"""Shared by all tests: the leak check (threads, child processes, listening ports) and the real
recordings.
"""

import gc
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from hypothesis import settings

from identification.numerics.compiled import THREAD as KERNEL_THREAD
from rig.cli.entry import GARBAGE_THRESHOLD

_GRACE_S = 1.0
_MEMORY, _LEAST_BYTES = Path("/dev/shm"), 2 << 30
"""Files in memory, and the room that the tests want there."""

# As the command line sets its own process up, before numpy is loaded: threads of the linear algebra
# would spin in the way of the tests that run beside these.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
gc.set_threshold(GARBAGE_THRESHOLD)

# Every process of a test would compile the program anew, and pytest all tests.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Each record of a run is flushed to the disk: on a real one the tests wait for it half of their
# time.
if os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > _LEAST_BYTES:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(_MEMORY))

# A shell without job control has processes in the background ignore Ctrl-C, and their children too:
# a test that ends a program by it would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# The same of a hang-up, which programs that outlive their terminal ignore.
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The same examples on every machine, however slow it is; `make proofs` draws others each time, and
# more of them.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than processors, because many tests wait for other processes, for a
    browser, or for real time.
    """
    return 1 + (os.cpu_count() or 1)


def pytest_collection_finish() -> None:
    # Modules and thousands of tests stay to the end: no collection of garbage walks over them.
    gc.freeze()


@pytest.fixture(autouse=True)
def no_leaks() -> Iterator[None]:
    process = psutil.Process()
    threads = set(threading.enumerate())
    children = _children(process)
    ports = _listening(process)
    yield
    # The second thread of the kernels stays for the next computation.
    for thread in _new_threads(threads):
        thread.join(_GRACE_S)
    # A thread that ended may have started another one.
    leaked = [f"thread {thread.name}" for thread in _new_threads(threads)]
    started = [c for c in _children(process) - children if not _stays(c)]
    _, alive = psutil.wait_procs(started, _GRACE_S)
    leaked += [f"process {child.pid}" for child in alive]
    # A server that is not written in Python closes its port in a thread of its own.
    patience = time.monotonic() + _GRACE_S
    while (opened := _listening(process) - ports) and time.monotonic() < patience:
        time.sleep(0.01)
    leaked += [f"port {port}" for port in opened]
    assert not leaked, f"left behind: {', '.join(leaked)}"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Return where the shared real recordings are, beside the repository; without them a test
    skips, in CI it fails.
    """
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    if not folder.is_dir():
        message = f"the shared recordings are not at {folder}"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder


def _new_threads(before: set[threading.Thread]) -> set[threading.Thread]:
    """Return the threads that were not there before, without the second thread of the kernels."""
    new = set(threading.enumerate()) - before
    return {thread for thread in new if not thread.name.startswith(KERNEL_THREAD)}


def _children(process: psutil.Process) -> set[psutil.Process]:
    """Return the children, from where Linux lists them: psutil reads every process of the machine,
    and it is asked twice per test.
    """
    try:
        tasks = [task / "children" for task in Path(f"/proc/{process.pid}/task").iterdir()]
        return {psutil.Process(int(pid)) for task in tasks for pid in task.read_text().split()}
    except (OSError, psutil.NoSuchProcess):
        return set(process.children())


def _listening(process: psutil.Process) -> set[int]:
    return {c.laddr.port for c in process.net_connections("inet") if c.status == psutil.CONN_LISTEN}


def _stays(child: psutil.Process) -> bool:
    # multiprocessing keeps the first of these for the life of the interpreter; the other one reads
    # files for all commands.
    kept = ("resource_tracker", "rig.sources.served")
    try:
        return any(name in word for word in child.cmdline() for name in kept)
    except psutil.Error:
        # It has ended.
        return False


@pytest.fixture(scope="session", autouse=True)
def _runtime_folder() -> Iterator[None]:
    """Keep the control sockets of this process's runs apart from those of other tests' runs, which
    a console would show too.
    """
    before = os.environ.get("XDG_RUNTIME_DIR")
    with tempfile.TemporaryDirectory(prefix="loadrig-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        yield
    if before is None:
        del os.environ["XDG_RUNTIME_DIR"]
    else:
        os.environ["XDG_RUNTIME_DIR"] = before
