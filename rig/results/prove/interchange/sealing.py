"""Makes sealed rigs with the workers of an engine; this process writes the files of the rigs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from rig.common.input_files import is_file
from rig.results.prove.draw import Assigned
from rig.results.prove.engines import Engine
from rig.results.prove.engines.bundle import Files, read_folder, write_folder
from rig.results.prove.interchange.folder import (
    PREFIX,
    SEALED,
    SealedRig,
    place,
    sealed_rigs,
)
from rig.results.prove.seal import random_salt
from rig.results.prove.sums import write_sums


class Task(NamedTuple):
    """One rig to make.

    Attributes:
        number: Number of the rig, from 1.
        assigned: Kind and effects.
        salt: Salt of the seal.
    """

    number: int
    assigned: Assigned
    salt: str


class Made(NamedTuple):
    """One rig that was made.

    Attributes:
        name: Name of the rig.
        files: Files of the rig, by paths relative to the folder of sealed rigs; the truth is last.
    """

    name: str
    files: Files


def seal_all(
    home: Path,
    drawn: Sequence[tuple[int, Assigned]],
    one: Callable[[Task], Made],
    engine: Engine,
    progress: Callable[[str, float], None],
    salt: Callable[[int], str] = random_salt,
) -> list[SealedRig]:
    """Make and write the rigs that do not exist yet; return all rigs with their digests.

    Args:
        home: Folder of the sealed rigs.
        drawn: Number, kind and effects of each rig.
        one: Makes one rig; with more than one worker it must be importable.
        engine: Engine that makes the rigs.
        progress: Called with the label of a step and the share that is done.
        salt: Function that returns the salt of the rig with a number; random by default.

    Raises:
        InputError: Workers die repeatedly.
        OSError: A file cannot be written.
    """
    todo = [
        Task(n, assigned, salt(n))
        for n, assigned in drawn
        if not is_file(place(home, _name(n)).truth)
    ]
    done = len(drawn) - len(todo)
    for rig in engine.each(one, todo):
        write_folder(home, rig.files)
        done += 1
        progress(f"{rig.name} sealed, {done} of {len(drawn)}", done / len(drawn))
    write_sums(home)
    return sealed_rigs(home)


@contextmanager
def making(number: int) -> Iterator[SealedRig]:
    """Yield the paths of a rig in a temporary folder."""
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        yield place(Path(scratch), _name(number))


def made(where: SealedRig) -> Made:
    """Return the files of a rig that was written into a temporary folder."""
    files = read_folder(where.campaign.parents[1])
    truth = f"{SEALED}/{where.truth.name}"
    return Made(where.name, {**{k: v for k, v in files.items() if k != truth}, truth: files[truth]})


def _name(number: int) -> str:
    return f"{PREFIX}{number:04d}"
