"""Page of the file formats that campaigns read: library, columns, what is handled and refused."""

from __future__ import annotations

from typing import NamedTuple

from keys import table

from rig.sources.formats import FOREIGN, FORMATS

_HEAD = """\
# File formats of recordings

A [campaign file](campaign.md) and `rig look` accept recordings in these formats. The extension of
the file selects the format; the extension `.gz` may follow. If the program changes content while
it reads a file, a note of the recording states the change. The program refuses content that it
cannot read with certainty; the message names the file, the row or line, and the remedy.

A campaign file names a column by its full name, by the last part of the name if only one column
ends in it, or by its index. Some formats need a library from an extra of the program, for example
`pip install 'loadrig[mdf]'`; the extra `loadrig[logs]` installs all these libraries."""
_BASES = """\
## Several time bases

Each group of an MDF or TDMS file, each topic of MCAP and each message of CAN traffic has its own
rows and time stamps. The channel `time` selects the time stamps of the recording, for example
`time: Motion.time`. Channels of other groups are interpolated linearly at these stamps (`enabled`
keeps its last value), and a note states both rates. Where the samples of a channel are more than
five periods apart, the interpolated value is missing. Rows before the first or after the last
sample of any channel are left out, with a note. Groups without a common clock cannot be used
together, and a `rate` cannot replace their time.

Counters that overflow are unwrapped before the interpolation, even if the file contains scaled
values."""
_ALL = """\
## For every format

Integers beyond 2^53 become differences from the first value, and dates become seconds since the
first date. Text and complex numbers cannot be channels. A note reports a unit in the file beside a
scale of 1, a speed that differs from the change of the angle, a current without its sign, and a
sample that is far from all others; `rig look` reports these doubts before there is a campaign
file."""
_FOREIGN = "## Not read\n\n"


class _Row(NamedTuple):
    extensions: tuple[str, ...]
    library: str
    columns: str
    handled: str
    refused: str


ROWS = (
    _Row(
        ("csv", "tsv", "txt"),
        "numpy",
        "as in the header, or by index",
        "UTF-8, UTF-16, Latin-1; delimiter `,` `;` tab, bar or blanks; a row of units; dates and "
        "times of day (year first); decimal commas with `read.decimal`; `-1.#IND` and other words "
        "for a missing value; row names of R; a header that counts 0, 1, 2; an `EOF` line; sparse "
        "rows of several topics",
        "rows with more cells than names; words between numbers; lines after `EOF`",
    ),
    _Row(
        ("mat",),
        "scipy; from v7.3 on h5py, extra `hdf5`",
        "`name`, `name[0]` of a matrix, `struct.field`, `s.signals[1].values`",
        "versions 4 to 7.3; structs and cells at any depth; the file of `rig export --format mat`",
        "objects (save `.Time` and `.Data` of a timeseries), sparse and complex arrays, text",
    ),
    _Row(
        ("h5", "hdf5"),
        "h5py, extra `hdf5`",
        "`group.dataset`, `dataset[0]` of a matrix, `table.field`",
        "compound datasets; `units`; `scale_factor`, `add_offset` and `_FillValue` of the CF "
        "conventions",
        "links to other files and virtual datasets are left out with a note; text, complex numbers",
    ),
    _Row(
        ("mf4", "mdf"),
        "asammdf, extra `mdf`",
        "`group.channel`, `group.time`; without the group name if there is one group; "
        "`channel[0]` of an array",
        "versions 2, 3 and 4; conversions; either byte order; invalidation bits (missing samples); "
        "labels as raw numbers; groups at several rates; bus logging with `read.dbc`",
        "text; an angle or an index as the master channel, which is no clock",
    ),
    _Row(
        ("tdms",),
        "npTDMS, extra `tdms`",
        "`group.channel`, `group.time` of a waveform; without the group name if there is one group",
        "waveforms with start and increment; scales; channels of time stamps; either byte order; a "
        "file that was cut off: the rows that all channels of a group have",
        "scales that npTDMS does not know; text; groups without a common start together",
    ),
    _Row(
        ("mcap",),
        "mcap; CDR and protobuf with the extra `mcap`",
        "`topic.field`, `topic.position[0]`, `topic.motors[1].current`, `topic.log_time`",
        "JSON, CDR of ROS 2 (`ros2msg`), protobuf; lists of messages up to 64 elements; a stamp of "
        "`sec` and `nanosec` as one time; a file that was cut off, up to its last whole message",
        "other encodings are left out with a note; damage inside a whole file",
    ),
    _Row(
        ("json",),
        "Python",
        "`field`, `field.inner`, `field[0]`; with the place of the table if there are several",
        "a list of objects, an object of lists, a list of lists, and pandas' `split`, `table`, "
        "`index` and `columns`, also inside an object; ISO dates; `null` as missing",
        "a key twice; rows of different lengths; columns of tables of different lengths together",
    ),
    _Row(
        ("jsonl", "ndjson"),
        "Python",
        "`field`, `field.inner`, `field[0]`",
        "one object a line; ISO dates; a stamp of `sec` and `nanosec`; a last line that is cut off",
        "lines that are no object; a key twice",
    ),
    _Row(
        ("npz", "npy"),
        "numpy, without pickle",
        "`name`, `name[0]` of a matrix, `name.field` of a structured array; of one array "
        "`array[0]` or its fields",
        "either byte order; dates",
        "arrays of objects, text, complex numbers",
    ),
    _Row(
        ("parquet",),
        "pyarrow, extra `parquet`",
        "as in the file",
        "time stamps and durations",
        "text, lists, structs",
    ),
    _Row(
        ("log", "asc", "blf", "trc"),
        "python-can and cantools",
        "`Message.Signal`, `Message.time`",
        "candump -L, Vector ASC and BLF, PEAK TRC 1.0, 1.1, 1.3, 2.0, 2.1; 11 and 29 bits, CAN FD; "
        "either byte order; multiplexed signals, also in several levels, each page with its own "
        "`time`; SAE J1939 by parameter group; `read.bus`, else messages of several buses with the "
        "bus before the name; frames that are too short lack the signals beyond their end; error "
        "frames, remote frames and frames of other messages are counted; stamps since an event "
        "before are added up; stamps are since the first frame",
        "traffic without a map (`read.dbc`); two messages of one identifier; "
        "containers and signals of more than 64 bits; a line that is no frame of candump -L",
    ),
)


def page() -> str:
    """Return the page.

    Raises:
        AssertionError: A format has no row, or a row no format.
    """
    listed = [extension for row in ROWS for extension in row.extensions]
    assert sorted(listed) == sorted(FORMATS), "docs/generator/formats.py: rows and readers differ"
    head = ("format", "library", "columns", "handled", "refused")
    rows = [(", ".join(f"`{e}`" for e in row.extensions), *row[1:]) for row in ROWS]
    foreign = [(f"`{extension}`", words) for extension, words in FOREIGN.items()]
    parts = (
        _HEAD,
        table(head, rows),
        _BASES,
        _ALL,
        _FOREIGN + table(("extension", "content"), foreign),
    )
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"
