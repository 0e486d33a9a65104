"""The console lists the runs of its folder and gives out their pages and nothing else; it makes
comparisons and trends of the runs of its list.
"""

import asyncio
import json
import os
from base64 import b64encode
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from rig.console import recorded
from rig.console.app import Console
from rig.console.gate import HEADERS, SANDBOX, Token
from rig.console.hub import Hub
from rig.console.recorded import MOST_COMPARED, SHOWN
from rig.console.starting import COMMAND, Starter
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


@pytest.fixture(autouse=True)
def _no_low_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine would leave a process of low priority waiting for minutes."""
    monkeypatch.setattr(recorded, "NICE", 0)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Eight identified runs of one bench, of which Mc steps; one of another bench; one without
    constants; and one that is half written.
    """
    root = tmp_path / "runs"
    write_history(root, 8, step=6.0)
    write_history(root, 1, bench="other")
    write_run(root / "bare", 20, {}, "mine")
    (root / "half").mkdir()
    (root / "half" / "recording.mcap").write_bytes(b"cut off")
    (tmp_path / "outside").mkdir()
    return root


@pytest.fixture
def desk(root: Path) -> Desk:
    return Desk(root)


def test_runs_are_compared_on_a_page_that_can_do_nothing(root: Path) -> None:
    desk = Desk(root, *COMMAND)
    status, text, _ = desk.post("/compare", {"runs": ["mine-08", "mine-01"]})
    found = json.loads(text)
    # In the order of time, whichever was chosen first.
    assert (status, found["words"]) == (200, "Comparison of mine-01, mine-08")
    status, page, headers = desk.get(found["page"])
    assert status == 200
    assert headers["content-security-policy"] == SANDBOX
    assert "mine-08 against" in page
    assert page.count("<td>changed</td>") == 1
    assert "changed by more than their uncertainty: Mc" in page
    for path in (found["page"], "/recorded", "/recorded/mine-01/run.html"):
        assert desk.post(path, {})[0] == 405
    for key in ("none", "..", "../recorded"):
        assert desk.get(f"/made/{key}")[0] == 404


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (["mine-01", "../outside"], "../outside: not in the list of runs"),
        (["mine-01", "mine-02/../mine-03"], "not in the list of runs"),
        (["mine-01", "--out=x"], "--out=x: not in the list of runs"),
        (["mine-01", "mine-01"], f"choose 2 to {MOST_COMPARED} runs (got 1)"),
        ([f"mine-{n}" for n in range(9)], "(got 9)"),
        (["mine-01", 2], "runs must be a list of folders"),
        ("mine-01", "runs must be a list of folders"),
    ],
)
def test_only_runs_of_the_list_are_compared(desk: Desk, runs: object, said: str) -> None:
    answer = desk.post("/compare", {"runs": runs})
    assert answer[0] == 409
    assert said in words(answer)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"constant": "Mx"}, "Mx: no listed run has this constant"),
        ({"constant": "Mc", "bench": "m*"}, "no listed run has this constant"),
        ({"constant": "Mc", "bench": 5}, "bench must be a text"),
        ({"constant": "Mc", "last": 0}, "last a whole number from 1 to"),
        ({"constant": "Mc", "last": 10_000}, "last a whole number from 1 to"),
        ({"constant": "Mc", "last": True}, "last a whole number from 1 to"),
    ],
)
def test_only_constants_of_the_listed_runs_are_followed(desk, content, said):
    answer = desk.post("/trend", content)
    assert answer[0] == 409
    assert said in words(answer)


def test_damaged_runs_are_refused_with_the_remedy(root: Path) -> None:
    desk = Desk(root, *COMMAND)
    assert desk.get("/recorded")[0] == 200
    # Damaged after it was listed.
    (root / "mine-02" / "run.json").write_text("{")
    answer = desk.post("/compare", {"runs": ["mine-01", "bare", "half", "mine-02"]})
    assert answer[0] == 409
    assert "half: there is neither a run.json nor a copy" in words(answer)
    assert "`rig recover`" in words(answer)
    assert "mine-02/run.json" in words(answer)
    assert "bare" not in words(answer)
    assert os.listdir(root.parent / "outside") == []


def test_one_page_is_made_at_a_time_and_a_failure_is_told(root: Path) -> None:
    desk = Desk(root, "/bin/sh", "-c", "sleep 0.1; echo out of order; exit 7", "rig")
    answers = desk.both("/compare", {"runs": ["mine-01", "mine-02"]})
    assert {words(answer) for answer in answers} == {
        "out of order",
        "another page is being made; try again in a few seconds",
    }


def test_the_list_can_be_chosen_and_names_its_constants(desk: Desk) -> None:
    def listed(query: str) -> dict[str, Any]:
        found = json.loads(desk.get("/recorded", query)[1])
        assert isinstance(found, dict)
        return found

    everything = listed("")
    assert (everything["count"], len(everything["runs"])) == (11, 11)
    assert everything["benches"] == ["mine", "other"]
    assert everything["constants"] == ["Mc", "Ms", "J"]
    found = {run["folder"]: run["identified"] for run in everything["runs"]}
    assert [folder for folder, known in found.items() if not known] == ["bare", "half"]
    able = {run["folder"] for run in everything["runs"] if run["comparable"]}
    assert able == {run["folder"] for run in everything["runs"]} - {"half"}
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
