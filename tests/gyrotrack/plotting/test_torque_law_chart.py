"""The unmodelled torque is drawn against the deflection of an oscillation, and against the speed of a rotation."""

from types import SimpleNamespace

import numpy as np

from gyrotrack.plotting._case_charts import torque_law_chart
from gyrotrack.plotting._study_data import Curve


def view(deflection):
    time = np.linspace(0, 10, 2000)
    torque = SimpleNamespace(
        time=time, torque=np.sin(3 * time) ** 3, sigma=np.full(2000, 0.01), omega_c=3 * np.cos(3 * time)
    )
    return SimpleNamespace(
        body="body",
        main="casing",
        bodies={"casing": "body"},
        torque_unit="rad/s²",
        models=(SimpleNamespace(torques={"casing": torque}),),
        added=None,
        alternatives=(),
        deflection=deflection,
    )


def test_a_restoring_law_is_a_curve_of_the_deflection():
    time = np.linspace(0, 10, 5000)
    chart = torque_law_chart(view(Curve(time, np.sin(3 * time), np.zeros(5000))))
    assert chart.name == "torque-deflection"
    for trace in chart.traces:  # to one side and back
        assert (np.diff(trace.x) > 0).all()
        cubic = trace.x**3
        factor = (trace.value @ cubic) / (cubic @ cubic)  # of the prefix of the unit
        np.testing.assert_allclose(trace.value, factor * cubic, atol=0.03 * factor)


def test_friction_is_a_curve_of_the_speed():
    chart = torque_law_chart(view(None))
    assert chart.name == "torque-speed"
    assert chart.x_label == "speed of the body [rad/s]"
