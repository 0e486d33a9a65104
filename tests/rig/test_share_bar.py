"""The bar of long work: each kind of work is shown as it begins, and nothing where nobody looks."""

from __future__ import annotations

import io
import sys

import pytest

from rig.terminal.output import ShareBar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_each_kind_of_work_is_shown_as_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with ShareBar() as bar:
        bar("reading", 0.0)
        assert "reading" in terminal.getvalue()
        bar("joint fit, 2 recordings", 0.0)
        assert "joint fit, 2 recordings" in terminal.getvalue()
        bar("joint fit, 2 recordings", 1.0)
        assert "100 %" in terminal.getvalue()
        bar("simulated replicates, round 1", 0.5)
        assert "50 %" in terminal.getvalue()
    assert "\n" not in terminal.getvalue().rstrip("\n")


def test_without_a_terminal_nothing_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with ShareBar() as bar:
        bar("reading", 0.5)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")
