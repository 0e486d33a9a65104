"""Taking out what was found gives the nominal parameters back."""

import numpy as np
import pytest

from identification.effects.model import CorrectedModel, refit, without_effects
from identification.estimate.default import identify
from identification.recording import Bench, Dataset, Recording, RecordingError

BENCH = Bench(torque_constant=0.03, gear_ratio=100.0)
DRAG, SIDE = 4.0, 0.5
EFFECTS = {
    "quadratic_drag": {"coefficient_Nms2_rad2": DRAG},
    "current_offset": {"current_A": SIDE / 3.0},
}


def recording(name: str, pace: float) -> Recording:
    time = np.arange(4000) / 400.0
    angle, speed = 0.4 * np.sin(pace * time), 0.4 * pace * np.cos(pace * time)
    falling = 4.0 * np.exp(-((speed / 0.06) ** 2))
    torque = -0.2 * pace**2 * angle + np.sign(speed) * (6.0 + falling) + 5.0 * speed
    torque += DRAG * speed * np.abs(speed) + SIDE
    return Recording(time, angle, torque / 3.0, name=name, bench=BENCH)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset((recording("slow", 0.7), recording("fast", 2.3)))


def test_the_parameters_that_an_effect_had_bent_come_back(dataset: Dataset) -> None:
    bent = identify(dataset, bandwidth_Hz=20.0).values
    model = CorrectedModel(bent, 2.0, EFFECTS)
    found = refit(dataset, model, 20.0).values
    assert abs(bent["sigma_2"] - 5.0) > 0.5
    assert found["sigma_2"] == pytest.approx(5.0, rel=0.01)
    assert found["Mc"] == pytest.approx(6.0, rel=0.01)
    assert found["J"] == pytest.approx(0.2, rel=0.02)


def test_a_voltage_alone_is_refused(dataset: Dataset) -> None:
    bench = Bench(torque_constant=0.03, gear_ratio=100.0, resistance=1.5, back_emf_constant=0.03)
    channels = {name: v for name, v in dataset.recordings[0].channels.items() if name != "current"}
    channels["voltage"] = dataset.recordings[0].channels["current"]
    with pytest.raises(RecordingError, match="the recording has neither channel"):
        without_effects(
            [Recording(name="v", channels=channels, bench=bench)],
            CorrectedModel({"Mc": 6.0}, 2.0, EFFECTS),
            20.0,
        )
