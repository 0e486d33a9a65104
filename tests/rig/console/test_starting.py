"""A run starts only after its dry run was shown, with the same files, and a REAL bench only by its
name.
"""

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from rig.config.configuration import packaged
from rig.console.starting import Starter, StartError, Wish

from .processes import SEQUENCE, wait_until

ECHO = (sys.executable, "-c", "import sys; print(*sys.argv[1:])")
REFUSED = (sys.executable, "-c", "print('a limit is looser than the drive'); raise SystemExit(2)")


@pytest.fixture
def real(tmp_path: Path) -> Path:
    """A bench file of a real bench."""
    text = packaged("practical", "benches").read_text()
    path = tmp_path / "real.yaml"
    path.write_text(text.partition("mock:")[0].replace("interface: mock", "interface: socketcan"))
    return path


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    path = tmp_path / "own.yaml"
    path.write_text(SEQUENCE.format(name="own", duration_s=2, heavy_s=2))
    return path


def shown(starter: Starter, wish: Wish) -> dict[str, Any]:
    return asyncio.run(starter.dry_run(wish))


def arguments(starter: Starter) -> list[str]:
    """The command line of the run that was started."""
    ((child, log),) = starter._children
    child.wait()
    words = log.read_text().split()
    assert not starter.failures()
    assert not log.exists()
    return words


def test_a_run_that_is_being_continued_is_not_continued_again(tmp_path: Path) -> None:
    wait = (sys.executable, "-c", "input()")
    starter = Starter(["practical"], tmp_path, wait)
    about = {"real": False, "bench": "b", "folder": str(tmp_path / "run")}
    spawned: list[list[str]] = []
    busy = True

    class Child:
        def poll(self) -> int | None:
            return None if busy else 2

    def spawn(arguments: list[str]) -> Any:
        spawned.append(arguments)
        return Child()

    starter._spawn = spawn  # type: ignore[method-assign]
    starter.resume(about, "")
    starter.resume(about, "")
    assert len(spawned) == 1
    # Another run, and the same run once its program has ended.
    starter.resume({**about, "folder": str(tmp_path / "other")}, "")
    busy = False
    starter.resume(about, "")
    assert [each[1] for each in spawned] == [str(tmp_path / n) for n in ("run", "other", "run")]


@pytest.mark.parametrize(("status", "proved"), [(0, True), (4, False), (2, False)])
def test_a_bench_is_made_safe_by_rig_off(tmp_path: Path, status: int, proved: bool) -> None:
    script = f"import sys; print(*sys.argv[1:]); raise SystemExit({status})"
    starter = Starter(["practical"], tmp_path, (sys.executable, "-c", script))

    async def twice() -> list[dict[str, Any]]:
        return await asyncio.gather(starter.off("my.yaml"), starter.off("my.yaml"))

    first, second = asyncio.run(twice())
    assert first == {"words": "off -- my.yaml", "proved": proved}
    # A second request waits for the first.
    assert second is first
    assert not starter._offs


def test_a_run_starts_once_as_it_was_shown(sequence: Path, tmp_path: Path) -> None:
    starter = Starter(["practical"], tmp_path / "runs", ECHO)
    found = shown(starter, Wish("practical", str(sequence), "A. Person", realtime=True))
    assert "--dry-run" in found["words"]
    assert starter.start(found["shown"], "").parent == tmp_path / "runs"
    given = arguments(starter)
    assert given[:6] == ["run", str(sequence), "--bench", "practical", "--console", "--out"]
    assert given[7:] == ["--realtime", "--operator", "A.", "Person"]
    for key in (found["shown"], "", "0" * 32):
        with pytest.raises(StartError, match="dry run first"):
            starter.start(key, "")


def test_changed_files_need_another_dry_run(sequence: Path, tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("acceptance: 1\nlimits: [lost samples < 1]\n")
    starter = Starter(["practical"], tmp_path / "runs", ECHO)
    wish = Wish("practical", str(sequence), acceptance=str(limits))
    found = shown(starter, wish)
    assert f"--acceptance {limits}" in found["words"]
    starter.start(found["shown"], "")
    given = arguments(starter)
    assert given[given.index("--acceptance") + 1] == str(limits)
    starter._children.clear()
    for file in (limits, sequence):
        found = shown(starter, wish)
        file.write_text(file.read_text() + "\n")
        with pytest.raises(StartError, match="changed since the dry run"):
            starter.start(found["shown"], "")
    assert not starter._children
    limits.unlink()
    assert shown(starter, wish)["shown"] is None


def test_a_run_that_fails_to_start_says_why(sequence: Path, tmp_path: Path) -> None:
    starter = Starter(["practical"], tmp_path / "runs", ECHO)
    found = shown(starter, Wish("practical", str(sequence)))
    starter.command = REFUSED
    starter.start(found["shown"], "")
    words: list[str] = []
    wait_until(lambda: words.extend(starter.failures()) or words)
    assert "status 2" in words[0]
    assert "looser than the drive" in words[0]


def test_a_real_bench_is_started_by_its_name(real: Path, sequence: Path, tmp_path: Path) -> None:
    starter = Starter([str(real)], tmp_path / "runs", ECHO)
    found = shown(starter, Wish(str(real), str(sequence), realtime=True, yes=True))
    assert found["real"]
    with pytest.raises(StartError, match="REAL bench, practical"):
        starter.start(found["shown"], "")
    starter.start(found["shown"], " practical ")
    given = arguments(starter)
    assert "--yes" not in given
    assert "--realtime" not in given


def test_a_stopped_run_goes_on_with_the_prompts_on_the_page(tmp_path: Path) -> None:
    starter = Starter(["practical"], tmp_path / "runs", ECHO)
    about = {"folder": str(tmp_path / "runs" / "stopped"), "bench": "practical", "real": True}
    with pytest.raises(StartError, match="REAL bench, practical"):
        starter.resume(about, "another")
    starter.resume(about, "practical", " Ada ")
    assert arguments(starter) == ["resume", about["folder"], "--console", "--operator", "Ada"]
    starter.resume(about, "practical")
    assert arguments(starter) == ["resume", about["folder"], "--console"]


def test_what_cannot_run_cannot_be_started(sequence: Path, tmp_path: Path) -> None:
    starter = Starter(["practical"], tmp_path / "runs", REFUSED)
    found = shown(starter, Wish("practical", str(sequence)))
    assert found["shown"] is None
    assert "looser" in found["words"]
    missing = shown(starter, Wish("practical", str(tmp_path / "nothing.yaml")))
    assert (missing["shown"], "no such file" in missing["words"]) == (None, True)
    with pytest.raises(StartError, match="this console was started without this bench"):
        shown(starter, Wish("practical_soft", str(sequence)))


@pytest.mark.parametrize(
    "message",
    [
        {},
        {"bench": "practical"},
        {"bench": "practical", "sequence": 1},
        {"bench": "practical", "sequence": "x", "more": 1},
        {"bench": "practical", "sequence": "--out"},
        {"bench": "practical", "sequence": "x", "yes": "no"},
        {"bench": "practical", "sequence": "x" * 600},
    ],
)
def test_broken_wishes_are_refused(message: dict[str, Any]) -> None:
    with pytest.raises(StartError):
        Wish.of(message)
