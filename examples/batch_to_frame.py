"""A thousand slider-cranks at random: peak torque, stroke and peak acceleration of each in one data frame."""

import numpy as np
import pandas

import optlink

problem = optlink.load("slider-crank")
rng = np.random.default_rng(1)
designs = {
    "crank.length": rng.uniform(0.02, 0.06, 1000),  # m
    "rod.length": rng.uniform(0.12, 0.25, 1000),
}
columns = optlink.analyze_batch(problem, designs, ["input.torque_Nm", "slider.s_m", "slider.a_m_s2"])
frame = pandas.DataFrame(
    {
        **{f"{name}_m": values for name, values in designs.items()},
        "peak_torque_Nm": np.abs(columns["input.torque_Nm"]).max(axis=1),
        "stroke_m": np.ptp(columns["slider.s_m"], axis=1),
        "peak_acceleration_m_s2": np.abs(columns["slider.a_m_s2"]).max(axis=1),
    }
)
print(frame.describe().loc[["min", "mean", "max"]].to_string())
frame.to_csv("linkages.csv", index=False)

least = frame["peak_torque_Nm"].idxmin()
design = {name: float(values[least]) for name, values in designs.items()}
between = optlink.analyze(problem, design=design).extremes["input.torque_Nm"].largest
print(f"least peak torque {frame['peak_torque_Nm'][least]:.4f} N m; between the rows {between:.4f}")
