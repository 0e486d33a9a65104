"""``rig watch`` as a shell starts it, and the layouts that it names."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import foxglove.layouts
import pytest
from websockets.sync.client import connect

from rig.cli.entry import status
from rig.common.sample import Sample
from rig.runs.live import TOPICS, layout

START = "from rig.cli.entry import main; main()"


@pytest.fixture
def run(runner: Any, fake_bench: Any) -> Path:
    folder, _ = runner(fake_bench())
    return Path(folder.path)


def test_an_address_is_printed_served_and_given_up_at_ctrl_c(run: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", START, "watch", str(run), "--foxglove", "--port", "0"]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        lines: list[str] = []
        while not lines or "Ctrl-C" not in lines[-1]:
            lines.append(process.stdout.readline())
            assert lines[-1], "".join(lines)
        text = "".join(lines)
        address = re.search(r"ws://127\.0\.0\.1:\d+/\?token=\S+", text)
        assert address is not None
        with connect(address.group(), subprotocols=["foxglove.sdk.v1"]) as client:  # type: ignore[list-item]
            info = json.loads(client.recv(60))
            # With a client connected, Ctrl-C ends it as well.
            process.send_signal(signal.SIGINT)
            rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert rest == "no longer served\n"
    assert "simulated bench" in info["name"]
    assert str(layout("foxglove")) in text
    assert "REAL" not in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "add --foxglove"),
        (["--foxglove", "--part", "2"], "has 1 recording (got 2)"),
    ],
)
def test_what_is_asked_wrongly(
    run: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["watch", str(run), *options]) == 2
    assert words in capsys.readouterr().err


def test_a_port_in_use_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert status(["watch", str(run), "--foxglove", "--port", str(port)]) == 2
    assert f"--port: {port} cannot be used" in capsys.readouterr().err


def _values(item: Any) -> Iterator[str]:
    if isinstance(item, dict):
        for key, value in item.items():
            if key in ("value", "topicPath"):
                yield value
            else:
                yield from _values(value)
    elif isinstance(item, list):
        for value in item:
            yield from _values(value)


def test_the_layout_for_foxglove_shows_topics_and_fields_that_are_served() -> None:
    content = json.loads(layout("foxglove").read_text(encoding="utf-8"))
    served = {topic.name for topic in TOPICS} | {f"/sample.{name}" for name in Sample._fields}
    named = set(_values(content["configById"]))
    assert len(named) > 6
    assert named <= served
    assert _places(content["layout"]) == set(content["configById"])


def _places(tree: Any) -> set[str]:
    return {tree} if isinstance(tree, str) else _places(tree["first"]) | _places(tree["second"])


def test_the_layout_for_foxglove_has_keys_that_the_sdk_writes() -> None:
    content = json.loads(layout("foxglove").read_text(encoding="utf-8"))
    known = {
        "Plot": set(foxglove.layouts.PlotConfig()._to_dict()),
        "RawMessages": set(foxglove.layouts.RawMessagesConfig()._to_dict()),
    }
    series = set(foxglove.layouts.PlotSeries()._to_dict())
    for name, config in content["configById"].items():
        assert set(config) <= known[name.partition("!")[0]] | {"foxglovePanelTitle"}, name
        for path in config.get("paths", []):
            assert set(path) <= series


def test_the_layout_for_plotjuggler_shows_fields_that_are_served() -> None:
    tree = ET.parse(layout("plotjuggler")).getroot()
    served = {f"/sample/{name}" for name in Sample._fields}
    curves = list(tree.iter("curve"))
    assert len(curves) > 5
    for curve in curves:
        if "curve_x" in curve.attrib:
            assert {curve.attrib["curve_x"], curve.attrib["curve_y"]} <= served
        else:
            assert curve.attrib["name"] in served
    for splitter in tree.iter("DockSplitter"):
        count = int(splitter.attrib["count"])
        assert count == len(splitter) == len(splitter.attrib["sizes"].split(";"))
    # PlotJuggler keeps this window and looks for this stream by name.
    assert tree.find("tabbed_widget").attrib["name"] == "Main Window"  # type: ignore[union-attr]
    assert tree.find("previouslyLoaded_Streamer").attrib["name"] == "Foxglove ROS2 Bridge"  # type: ignore[union-attr]
