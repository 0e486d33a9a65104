"""Identify, diagnose and simulate campaigns; each printed error is that of the exported model.

python -m tests.long.one_model CAMPAIGN.yaml [CAMPAIGN.yaml ...]

For every campaign the commands run as a user starts them. The errors that `rig simulate` prints for
the files of `rig identify` and `rig diagnose` must be those that these commands printed, and the
constants of a diagnosis without effects must be those of the identification. The unseen error of
a corrected model must not be above that of the nominal model by more than a tenth, and *nothing is
missing* must not be said with an error above 1.5 noise floors or of a model that explains less than
half of the torque.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SAME, GROWN, FLOORS, EXPLAINED = 0.01, 1.1, 1.5, 0.5


def run_rig(*words: object) -> tuple[int, str]:
    """Run a command; return its status and output."""
    command = [sys.executable, "-c", "from rig.cli.entry import main; main()", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    return done.returncode, done.stdout + done.stderr


def simulated(source: Path, result: Path, folder: Path) -> list[Mapping[str, Any]]:
    """Return the equation errors of `rig simulate` with a result file."""
    out = folder / f"{result.stem}_simulated.json"
    run_rig("simulate", source, "--result", result, "--out", folder / "s", "--json", out)
    return list(json.loads(out.read_text())["equations"])


def differences(
    name: str, printed: Mapping[str, Any], again: Mapping[str, Any], keys: Mapping[str, str]
) -> Iterator[str]:
    for here, there in keys.items():
        first, second = printed[here], again[there]
        if first is None or second is None:
            if first is not second:
                yield f"{name}: {here} {first}, by rig simulate {second}"
        elif abs(first - second) > SAME * abs(first):
            yield f"{name}: {here} {first:.5g}, by rig simulate {second:.5g}"


def problems(source: Path, folder: Path) -> Iterator[str]:
    """Yield what is wrong; the last item is a summary that begins with a space."""
    identify, diagnose = folder / "identify.json", folder / "diagnose.json"
    code, words = run_rig("identify", source, "--out", folder / "i", "--json", identify)
    found: dict[str, Any] = {}
    if code == 0:
        found = json.loads(identify.read_text())
        torque = next(e for e in simulated(source, identify, folder) if e["equation"] == "torque")
        if found["fit"]["unit"] == torque["unit"]:
            keys = {"train_rms": "rms", "validate_rms": "validate_rms"}
            yield from differences("identify", found["fit"], torque, keys)
    code, words = run_rig("diagnose", source, "--out", folder / "d", "--json", diagnose)
    if code != 0:
        yield f" refused: {words.strip().splitlines()[-1][:120]}"
        return
    told = json.loads(diagnose.read_text())
    names = [e["name"] for e in told["effects"]]
    model = [*names, *(["curve"] if told["curve"] else [])]
    again = {e["equation"]: e for e in simulated(source, diagnose, folder) if e["effects"] == model}
    keys = {"final_rms": "rms", "validate_final_rms": "validate_rms"}
    for fit in told["fits"]:
        yield from differences(fit["equation"], fit, again[fit["equation"]], keys)
    if not names and found:
        for name, value in found["fitted"].items():
            if told["parameters"].get(name) != value:
                yield f"{name}: {value} by identify, {told['parameters'].get(name)} by diagnose"
    main = told["fit"]
    before, after = main["validate_baseline_rms"], main["validate_final_rms"]
    if before is not None and after > GROWN * before:
        yield f"unseen {main['equation']} error {before:.4g} -> {after:.4g}"
    if told["verdict"] == "nothing_missing":
        worst = max(f["final_rms"] / f["noise_floor_rms"] for f in told["fits"])
        if worst > FLOORS:
            yield f"nothing missing with {worst:.3g} noise floors"
        if (told["fits"][0]["relative"] or 0.0) ** 2 > 1.0 - EXPLAINED:
            yield "nothing missing, of a model that explains less than half"
    said = ", ".join(f"{e['name']} {e['confidence']:.2f}" for e in told["effects"])
    yield f" {told['verdict']} {said}"


def main() -> int:
    """Check campaigns; print a line for each, and what is wrong below it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("campaigns", nargs="+", type=Path)
    bad = 0
    chosen = parser.parse_args().campaigns
    for source in chosen:
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as name:
            *wrong, said = problems(source, Path(name))
        bad += bool(wrong)
        label = f"{source.parent.name}/{source.stem}"
        print(f"{label:40} {time.monotonic() - began:5.0f} s {said}", flush=True)
        for line in wrong:
            print(f"    {line}", flush=True)
    print(f"{len(chosen)} campaigns, {bad} with problems")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
