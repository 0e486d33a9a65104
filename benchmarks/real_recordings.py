"""The real recordings through the commands a user would type (docs/measurements.md)."""

from __future__ import annotations

import sys
from pathlib import Path

from rig.cli.entry import DONE, status

CAMPAIGNS = Path(__file__).resolve().parents[1] / "tests" / "campaigns"
OUT = Path("out/real")


def main() -> int:
    """Run every command, and end with the first status that is not 0."""
    OUT.mkdir(parents=True, exist_ok=True)
    fitted, published = OUT / "emps_fitted.json", CAMPAIGNS / "emps_published.json"
    commands: list[list[str | Path]] = [
        ["identify", CAMPAIGNS / "sts3032_to_heavy.yaml", "--ladder"],
        ["identify", CAMPAIGNS / "sts3032_to_light.yaml", "--ladder"],
        [
            "identify",
            CAMPAIGNS / "sts3032_to_heavy.yaml",
            "--score",
            CAMPAIGNS / "sts3032_to_light.yaml",
        ],
        ["identify", CAMPAIGNS / "emps.yaml", "--json", fitted],
        ["simulate", CAMPAIGNS / "emps.yaml", "--result", fitted, "--result", published],
        ["identify", CAMPAIGNS / "emps_pulses.yaml", "--score", CAMPAIGNS / "emps.yaml"],
    ]
    for drive in (1, 2):
        for way in ("", "_forward", "_backward"):
            commands.append(["identify", CAMPAIGNS / f"screw_drive_{drive}{way}.yaml"])
    for number, command in enumerate(commands):
        words = [str(word) for word in command]
        print(f"\n$ rig {' '.join(Path(w).name if '/' in w else w for w in words)}", flush=True)
        code = status([*words, "--out", str(OUT / f"{number:02d}")])
        if code != DONE:
            return code
    return DONE


if __name__ == "__main__":
    sys.exit(main())
