"""Checks that a file that the user names is a plain file, before it is opened."""

from __future__ import annotations

import errno
import stat
from pathlib import Path


def require_plain(path: Path) -> None:
    """Check that a path leads to a plain file, without opening it.

    To open a pipe would wait for a writer without end, and to read a device such as ``/dev/zero``
    never ends.

    Raises:
        OSError: The path does not lead to a plain file; ``strerror`` states the reason.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        # The path contains a zero byte, or a character that is not allowed in file names on this
        # system.
        raise OSError(errno.EINVAL, f"it is not a valid file name ({error})", str(path)) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(
            errno.EINVAL,
            "the path leads to a pipe or a device; state the path of a file",
            str(path),
        )
