"""Page of the recording's layout: topics, fields, metadata and attachments."""

from __future__ import annotations

from collections.abc import Mapping

from keys import table

from rig.cli.authoring.schema import meanings
from rig.common.sample import Sample
from rig.runs.mcap import layout as mcap_layout
from rig.runs.run_record import BENCH_ATTACHMENT, FEEDFORWARD_INPUT, SEQUENCE_ATTACHMENT, Ending

EVENTS: Mapping[str, tuple[str, str]] = {
    "prompt": (
        "stage, index, weight_kg, current_A, motion_rad_s",
        "The operator is asked for the load of a stage; the drive is off, by its state, motor "
        "current and joint speed.",
    ),
    "answer": (
        "stage, weight_kg",
        "The operator confirmed the load; `weight_kg` is the typed mass.",
    ),
    "fault reset": ("stage", "A fault of the drive was cleared."),
    "ignition": ("stage", "The simulated gas generator was lit."),
    "stage start": ("stage", "The drive is about to be energised."),
    "first pass": ("stage, amplitude", "A first pass begins, at this share of the amplitude."),
    "units": (
        "stage, factors",
        "The reports of the devices were compared. For each quantity, the ratio of the found to "
        "the expected value; null if the motion did not show the quantity.",
    ),
    "weight check": (
        "stage, verdict, measured_kg, message",
        "The weight was compared with the friction.",
    ),
    "segment": (
        "number, and the segment as in `run.json`",
        "An excitation begins; its samples carry the number.",
    ),
    "stage end": (
        "stage, current_A, motion_rad_s",
        "The drive is off again, by its state, motor current and joint speed.",
    ),
    "repeat": ("stage", "The operator asked for the stage once more."),
    "paused": ("stage", "The run waits between stages; the drive is off."),
    "go on": ("stage", "The operator ended the pause."),
    "abort": ("stage", "The operator ended the run at a prompt."),
}
"""Event to its further keys and its meaning; beside these one of
:class:`rig.runs.run_record.Ending` ends it.
"""
ATTACHMENTS = (
    (
        BENCH_ATTACHMENT,
        "The bench file. Of a simulated machine it contains only the constants that are known of a "
        "real machine, without the friction.",
    ),
    (SEQUENCE_ATTACHMENT, "The sequence file."),
    (
        FEEDFORWARD_INPUT,
        "The identification from which the feed-forward torque was computed, if there is one.",
    ),
    (
        "devices.json",
        "Identities of the devices, and the limits that the drive held before the run.",
    ),
    ("run.json", "The plan of the run, as the run folder's `run.json` was at the start."),
)
METADATA = (
    ("run", "Name, creation time, seed and operator of the run; number of this recording in it."),
    (
        mcap_layout.CLOCK_METADATA,
        "`zero_ns`: start of the recording by the host's monotonic clock, ns.",
    ),
    ("versions", "Version of this program, of Python and of the libraries that it uses."),
    ("sha256", "SHA-256 of bench, sequence, EDS, DBC and feed-forward files."),
    ("servo, encoder, pressure", "Identity of each device as it was read."),
    ("calibrations", "Certificate and last valid day of each calibrated device."),
)
_INTRO = """\
A run folder contains one recording for the run and one for each `rig resume`, in the format
[MCAP](https://mcap.dev). PlotJuggler and Foxglove open such files. All times are seconds since
the start of the recording; the log times of MCAP state them in nanoseconds.

If the program died while it wrote a file, the file lacks its index and perhaps its last second;
`rig recover` repairs the file."""
_SAMPLES = f"""\
The topic has one protobuf message per control cycle, with the schema
`{mcap_layout.SAMPLE_SCHEMA}`, which the file contains. Every field is a 64-bit float. Angles,
speeds and errors are at the joint, `motor_angle`, `current` and `voltage` at the motor. `current`
and `voltage` are means over the cycle that ends at the sample.

Fields are numbered in this order; recordings of earlier versions lack the last fields."""
_FRAMES = f"""\
The topic has one message per control cycle, and one message for frames outside a cycle. A message
contains every frame on the wire, packed without padding, little-endian,
{mcap_layout.FRAME_BYTES} bytes each. Encoding: `{mcap_layout.FRAME_ENCODING}`."""


def page() -> str:
    """Return the page."""
    known = meanings(Sample)
    if lacking := [name for name in Sample._fields if name not in known]:
        raise KeyError(f"rig.common.sample.Sample: no description of {', '.join(lacking)}")
    samples = [
        (str(number), f"`{name}`", known[name].unit, known[name].text)
        for number, name in enumerate(Sample._fields, start=1)
    ]
    events = [(f"`{name}`", keys, words) for name, (keys, words) in EVENTS.items()]
    events += [
        (f"`{ending.value}`", "message, phase", "The run ended in this state.") for ending in Ending
    ]
    frames = [
        (
            "0",
            "time",
            "ns, signed 64-bit, since the start of the recording; negative before it",
        ),
        (
            "8",
            "identifier",
            "unsigned 32-bit: CAN identifier, or the kind of message on a serial line",
        ),
        ("12", "length", "unsigned 8-bit: bytes of data"),
        ("13", "data", "8 bytes, the rest zero"),
        ("21", "sent", "1 if the host sent the frame, 0 if the host received it"),
    ]
    attachments = [(f"`{name}`", words) for name, words in ATTACHMENTS]
    metadata = [(f"`{name}`".replace(", ", "`, `"), words) for name, words in METADATA]
    parts = [
        "# Layout of a recording",
        _INTRO,
        f"## Samples: {mcap_layout.SAMPLE_TOPIC}",
        _SAMPLES,
        table(("number", "field", "unit", "meaning"), samples),
        f"## Events: {mcap_layout.EVENT_TOPIC}",
        "The topic has one JSON object per event, with `time` (s), `event` and further keys.",
        table(("event", "further keys", "meaning"), events),
        f"## Raw frames: {mcap_layout.FRAMES_TOPIC}",
        _FRAMES,
        table(("byte", "what", "format"), frames),
        "## Metadata",
        table(("record", "holds"), metadata),
        "## Attachments",
        table(("name", "holds"), attachments),
    ]
    return "\n\n".join(parts) + "\n"
