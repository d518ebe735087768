"""A thousand slider-cranks at random: peak torque, stroke and largest acceleration of each in one data frame."""

import numpy as np

import optlink

problem = optlink.load("slider-crank")
rng = np.random.default_rng(1)
designs = {
    "crank.length": rng.uniform(0.02, 0.06, 1000),  # m
    "rod.length": rng.uniform(0.12, 0.25, 1000),
}
columns = optlink.analyze_batch(problem, designs, ["input.torque_Nm", "slider.s_m", "slider.a_m_s2"])
frame = columns.to_frame()  # sizes, then the least, largest and rms value of each column
frame["peak_torque_Nm"] = np.abs(columns["input.torque_Nm"]).max(axis=1)
frame["stroke_m"] = frame["slider.s_m.max"] - frame["slider.s_m.min"]
print(frame[["peak_torque_Nm", "stroke_m", "slider.a_m_s2.max"]].describe().loc[["min", "mean", "max"]].to_string())
frame.to_csv("linkages.csv", index=False)

least = frame["peak_torque_Nm"].idxmin()
design = {name: float(values[least]) for name, values in designs.items()}
between = optlink.analyze(problem, design=design).extremes["input.torque_Nm"].largest
print(f"least peak torque {frame['peak_torque_Nm'][least]:.4f} N m; between the rows {between:.4f}")
