"""Builds small FMUs from ``machines/nominal.c`` with the C compiler of the system."""

import platform
import subprocess
import zipfile
from pathlib import Path

_SOURCE = Path(__file__).parent / "machines" / "nominal.c"
VARIABLES = (
    ("voltage_V", "input"),
    ("mass_kg", "input"),
    ("motor_angle_rad", "output"),
    ("joint_angle_rad", "output"),
    ("motor_speed_rad_s", "output"),
    ("current_A", "output"),
)
_FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="machine" guid="{{m}}">
<{kind} modelIdentifier="machine"/>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>"""
_FMI3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="machine" instantiationToken="{{m}}">
<{kind} modelIdentifier="machine"/>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>"""


def build_fmu(
    path: Path,
    fmi: int = 2,
    renamed: dict[str, str] | None = None,
    kind: str = "CoSimulation",
    integer: str = "",
) -> Path:
    """Write an FMU with the machine of ``machines/nominal.py``.

    Args:
        path: The new file.
        fmi: Version of the interface, 2 or 3.
        renamed: New names of variables.
        kind: ``CoSimulation`` or ``ModelExchange``.
        integer: A variable that is declared as an integer.
    """
    library = path.with_suffix(".so")
    subprocess.run(
        ["cc", "-O2", "-shared", "-fPIC", f"-DFMI={fmi}", "-o", library, _SOURCE, "-lm"], check=True
    )
    rows, outputs = [], []
    for at, (name, causality) in enumerate((*VARIABLES, ("seed", "parameter"))):
        whole = name in ("seed", integer)
        shown = (renamed or {}).get(name, name)
        start = ' start="0"' if causality != "output" else ""
        vary = ' variability="fixed"' if causality == "parameter" else ""
        head = f'name="{shown}" valueReference="{at}" causality="{causality}"{vary}'
        if fmi == 2:
            inner = f"<{'Integer' if whole else 'Real'}{start}/>"
            rows.append(f"<ScalarVariable {head}>{inner}</ScalarVariable>")
        else:
            rows.append(f"<{'Int32' if whole else 'Float64'} {head}{start}/>")
        if causality == "output":
            outputs.append(
                f'<Unknown index="{at + 1}"/>' if fmi == 2 else f'<Output valueReference="{at}"/>'
            )
    if fmi == 3:
        rows.append('<Float64 name="time" valueReference="9" causality="independent"/>')
    text = (_FMI2 if fmi == 2 else _FMI3).format(
        kind=kind, variables="".join(rows), outputs="".join(outputs)
    )
    folder = "linux64" if fmi == 2 else f"{platform.machine()}-linux"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(library, f"binaries/{folder}/machine.so")
    return path
