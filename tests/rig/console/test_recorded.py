"""The console lists the runs of its folder, and gives out their pages and nothing else."""

from __future__ import annotations

import asyncio
import json
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware

from rig.console.gate import HEADERS, SANDBOX, Gate
from rig.console.recorded import SHOWN, Recorded
from rig.results.run.report import inlined_script

HOST = "127.0.0.1:1"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder with two folders of runs, which are half written, and one that is none."""
    for name in ("one", "deep/two"):
        folder = tmp_path / "runs" / name
        (folder / "diagnosis").mkdir(parents=True)
        (folder / "run.json").write_text("{")
        for file in ("run.html", "diagnosis/report.html", "certificate.pdf", "notes.html"):
            (folder / file).write_text(f"{name} {file}")
    (tmp_path / "runs" / "none").mkdir()
    (tmp_path / "runs" / "none" / "run.html").write_text("no run")
    return tmp_path / "runs"


def app_of(root: Path) -> Starlette:
    return Starlette(
        routes=Recorded(root).routes, middleware=[Middleware(Gate, hosts=frozenset({HOST}))]
    )


def asked(app: Starlette, path: str, method: str = "GET") -> tuple[int, str, dict[str, list[str]]]:
    """Return status, text and headers of the answer."""
    headers: dict[str, list[str]] = {}
    found: dict[str, Any] = {"text": b""}

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        found["status"] = message.get("status", found.get("status"))
        found["text"] += message.get("body", b"")
        for name, value in message.get("headers", []):
            headers.setdefault(name.decode(), []).append(value.decode())

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": [(b"host", HOST.encode())],
    }
    asyncio.run(app(scope, receive, send))
    return found["status"], found["text"].decode(), headers


def test_the_runs_are_listed_as_what_they_are(root: Path) -> None:
    status, text, _ = asked(app_of(root), "/recorded")
    found = json.loads(text)
    assert (status, found["count"], found["problem"]) == (200, 2, "")
    assert {run["folder"] for run in found["runs"]} == {"one", "deep/two"}
    for run in found["runs"]:
        assert run["cells"][-2] == "HALF WRITTEN"
        assert "rig recover" in run["problem"]
        assert [name for name, _ in run["pages"]] == [
            "run.html",
            "diagnosis/report.html",
            "certificate.pdf",
        ]


def test_a_folder_that_is_not_there_yet_has_no_runs(tmp_path: Path) -> None:
    found = json.loads(asked(app_of(tmp_path / "runs"), "/recorded")[1])
    assert (found["count"], found["runs"], found["problem"]) == (0, [], "")
    assert not (tmp_path / "runs").exists()


def test_the_latest_of_many_are_listed(tmp_path: Path) -> None:
    for number in range(SHOWN + 5):
        (tmp_path / f"{number:03}").mkdir()
        (tmp_path / f"{number:03}" / "run.json").write_text("{")
    found = json.loads(asked(app_of(tmp_path), "/recorded")[1])
    assert (found["count"], len(found["runs"])) == (SHOWN + 5, SHOWN)
    assert found["runs"][0]["folder"] == f"{SHOWN + 4:03}"


@pytest.mark.parametrize("name", ["run.html", "diagnosis/report.html", "certificate.pdf"])
@pytest.mark.parametrize("folder", ["one", "deep/two"])
def test_the_pages_of_a_run_are_given_out_without_power_to_act(
    root: Path, folder: str, name: str
) -> None:
    app = app_of(root)
    asked(app, "/recorded")
    status, text, headers = asked(app, f"/recorded/{folder}/{name}")
    assert (status, text) == (200, f"{folder} {name}")
    # One policy only: a second one would forbid the page its own style.
    (policy,) = headers["content-security-policy"]
    if name == "run.html":
        # The one script that may run is that of this program, in an origin of its own.
        digest = b64encode(sha256(inlined_script().encode()).digest()).decode()
        policy = policy.removesuffix(f"; script-src 'sha256-{digest}'")
        policy = policy.replace(" allow-scripts", "")
    assert policy == SANDBOX
    assert "script" not in policy
    assert "same-origin" not in policy
    assert ("content-disposition" in headers) == name.endswith(".pdf")
    assert {key.lower() for key in HEADERS} <= set(headers)


@pytest.mark.parametrize(
    "path",
    [
        "one/notes.html",
        "one/run.json",
        "one/diagnosis",
        "none/run.html",
        "one/../none/run.html",
        "../runs/one/run.html",
        "one/report.html",
        "run.html",
        "",
    ],
)
def test_nothing_else_is_given_out(root: Path, path: str) -> None:
    app = app_of(root)
    asked(app, "/recorded")
    assert asked(app, f"/recorded/{path}")[0] == 404


@pytest.mark.parametrize("path", ["/recorded", "/recorded/one/run.html"])
def test_runs_are_only_read(root: Path, path: str) -> None:
    assert asked(app_of(root), path, "POST")[0] in (403, 405)
