"""How the optimum follows two limits: a sweep, its table, a chart of your own and the page of the study."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import optlink

OUT = Path("sweep")
OUT.mkdir(exist_ok=True)

problem = optlink.load("crank-rocker")
study = optlink.studies.sweep(
    problem,
    {"limits.transmission_angle.max": "130..150 deg:11", "mechanism.frame": np.array([0.48, 0.5, 0.52])},  # or SI values
)
table = study.to_frame()
print(f"{study.valid_points} of {len(table)} optima are valid; columns: {', '.join(table.columns[:6])}, ...")

figure, axes = plt.subplots(layout="constrained")
for frame, rows in table.groupby("mechanism.frame_m"):
    axes.plot(np.degrees(rows["limits.transmission_angle.max_rad"]), rows["objective_rad2"], label=f"frame {1e3 * frame:.0f} mm")
axes.set(xlabel="largest transmission angle [deg]", ylabel="objective [rad²]")
axes.legend()
figure.savefig(OUT / "objective.svg")

for name in study.plots:
    study.plot(name).savefig(OUT / f"{name}.svg")
table.to_csv(OUT / "table.csv", index=False)
optlink.report(study, OUT / "page.html", {"title": "Crank-rocker: price of the transmission angle"})
