"""What ``import drivers`` changes outside of its own modules: nothing."""

import json
import subprocess
import sys
from pathlib import Path

_IMPORT = """
import importlib, json, pkgutil, sys
hooks, path_hooks, held = sys.meta_path[:], sys.path_hooks[:], dict(sys.modules)
import drivers
for module in pkgutil.walk_packages(drivers.__path__, "drivers."):
    if ".mock.plant" not in module.name:
        importlib.import_module(module.name)
import can
with can.Logger(sys.argv[1]) as log:
    log(can.Message(arbitration_id=0x181, data=b"12", timestamp=1.0))
print(json.dumps({
    "hooks": hooks == sys.meta_path and path_hooks == sys.path_hooks,
    "replaced": [name for name, module in held.items() if sys.modules.get(name) is not module],
    "hidden": [name for name, module in sys.modules.items() if module is None],
}))
"""


def test_other_libraries_work_as_without_it(tmp_path: Path) -> None:
    """python-can still writes MF4 files with asammdf."""
    log = tmp_path / "log.mf4"
    command = [sys.executable, "-c", _IMPORT, str(log)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["hooks"]
    assert found["replaced"] == []
    assert "asammdf" not in found["hidden"]
    assert log.stat().st_size > 1000
