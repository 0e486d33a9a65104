"""Result of a diagnosis: frozen records of the verdict, its evidence and the data of a report."""

from identification.diagnosis.result.records import (
    Curve as Curve,
)
from identification.diagnosis.result.records import (
    Diagnosis as Diagnosis,
)
from identification.diagnosis.result.records import (
    Estimate as Estimate,
)
from identification.diagnosis.result.records import (
    Fit as Fit,
)
from identification.diagnosis.result.records import (
    IdentifiedEffect as IdentifiedEffect,
)
from identification.diagnosis.result.records import (
    Location as Location,
)
from identification.diagnosis.result.records import (
    Map as Map,
)
from identification.diagnosis.result.records import (
    ResidualTrace as ResidualTrace,
)
from identification.diagnosis.result.records import (
    Rival as Rival,
)
from identification.diagnosis.result.records import (
    Shift as Shift,
)
from identification.diagnosis.result.records import (
    Step as Step,
)
from identification.diagnosis.result.records import (
    Verdict as Verdict,
)
