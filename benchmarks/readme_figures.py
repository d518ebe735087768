"""Figures that README and docs quote, each with its page, its words and the command that computes it.

`text` are words of the page with the figure in braces; `path` leads to the value in the JSON document of the command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A figure of a page: `scale * path`, or `scale * path / over`, within `near` or half a unit of its last digit.

    Of a `command` with " && " the last part prints the document.
    """

    page: str
    text: str
    command: str
    path: str
    scale: float = 1.0
    over: str = ""
    near: float = 0.0


@dataclass(frozen=True)
class Block:
    """A printed block of a page, named by words in it: every line is among those that the command prints."""

    page: str
    words: str
    command: str


LAW, ROBUST = "solve crank-rocker", "solve crank-rocker-robust"
SIX, SHAPER = "analyze six-bar", "analyze shaper"
FAST = 'analyze shaper --speed "64 rpm"'
BALANCE = "balance balance-six-bar"
COMPARE = "simulate slider-crank-three-gaps --control compare --revolutions 15"
DESIGN, PRESS = "solve shaper-design", "solve press-toggle"
PRICE = "limits/name=largest transmission angle/multiplier"
MEASURES = {
    "rms shaking force": (339.668, 93.7868, 72.39),
    "peak shaking force": (733.119, 161.064, 78.03),
    "rms shaking moment": (90.6044, 24.7473, 72.69),
    "peak shaking moment": (155.733, 38.5715, 75.23),
    "rms torque": (154.725, 132.717, 14.22),
    "peak torque": (320.022, 273.915, 14.41),
}


def row(page: str, cells: tuple[str, ...], command: str, columns: dict[int, tuple[str, float]]) -> list[Figure]:
    """Figures in a row of a table; `columns` has path and scale of the cells that are figures."""
    found = []
    for k, (path, scale) in columns.items():
        marked = [f"{{{cell}}}" if i == k else cell for i, cell in enumerate(cells)]
        unit = cells[k].partition(" ")
        if unit[1]:
            marked[k] = f"{{{unit[0]}}} {unit[2]}"
        found.append(Figure(page, f"| {' | '.join(marked)} |", command, path, scale))
    return found


def balancing() -> list[Figure]:
    """Measures of the six-bar, each minimised alone."""
    found = []
    for measure, (before, best, reduction) in MEASURES.items():
        unit = "N·m" if "moment" in measure or "torque" in measure else "N"
        text = (f"{before:g}", f"{best:g}", f"{reduction:.2f} %")
        command = f'{BALANCE} --minimise "{measure}"'
        columns = {1: ("before", 1.0), 2: ("objective", 1.0), 3: ("reduction", 100.0)}
        found += row("docs/balancing.md", (f"{measure}, {unit}", *text), command, columns)
    return found


def extremes(page: str, what: str, cells: tuple[str, ...], command: str, column: str) -> list[Figure]:
    """A row with the least and largest value of a column and their crank angles."""
    keys = ("min", "min_at_deg", "max", "max_at_deg")
    return row(page, (what, *cells), command, {k + 1: (f"extremes/{column}/{key}", 1.0) for k, key in enumerate(keys)})


def case(name: str, words: str, value: str, known: str, scale: float = 1.0) -> list[Figure]:
    """A row of the public cases; tests/test_problems.py solves each problem and compares with `expected` of its file."""
    cells = (f"`{name}`", words, value, known)
    return row("docs/synthesis.md", cells, f"show {name}", {2: ("problem/expected/objective", scale)})


DEGREES, SQUARE_MM = 57.29577951308232, 1e6
CASES = [
    *case("path-arc5", "arc of 5 points, timed", "7.4158e-7 mm^2", "7.4158e-7 mm^2", SQUARE_MM),
    *case("path-bean", "36 points from expressions", "0.68769 mm^2", "", SQUARE_MM),
    *case("path-conveyor", "7 timed points within 1 mm, and a return path", "9.9015 mm^2", "", SQUARE_MM),
    *case("path-slider-egg", "24 points by a slider-crank", "2.6089 mm^2", "", SQUARE_MM),
    *case("path-stephenson-dwell", "dwell over 100 deg, Stephenson III", "0.0032925 mm^2", "", SQUARE_MM),
    *case("path-ellipse10", "ellipse of 10 points, untimed", "4.0199e-4 mm^2", "4.0199e-4 mm^2", SQUARE_MM),
    *case("function-log10", "log10 x, 1 ... 2, 60/60 deg", "0.003670 deg", "0.003676 deg", DEGREES),
    *case("function-sin", "sin x, 0 ... 90 deg, 90/90 deg", "0.190275 deg", "0.190337 deg", DEGREES),
    *case("function-exp", "exp x, 0 ... 1, 90/90 deg", "0.025854 deg", "0.025865 deg", DEGREES),
]

PAGE = "docs/crank-rocker.md"
OPTIMUM = ("optlink, both back ends", "412.86542", "232.24617", "0.00759237", "$`\\gamma_\\text{max}`$ = 135 deg")
PRINTED = 'validate crank-rocker --design coupler="412.26 mm" --design rocker="232.2417 mm"'
ROUNDED = f"""{LAW} --set 'limits={{crank="full rotation", transmission_cosine=[-0.707, 0.707]}}'"""
ROUNDED_ANGLE = f'{LAW} --set limits.transmission_angle.max="134.99135 deg"'
SHORTER = f'{LAW} --set requirement.points=29 --set requirement.span="87 deg"'
ANYWHERE = """ --set requirement.from='{start="60 deg", bounds=["0 deg", "180 deg"]}'"""
ANY_FRAME = """ --set mechanism.frame='{start="500 mm", bounds=["100 mm", "900 mm"]}'"""
LONG_FRAME = (
    """ --set mechanism.frame='{start="500 mm", bounds=["100 mm", "2000 mm"]}'"""
    """ --set mechanism.coupler.bounds='["100 mm", "2000 mm"]' --set mechanism.rocker.bounds='["100 mm", "2000 mm"]'"""
)
METRES = (
    f'{LAW} --set mechanism.crank="1 m" --set mechanism.frame="5 m"'
    """ --set mechanism.coupler='{start="4 m", bounds=["1 m", "9 m"]}'"""
    """ --set mechanism.rocker='{start="4 m", bounds=["1 m", "9 m"]}'"""
)
INEQUALITIES = {
    "crank <= coupler": "312.865",
    "crank <= rocker": "132.246",
    "crank <= frame": "400",
    "crank + frame <= coupler + rocker": "45.062",
    "crank + coupler <= rocker + frame": "219.339",
    "crank + rocker <= coupler + frame": "580.596",
    "smallest transmission angle": "70.379",
    "largest transmission angle": "135.000",
}
CRANK_ROCKER = [
    *row(PAGE, OPTIMUM, LAW, {1: ("design/coupler_mm", 1.0), 2: ("design/rocker_mm", 1.0), 3: ("objective/value", 1.0)}),
    Figure(PAGE, "lowers $`f`$ by {0.000146} rad²", LAW, PRICE, -1.0),
    Figure(PAGE, "by 0.000146 rad² ({1.9} %)", LAW, PRICE, -100.0, over="objective/value"),
    Figure(PAGE, "| 412.26 | 232.2417 | {0.0075491} |", PRINTED, "objective/value"),
    Figure(PAGE, "= {135.298} deg |", PRINTED, "validation/name=largest transmission angle/value"),
    Figure(PAGE, "| {412.88606} | 232.24298 | 0.00759364 |", ROUNDED, "design/coupler_mm"),
    Figure(PAGE, "| 412.88606 | {232.24298} | 0.00759364 |", ROUNDED, "design/rocker_mm"),
    Figure(PAGE, "| 412.88606 | 232.24298 | {0.00759364} |", ROUNDED, "objective/value"),
    Figure(PAGE, "result `phi0` | `optlink solve crank-rocker` | {26.472} deg", LAW, "design/phi0_deg"),
    Figure(PAGE, "result `psi0` | `optlink solve crank-rocker` | {100.145} deg", LAW, "design/psi0_deg"),
    Figure(PAGE, "as shipped | `optlink solve crank-rocker` | {0.00759237} rad²", LAW, "objective/value"),
    Figure(PAGE, "`requirement.measure` | `optlink solve crank-rocker` | {0.00759237} rad²", LAW, "objective/value"),
    Figure(PAGE, "`design` | `optlink solve crank-rocker` | {412.86542} and", LAW, "design/coupler_mm"),
    Figure(PAGE, "| 412.86542 and {232.24617} mm", LAW, "design/rocker_mm"),
    Figure(PAGE, "`optlink solve crank-rocker --backend both` | {412.86542} mm", LAW, "design/coupler_mm"),
    Figure(PAGE, 'rocker="232.2417 mm"` | {0.00754909} rad²', PRINTED, "objective/value"),
    Figure(PAGE, '"134.99135 deg"` | {412.88605} and 232.24298 mm', ROUNDED_ANGLE, "design/coupler_mm"),
    Figure(PAGE, '"134.99135 deg"` | 412.88605 and {232.24298} mm', ROUNDED_ANGLE, "design/rocker_mm"),
    *(
        Figure(PAGE, f"`{name}` | `optlink solve crank-rocker --json` | {{{value}}}", LAW, f"limits/name={name}/value")
        for name, value in INEQUALITIES.items()
    ),
    Figure(PAGE, "| {0.00164188} rad² |", f"{LAW} --starts 8{ANYWHERE}{ANY_FRAME}", "objective/value"),
    Figure(PAGE, "| {0.00590805} rad² |", f"{LAW} --starts 8{ANY_FRAME}", "objective/value"),
    Figure(PAGE, "with 2000 mm {0.00504} (", f"{LAW} --starts 8{LONG_FRAME}", "objective/value"),
    Figure(PAGE, "| {0.0019916} |", f"{LAW} --starts 8{ANYWHERE}", "objective/value"),
    Figure(PAGE, "$`\\varphi_0`$ = {15.2} deg", f"{LAW} --starts 8{ANYWHERE}", "design/phi0_deg"),
    Figure(PAGE, "$`f`$ is {0.00577} rad²", SHORTER, "objective/value"),
    Figure(PAGE, "| {4.1286542} and 2.3224617 m |", METRES, "design/coupler_mm", 1e-3),
    Figure(PAGE, "| 4.1286542 and {2.3224617} m |", METRES, "design/rocker_mm", 1e-3),
    Figure(
        PAGE,
        "`optlink solve path-crank-rocker` | {12.3445} mm²",
        "show path-crank-rocker",
        "problem/expected/objective",
        SQUARE_MM,
    ),
]

SYSTEMS = [
    *extremes(
        "docs/six-bar.md", "driving torque M1, N·m", ("-320.0521", "356.308", "278.8344", "67.021"), SIX, "input.torque_Nm"
    ),
    *extremes("docs/six-bar.md", "guide force RF, N", ("-1159.2707", "25.192", "-126.6225", "194.130"), SIX, "F.normal_N"),
    *extremes(
        "docs/six-bar.md", "work W1 since the start, J", ("-101.9271", "28.849", "259.7739", "156.298"), SIX, "input.work_J"
    ),
    *extremes("docs/six-bar.md", "slide s, m", ("0.417262", "200.364", "0.791166", "29.686"), SIX, "slider.s_m"),
    Figure("docs/six-bar.md", "The stroke is {373.90416} mm", SIX, "strokes/slider/span_m", 1e3),
    Figure("docs/six-bar.md", "= {747.808317} J", f"{SIX} --set loads.process.acts=opposing", "work_J"),
    Figure("docs/six-bar.md", "W1 = {225.034} J", "simulate six-bar", "figures/input.work_J"),
    Figure("docs/shaper.md", "| work per revolution, J | {3207.2727} | 3207.2727 |", SHAPER, "work_J"),
    Figure("docs/shaper.md", "| work per revolution, J | 3207.2727 | {3207.2727} |", FAST, "work_J"),
    Figure("docs/shaper.md", "| driving torque, N·m | {-25.852} ...", SHAPER, "extremes/input.torque_Nm/min"),
    Figure("docs/shaper.md", "-25.852 ... {1105.743} |", SHAPER, "extremes/input.torque_Nm/max"),
    Figure("docs/shaper.md", "| {-700.271} ... 1107.997 |", FAST, "extremes/input.torque_Nm/min"),
    Figure("docs/shaper.md", "| -700.271 ... {1107.997} |", FAST, "extremes/input.torque_Nm/max"),
    Figure("docs/shaper.md", "| largest speed of the ram, m/s | {0.50088} | 3.35691 |", SHAPER, "extremes/ram.v_m_s/max"),
    Figure("docs/shaper.md", "| largest speed of the ram, m/s | 0.50088 | {3.35691} |", FAST, "extremes/ram.v_m_s/max"),
    Figure("docs/machine-design.md", "needs {989.6} N·m", DESIGN, "figures/name=objective 1/result"),
    Figure("docs/machine-design.md", "The optimum needs {297.4} N·m", "show press-toggle", "problem/expected/objective"),
    Figure("docs/balancing.md", "{0.01102811} N.", "balance balance-four-bar", "before"),
]

BESIDE = {
    "crank` | `show shaper` | {125} mm": ("sizes/crank.length", 1e3),
    "rocker` | `show shaper` | {600} mm": ("sizes/rocker.length", 1e3),
    "coupler` | `show shaper` | {150} mm": ("sizes/coupler.length", 1e3),
    "A.y` | `show shaper` | {275} mm": ("sizes/A.y", 1e3),
    "F.y` | `show shaper` | {575} mm": ("sizes/F.y", 1e3),
    "cutting.fx_N` | `analyze shaper` | {5880} N": ("extremes/cutting.fx_N/max", 1.0),
    "rocker.angle_rad` | row 1 | {65.5560} deg": ("columns/rocker.angle_rad/0", DEGREES),
    "block.s_m` | row 1 | {302.0761} mm": ("columns/block.s_m/0", 1e3),
    "coupler.angle_rad` | row 1 | {168.9382} deg": ("columns/coupler.angle_rad/0", DEGREES),
    "ram.s_m` | row 1 | {101.0686} mm": ("columns/ram.s_m/0", 1e3),
    "rocker.omega_rad_s` | row 1 | {0.171233} rad/s": ("columns/rocker.omega_rad_s/0", 1.0),
    "coupler.omega_rad_s` | row 1 | {0.288792} rad/s": ("columns/coupler.omega_rad_s/0", 1.0),
    "block.v_m_s` | row 1 | {0.113796} m/s": ("columns/block.v_m_s/0", 1.0),
    "ram.v_m_s` | row 1 | {-0.101842} m/s": ("columns/ram.v_m_s/0", 1.0),
    "rocker.alpha_rad_s2` | row 1 | {0.247701} rad/s²": ("columns/rocker.alpha_rad_s2/0", 1.0),
    "coupler.alpha_rad_s2` | row 1 | {0.292663} rad/s²": ("columns/coupler.alpha_rad_s2/0", 1.0),
    "block.a_m_s2` | row 1 | {-0.042868} m/s²": ("columns/block.a_m_s2/0", 1.0),
    "ram.a_m_s2` | row 1 | {-0.138724} m/s²": ("columns/ram.a_m_s2/0", 1.0),
    "ram.s_m`, largest | `analyze shaper` | {128.3167} mm": ("extremes/ram.s_m/max", 1e3),
    "ram.s_m`, least | `analyze shaper` | {-417.1378} mm": ("extremes/ram.s_m/min", 1e3),
    "span | `analyze shaper` | {545.4545} mm": ("strokes/ram/span_m", 1e3),
    "reverses | `analyze shaper` | {332.9643}, 207.0357 deg": ("strokes/ram/dead_centres_deg/1", 1.0),
    "reverses | `analyze shaper` | 332.9643, {207.0357} deg": ("strokes/ram/dead_centres_deg/0", 1.0),
    "swings | `analyze shaper` | {62.9643}, 117.0357 deg": ("swings/rocker/low_rad", DEGREES),
    "swings | `analyze shaper` | 62.9643, {117.0357} deg": ("swings/rocker/high_rad", DEGREES),
    "time ratio | `analyze shaper` | {1.858762} |": ("strokes/ram/time_ratio", 1.0),
    "input.torque_inertia_Nm` | row 1 | {1.00006} N·m": ("columns/input.torque_inertia_Nm/0", 1.0),
    "input.torque_Nm` | row 1 | {604.6240} N·m": ("columns/input.torque_Nm/0", 1.0),
    "A.fy_N` are F61 | row 1 | {-10641.382}, 4836.992 N": ("columns/A.fx_N/0", 1.0),
    "A.fy_N` are F61 | row 1 | -10641.382, {4836.992} N": ("columns/A.fy_N/0", 1.0),
    "B.fy_N` are F12 | row 1 | {-10641.382}, 4836.992 N": ("columns/B.fx_N/0", 1.0),
    "B.fy_N` are F12 | row 1 | -10641.382, {4836.992} N": ("columns/B.fy_N/0", 1.0),
    "G.normal_N` is F32 | row 1 | {-11689.119} N": ("columns/G.normal_N/0", 1.0),
    "C.fy_N` are F63 | row 1 | {4750.933}, -3474.542 N": ("columns/C.fx_N/0", 1.0),
    "C.fy_N` are F63 | row 1 | 4750.933, {-3474.542} N": ("columns/C.fy_N/0", 1.0),
    "D.fy_N` are F34 | row 1 | {-5889.023}, 1165.995 N": ("columns/D.fx_N/0", 1.0),
    "D.fy_N` are F34 | row 1 | -5889.023, {1165.995} N": ("columns/D.fy_N/0", 1.0),
    "E.fy_N` are F45 | row 1 | {-5888.601}, 1136.527 N": ("columns/E.fx_N/0", 1.0),
    "E.fy_N` are F45 | row 1 | -5888.601, {1136.527} N": ("columns/E.fy_N/0", 1.0),
    "F.normal_N` | row 1 | {-528.927} N": ("columns/F.normal_N/0", 1.0),
    "F.moment_Nm` | row 1 | {0} N·m": ("columns/F.moment_Nm/0", 1.0),
    "shaper --out out` | {-13225.47} ...": ("extremes/A.fx_N/min", 1.0),
    "shaper --out out` | {-4923.56} ... 6749.10 N": ("extremes/A.fy_N/min", 1.0),
    "shaper --out out` | -4923.56 ... {6749.10} N": ("extremes/A.fy_N/max", 1.0),
    "| {-0.18820} m/s at 97.84 deg,": ("extremes/ram.v_m_s/min", 1.0),
    "| -0.18820 m/s at {97.84} deg,": ("extremes/ram.v_m_s/min_at_deg", 1.0),
    "97.84 deg, {0.50088} m/s at": ("extremes/ram.v_m_s/max", 1.0),
    "0.50088 m/s at {268.58} deg": ("extremes/ram.v_m_s/max_at_deg", 1.0),
    "| {0.71625} m/s² at 246.60 deg,": ("extremes/ram.a_m_s2/max", 1.0),
    "| 0.71625 m/s² at {246.60} deg,": ("extremes/ram.a_m_s2/max_at_deg", 1.0),
    "246.60 deg, {-0.58193} m/s² at": ("extremes/ram.a_m_s2/min", 1.0),
    "-0.58193 m/s² at {293.86} deg": ("extremes/ram.a_m_s2/min_at_deg", 1.0),
    "torque.png` | `analyze shaper --out out` | {-25.852} ...": ("extremes/input.torque_Nm/min", 1.0),
    "torque.png` | `analyze shaper --out out` | -25.852 ... {1105.743}": ("extremes/input.torque_Nm/max", 1.0),
}
"""Values beside those of the document of the shaper, by their words in the table."""
SYSTEMS += [Figure("docs/shaper.md", text, SHAPER, path, scale) for text, (path, scale) in BESIDE.items()]

CHINESE = [
    Figure("README.zh.md", "连杆 {412.865} mm", LAW, "design/coupler_mm"),
    Figure("README.zh.md", "摇杆 {232.246} mm", LAW, "design/rocker_mm"),
    Figure("README.zh.md", "驱动力矩 {-320.05} 至", SIX, "extremes/input.torque_Nm/min"),
    Figure("README.zh.md", "至 {278.83} N·m", SIX, "extremes/input.torque_Nm/max"),
    Figure("README.zh.md", "行程 {545.4545} mm", SHAPER, "strokes/ram/span_m", 1e3),
    Figure("README.zh.md", "每转的功 {3207.27} J", SHAPER, "work_J"),
    Figure("README.zh.md", "（均方根）{0.465} mm", "simulate slider-crank-clearance", "figures/rms_m", 1e3),
]

FRONT = 'study pareto crank-rocker --objectives "error, limits.transmission_angle.max" --points 25'
ENDS = (
    (0, "decreases from {178.5} deg", "largest_transmission_angle_rad", 180 / math.pi),
    (19, "deg to {92.7} deg,", "largest_transmission_angle_rad", 180 / math.pi),
    (0, "steadily from {0.00350} rad²", "error_rad2", 1.0),
    (19, "rad² to {0.01461} rad²", "error_rad2", 1.0),
    (24, "increases to {0.473} rad²", "error_rad2", 1.0),
    (24, "at {70.1} deg", "largest_transmission_angle_rad", 180 / math.pi),
    (20, "The knee is the point at {88.2} deg", "largest_transmission_angle_rad", 180 / math.pi),
    (20, "deg, with {0.0248} rad²", "error_rad2", 1.0),
)
SHAPER_FRONT = 'study pareto shaper-design --objectives "peak torque, guide force in F=1300..1620 N"'
FRONTS = [
    *(Figure("docs/pareto.md", text, FRONT, f"front/{k}/objectives/{name}", scale) for k, text, name, scale in ENDS),
    Figure("docs/pareto.md", "increases from {985.9} N·m", SHAPER_FRONT, "front/0/objectives/peak_torque_Nm"),
    Figure("docs/pareto.md", "N·m to {995.6} N·m, almost linearly", SHAPER_FRONT, "front/14/objectives/peak_torque_Nm"),
    Figure("docs/pareto.md", "The initial machine ({1015.4} N·m", SHAPER_FRONT, "reference/peak_torque_Nm"),
    Figure("docs/pareto.md", "N·m, {1619} N) lies far", SHAPER_FRONT, "reference/peak_guide_force_in_F_N"),
]

YIELD = "study tolerance {} --robust {}"
PARTS = '--tolerance crank="0.2 mm" --tolerance coupler="0.2 mm" --limit "{}"'
LAW_PARTS = (
    '--tolerance crank="0.5 mm" --tolerance coupler="1 mm" --tolerance rocker="0.8 mm uniform" '
    '--tolerance C.clearance="0.2 mm" --limit "1.8 deg"'
)
YIELDS = {
    "`crank-rocker`, the tolerances above, 1.8 deg": ("crank-rocker " + LAW_PARTS, "0.0 %", "99.6 %", "99.6 %"),
    "`function-sin`, ± 0.2 mm on crank and coupler, 0.3 deg": (
        "function-sin " + PARTS.format("0.3 deg"),
        "61.1 %",
        "68.9 %",
        "69.7 %",
    ),
    "`function-log10`, the same, 0.05 deg": ("function-log10 " + PARTS.format("0.05 deg"), "98.1 %", "97.5 %", "98.5 %"),
}


def yields() -> list[Figure]:
    """Yields of the nominal and of two robust designs."""
    nominal, share = "robust/monte_carlo_of_the_nominal_design/yield", "monte_carlo/yield"
    found = []
    for words, (command, *cells) in YIELDS.items():
        margin, most = (YIELD.format(command, kind) for kind in ("margin", "yield"))
        found += row("docs/tolerance.md", (words, *cells), margin, {1: (nominal, 100.0), 2: (share, 100.0)})
        found += row("docs/tolerance.md", (words, *cells), most, {3: (share, 100.0)})
    return found


RUNS = (
    ("none", "1.307", 0.002, "100", 0.0),
    ("inverse", "0.914", 0.002, "69.9", 0.2),
    ("pid", "1.10", 0.02, "84", 2.0),
    ("inverse+pid", "0.77", 0.03, "59", 2.5),
)
CONTROL = [
    *(
        Figure("docs/clearance.md", f"| `{kind}` | {{{rms}}} |", COMPARE, f"trials/{kind}/mean", 1e3, near=near)
        for kind, rms, near, *_ in RUNS
    ),
    *(
        Figure(
            "docs/clearance.md",
            f"| `{kind}` | {rms} | {{{share}}} % |",
            COMPARE,
            f"trials/{kind}/mean",
            100.0,
            over="trials/none/mean",
            near=near,
        )
        for kind, rms, _, share, near in RUNS
    ),
]
"""The motion with a PID is sensitive to rounding errors: its tolerance is that of runs on several machines."""

GAPS = "simulate slider-crank-three-gaps --revolutions 11"
SPEEDS = (("none", ("1.306", "1.313", "1.319")), ("inverse", ("0.914", "0.926", "0.992")))
EFFECTS = {
    "none | `none`": (GAPS, ("1.31", "1.63", "7.9"), (0.0, 0.0, 0.0)),
    '`regularisation = "1 mm"` | `inverse`': (
        f"{GAPS} --control inverse --set 'control.regularisation=\"1 mm\"'",
        ("0.89", "1.52", "8.3"),
        (0.0, 0.0, 0.0),
    ),
    'the same, `bandwidth = "300 Hz"` | `inverse`': (
        f"{GAPS} --control inverse --set 'control.regularisation=\"1 mm\"' --set 'control.bandwidth=\"300 Hz\"'",
        ("0.62", "1.5", "23"),
        (0.03, 0.15, 5.0),
    ),
    "`proportional = 1.0`, `integral = 300.0` | `inverse+pid`": (
        f"{GAPS} --control inverse+pid --set control.proportional=1.0 --set control.integral=300.0",
        ("1.4", "3.0", "300"),
        (0.1, 0.4, 30.0),
    ),
}
MEASURED = (("rms_m", 1e3), ("peak_m", 1e3), ("torque_rms_Nm", 1.0))


def compensation() -> list[Figure]:
    """Deviation of the slider-crank with three gaps by speed, and by the parameters of its control."""
    page, found = "docs/clearance.md", []
    for kind, values in SPEEDS:
        for k, speed in enumerate((1200, 1500, 1800)):
            text = f"| `{kind}` | {' | '.join([*values[:k], f'{{{values[k]}}}', *values[k + 1 :]])} |"
            found.append(Figure(page, text, f'{GAPS} --speed "{speed} rpm" --control {kind}', "figures/rms_m", 1e3))
    for change, (command, values, nears) in EFFECTS.items():
        for k, ((name, scale), near) in enumerate(zip(MEASURED, nears, strict=True)):
            text = f"| {change} | {' | '.join([*values[:k], f'{{{values[k]}}}', *values[k + 1 :]])} |"
            found.append(Figure(page, text, command, f"figures/{name}", scale, near=near))
    return found


SLIDING = "simulate slider-crank-clearance --revolutions 25"
SINGLE = {
    "friction 0.1, revolutions 6 ... 25": (("0.46499", "0.46525", "0.46552", "0.47234"), "", 0.0),
    "friction 0, the same, chaotic: other starts differ by some 0.01": (
        ("0.39", "0.39", "0.39", "0.41"),
        " --set joints.C.friction=0",
        0.02,
    ),
}


def single_gap() -> list[Figure]:
    """Deviation of the slider-crank with one gap by speed and friction."""
    found = []
    for words, (values, option, near) in SINGLE.items():
        for k, speed in enumerate((1200, 1500, 1800, 5000)):
            cells = [*values[:k], f"{{{values[k]}}}", *values[k + 1 :]]
            command = f'{SLIDING} --speed "{speed} rpm"{option}'
            found.append(
                Figure("docs/clearance.md", f"| {words} | {' | '.join(cells)} |", command, "figures/rms_m", 1e3, near=near)
            )
    return found


SLIDER = "docs/slider-crank.md"
MACHINE = "simulate slider-crank-three-gaps --revolutions 15 --csv machine.csv"
MODEL = "simulate slider-crank-clearance --revolutions 15 --measured machine.csv --set measured.column=slider.s"
SPEEDS_MINUS = {speed: f'{MACHINE} --speed "{speed} rpm" && {MODEL} --speed "{speed} rpm"' for speed in (1200, 1500, 1800)}
"""The machine with three gaps minus the model with one."""
INFORMED = """simulate slider-crank-three-gaps --control inverse --revolutions 15 --set 'control.known=["A","B","C"]'"""
ERRORS = "other starts and integrators differ by 0.005 |"


def document() -> list[Figure]:
    """Values beside those of the document on the slider-crank; with three gaps the motion is sensitive to rounding errors."""
    plain, minus = "simulate slider-crank-clearance", list(SPEEDS_MINUS.values())
    found = [
        Figure(SLIDER, "| `simulate one` | {6.6102e10} (SI) |", plain, "gaps/0/stiffness"),
        Figure(SLIDER, "| {5.08} N·m rms |", plain, "figures/torque_rms_Nm"),
        Figure(SLIDER, "| {100} % of a late revolution |", plain, "per_revolution/C.contact_share/19", 100.0),
        Figure(SLIDER, "| the two commands above | {0.854} mm |", minus[0], "figures/measured.rms_m", 1e3, near=0.005),
        Figure(SLIDER, "| {0.854} of 1.303 mm |", minus[0], "figures/measured.rms_m", 1e3, near=0.005),
        Figure(SLIDER, "| 0.854 of {1.303} mm |", minus[0], "figures/measured.ideal.rms_m", 1e3, near=0.005),
        Figure(SLIDER, "| {0.67} mm | done here |", INFORMED, "figures/rms_m", 1e3, near=0.06),
        Figure(SLIDER, f"{ERRORS} {{0.854}} | 0.865 | 0.869 |", minus[0], "figures/measured.rms_m", 1e3, near=0.005),
        Figure(SLIDER, f"{ERRORS} 0.854 | {{0.865}} | 0.869 |", minus[1], "figures/measured.rms_m", 1e3, near=0.005),
        Figure(SLIDER, f"{ERRORS} 0.854 | 0.865 | {{0.869}} |", minus[2], "figures/measured.rms_m", 1e3, near=0.005),
        Figure(SLIDER, "| {1.307} and 1.63 mm |", COMPARE, "trials/none/mean", 1e3, near=0.002),
        Figure(SLIDER, "| 1.307 and {1.63} mm |", COMPARE, "trials/none/peak/0", 1e3, near=0.02),
        Figure(SLIDER, "| {0.914} mm, 69.9 % of no control |", COMPARE, "trials/inverse/mean", 1e3, near=0.002),
        Figure(
            SLIDER,
            "| 0.914 mm, {69.9} % of no control |",
            COMPARE,
            "trials/inverse/mean",
            100.0,
            over="trials/none/mean",
            near=0.2,
        ),
        Figure(SLIDER, "| the comparison above | {0.77} mm |", COMPARE, "trials/inverse+pid/mean", 1e3, near=0.03),
        Figure(SLIDER, "PID alone: {1.10} mm |", COMPARE, "trials/pid/mean", 1e3, near=0.02),
    ]
    values = ("0.46499", "0.46525", "0.46552")
    for k, speed in enumerate((1200, 1500, 1800)):
        cells = ", ".join([*values[:k], f"{{{values[k]}}}", *values[k + 1 :]])
        found.append(Figure(SLIDER, f"| {cells} mm |", f'{SLIDING} --speed "{speed} rpm"', "figures/rms_m", 1e3))
    return found


FIGURES = [
    *CRANK_ROCKER,
    *SYSTEMS,
    *CHINESE,
    *CASES,
    *FRONTS,
    *yields(),
    *CONTROL,
    *compensation(),
    *single_gap(),
    *document(),
    *balancing(),
]

BLOCKS = [
    Block("README.md", "Crank-rocker that reproduces", LAW),
    Block("README.zh.md", "Crank-rocker that reproduces", LAW),
    Block("docs/studies.md", "Sensitivity to prescribed values", "study sensitivity crank-rocker --check"),
    Block("docs/studies.md", "cutting.force 5880 N + 1 %", "study sensitivity shaper-design --check"),
    Block(
        "docs/tolerance.md",
        "Minimised: the largest error",
        'study tolerance crank-rocker --tolerance crank="0.5 mm" --tolerance coupler="1 mm" '
        '--tolerance rocker="0.8 mm uniform" --tolerance C.clearance="0.2 mm" --limit "1.8 deg" --robust 3',
    ),
    Block(
        "docs/tolerance.md",
        "Variance contributions",
        'study tolerance crank-rocker --tolerance crank="0.05 mm" --tolerance coupler="0.1 mm" '
        '--tolerance rocker="0.1 mm uniform" --tolerance D.x="0.1 mm" --tolerance D.y="0.05 mm" '
        '--tolerance C.clearance="0.03 mm" --limit "2.32 deg" --allocate "99 %" --cost coupler=3',
    ),
    Block("docs/tolerance.md", "largest error with 3 sigma", ROBUST),
    Block("docs/clearance.md", "Slider-crank with clearance at", "simulate slider-crank-clearance"),
    Block("docs/clearance.md", "control [deg] scatter peak", "simulate crank-rocker-clearance --control compare --starts 3"),
]

LONG = {
    *(YIELD.format(command, kind) for command, *_ in YIELDS.values() for kind in ("margin", "yield")),
    COMPARE,
    MACHINE,
    MODEL,
    'study sweep slider-crank-clearance --vary "drive.speed=1200..1800 rpm:3" --simulate --out speeds',
    *(figure.command for figure in (*compensation(), *single_gap(), *document())),
    SHAPER_FRONT,
    DESIGN,
    "simulate slider-crank-clearance",
    "simulate crank-rocker-clearance --control compare --starts 3",
    "study sensitivity shaper-design --check",
    "solve path-bean --designs 5 --starts 5000",
    'solve law-slider-crank --certify --gap 1e-3 --time-limit "5 min"',
    "solve path-arc5 --certify --gap 1e-3",
    "solve path-closed18 --certify --gap 1e-3",
    'study pareto shaper-design --objectives "peak torque, guide force in F=1300..1620 N" --workers 2 --out shaper-front',
    'study sweep crank-rocker --vary mechanism.frame="450..550 mm:100" '
    '--vary limits.transmission_angle.max="125..140 deg:100" --workers 2 --out map',
    'simulate slider-crank-clearance --speed "5000 rpm" --revolutions 25 --csv rows.csv --out out',
    'simulate slider-crank-clearance --speed "5000 rpm" --out play',
    "simulate slider-crank-clearance --set joints.C.friction=0",
    "simulate slider-crank-clearance --control inverse+pid",
    "solve shaper-design --backend both --out shaper/",
    "analyze shaper/design.toml",
    'study pareto crank-rocker --objectives "error, limits.transmission_angle.max, coupler" --points 9 --out three',
    "simulate whitworth --set "
    """'joints.E={clearance="0.5 mm", bearing_radius="10 mm", modulus="207 GPa", friction=0.1}'""",
}
"""Commands that take more than a few seconds: `readme_record.json` has their figures with the date."""

PLACEHOLDERS = {
    "optlink balance mine.toml --design result.json",
    'optlink new --from "https://app.pmksplus.com/?2P.Ay..." --out mine.toml',
    "optlink new --from walker.linkage2 --out walker.toml",
}
"""Commands with files of the reader."""

SERVER = "optlink studio"
"""Begins commands that end with Ctrl-C alone; the tests of the studio run it."""

PREPARED = {
    "docs/reports.md": ["optlink solve crank-rocker --out out"],
    "docs/exchange.md": ["optlink show balance-four-bar --toml > mine.toml"],
    "docs/from-sam-pmks.md": ["optlink show balance-four-bar --toml > drawn.toml"],
}
"""Commands that write what the commands of a page read."""
