"""Checks that a file that the user names is a plain file, before it is opened."""

from __future__ import annotations

import errno
import stat
from pathlib import Path


def require_plain(path: Path) -> None:
    """Check that a path leads to a plain file, without opening it.

    Opening a pipe would wait for a writer for ever, and a device such as ``/dev/zero`` never ends.

    Raises:
        OSError: It does not lead to one; ``strerror`` states the reason.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        # The path has a zero byte, or a character not allowed in file names here.
        raise OSError(errno.EINVAL, f"it is not a valid file name ({error})", str(path)) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device; name a file", str(path))
