"""Simulates a full disk by the limit of this process on the size of files."""

from __future__ import annotations

from rig.common.errors import InputError


class FileLimit:
    """The limit on the size of files; :meth:`restore` restores the previous limit."""

    def __init__(self) -> None:
        self._before: tuple[int, int] | None = None

    def fill(self) -> None:
        """Make every further write to a file fail, as on a full disk.

        Raises:
            InputError: This operating system cannot limit the size of files.
        """
        try:
            import resource
        except ImportError as error:
            raise InputError(
                "the fault disk_full needs a limit on the size of files, which this system lacks; "
                "use Linux or macOS, or leave the fault out"
            ) from error
        self._before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, self._before[1]))

    def restore(self) -> None:
        """Restore the previous limit, if it was changed."""
        if self._before is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_FSIZE, self._before)
