"""The console lists the runs of its folder and gives out their pages and nothing else."""

import asyncio
import json
import os
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from rig.console.app import SHOWN, Console
from rig.console.gate import HEADERS, SANDBOX, Token
from rig.console.hub import Hub
from rig.console.starting import Starter
from rig.results.run.report import inlined_script

from .histories import write_history, write_run

HOST = "127.0.0.1:1"
Answer = tuple[int, str, dict[str, str]]


class Desk:
    """A console without a server, and one page that has its token.

    Args:
        root: Folder of the runs.
        command: Start of the command line of ``rig``; by default one that must not be needed.
    """

    def __init__(self, root: Path, *command: str) -> None:
        self.token = Token()
        starter = Starter(("practical",), root, command or ("/nothing/to/run",))
        hub = Hub(starter)
        hub._links.close()  # no run is commanded here
        self.page = hub.controls.open()
        hub.controls.admit(self.page)
        self.app = Console(hub, self.token, frozenset({HOST})).app
        self.number = 0

    def get(self, path: str, query: str = "", **headers: str) -> Answer:
        """Ask as a browser does."""
        return asyncio.run(self._asked("GET", path, query, b"", {"host": HOST, **headers}))

    def post(self, path: str, content: dict[str, Any], **headers: str) -> Answer:
        """Command as the page does."""
        return asyncio.run(self._post(path, content, headers))

    def both(self, path: str, content: dict[str, Any]) -> tuple[Answer, Answer]:
        """Command twice at once."""

        async def asking() -> tuple[Answer, Answer]:
            return await asyncio.gather(*(self._post(path, content, {}) for _ in range(2)))

        return asyncio.run(asking())

    async def _post(self, path: str, content: dict[str, Any], headers: dict[str, str]) -> Answer:
        self.number += 1
        given = {
            "host": HOST,
            "origin": f"http://{HOST}",
            "authorization": f"Bearer {self.token.text}",
            "content-type": "application/json",
            **headers,
        }
        body = json.dumps({"page": self.page.key, "number": self.number, **content}).encode()
        return await self._asked("POST", path, "", body, given)

    async def _asked(
        self, method: str, path: str, query: str, body: bytes, headers: dict[str, str]
    ) -> Answer:
        found: dict[str, Any] = {"text": b"", "headers": {}}

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": body, "more_body": False}

        async def send(message: Any) -> None:
            found["status"] = message.get("status", found.get("status"))
            found["text"] += message.get("body", b"")
            pairs = message.get("headers", [])
            # One policy only: a second one would forbid a page its own style.
            assert len(dict(pairs)) == len(pairs)
            found["headers"].update({name.decode(): value.decode() for name, value in pairs})

        scope = {
            "type": "http",
            "method": method,
            "path": path,
            "raw_path": path.encode(),
            "root_path": "",
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
        }
        await self.app(scope, receive, send)
        return found["status"], found["text"].decode(), found["headers"]


def words(answer: Answer) -> str:
    """Return the words of an answer."""
    return str(json.loads(answer[1])["words"])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Nine runs of one bench, one of another bench, and one that is half written."""
    root = tmp_path / "runs"
    write_history(root, 8)
    write_history(root, 1, bench="other")
    write_run(root / "bare", 20, "mine")
    (root / "half").mkdir()
    (root / "half" / "recording.mcap").write_bytes(b"cut off")
    return root


@pytest.fixture
def desk(root: Path) -> Desk:
    return Desk(root)


def test_the_list_can_be_chosen(desk: Desk) -> None:
    def listed(query: str) -> dict[str, Any]:
        found = json.loads(desk.get("/recorded", query)[1])
        assert isinstance(found, dict)
        return found

    everything = listed("")
    assert (everything["count"], len(everything["runs"])) == (11, 11)
    assert everything["benches"] == ["mine", "other"]
    few = listed("bench=mine&last=3")
    assert [run["folder"] for run in few["runs"]] == ["bare", "mine-08", "mine-07"]
    assert listed("bench=nobody")["runs"] == []
    for query in ("last=0", "last=x", "last=301", "last=9999999999999"):
        assert desk.get("/recorded", query)[0] == 400


def test_a_folder_whose_name_is_no_unicode_is_listed(root: Path, desk: Desk) -> None:
    os.rename(root / "mine-01", os.fsencode(root) + b"/\xff")
    status, text, _ = desk.get("/recorded")
    assert status == 200
    assert "\udcff" in [run["folder"] for run in json.loads(text)["runs"]]


@pytest.fixture
def half_written(tmp_path: Path) -> Path:
    """A folder with two folders of runs, which are half written, and one that is none."""
    for name in ("one", "deep/two"):
        folder = tmp_path / "runs" / name
        (folder / "diagnosis").mkdir(parents=True)
        (folder / "run.json").write_text("{")
        for file in ("run.html", "diagnosis/report.html", "certificate.html", "notes.html"):
            (folder / file).write_text(f"{name} {file}")
    (tmp_path / "runs" / "none").mkdir()
    (tmp_path / "runs" / "none" / "run.html").write_text("no run")
    return tmp_path / "runs"


def test_the_runs_are_listed_as_what_they_are(half_written: Path) -> None:
    empty = json.loads(Desk(half_written / "nothing").get("/recorded")[1])
    assert (empty["count"], empty["runs"], empty["problem"]) == (0, [], "")
    status, text, _ = Desk(half_written).get("/recorded")
    found = json.loads(text)
    assert (status, found["count"], found["problem"]) == (200, 2, "")
    assert {run["folder"] for run in found["runs"]} == {"one", "deep/two"}
    for run in found["runs"]:
        assert run["cells"][-2] == "HALF WRITTEN"
        assert "rig recover" in run["problem"]
        assert [name for name, _ in run["pages"]] == [
            "run.html",
            "diagnosis/report.html",
            "certificate.html",
        ]


def test_the_latest_of_many_are_listed(tmp_path: Path) -> None:
    for number in range(SHOWN + 5):
        (tmp_path / f"{number:03}").mkdir()
        (tmp_path / f"{number:03}" / "run.json").write_text("{")
    found = json.loads(Desk(tmp_path).get("/recorded")[1])
    assert (found["count"], len(found["runs"])) == (SHOWN + 5, SHOWN)
    assert found["runs"][0]["folder"] == f"{SHOWN + 4:03}"


@pytest.mark.parametrize("name", ["run.html", "diagnosis/report.html", "certificate.html"])
def test_the_pages_of_a_run_are_given_out_without_power_to_act(half_written, name):
    desk = Desk(half_written)
    desk.get("/recorded")
    status, text, headers = desk.get(f"/recorded/deep/two/{name}")
    assert (status, text) == (200, f"deep/two {name}")
    policy = headers["content-security-policy"]
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


def test_nothing_else_is_given_out(half_written: Path) -> None:
    desk = Desk(half_written)
    desk.get("/recorded")
    unlisted = ("one/notes.html", "one/run.json", "one/diagnosis", "one/report.html", "run.html")
    outside = ("none/run.html", "one/../none/run.html", "../runs/one/run.html", "")
    for path in unlisted + outside:
        assert desk.get(f"/recorded/{path}")[0] == 404
