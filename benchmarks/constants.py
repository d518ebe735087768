"""What the constants that steer the searches do: each one halved and doubled, on the quickest searches that read it.

    python benchmarks/constants.py --list                     # the constants, by an analysis of the source
    python benchmarks/constants.py OUT.jsonl                  # one line for every constant, factor and problem
    python benchmarks/constants.py OUT.jsonl --only solvers.multistart tasks.search
    python benchmarks/constants.py OUT.jsonl --missing        # those that the record lacks alone
    python benchmarks/constants.py OUT.jsonl --summary        # add what was found to the record, for docs/constants.md
    python benchmarks/constants.py --summary                  # the record for meanings and reasons that were changed

Every search runs in a process of its own, forked from one that has imported the program, in which every reading of the constant
gives the other value; modules with defaults or constants that are computed from it are imported again. A number near one is moved
towards or away from one, a whole number by one at least. What was run before for the same value is not run again. A constant is
tried on the quickest searches that read it, one after the other, until something changes but times, which are processor times.
Constants that steer no search have a reason in `constants_reasons.toml` instead.
"""

from __future__ import annotations

import argparse
import ast
import functools
import importlib
import importlib.abc
import importlib.machinery
import io
import json
import math
import os
import resource
import sys
import time
import tokenize
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import casadi  # noqa: F401 - imported here, so that the processes of the searches share it
import numpy as np
import pydantic  # noqa: F401
import scipy.stats  # noqa: F401
from timing import ROOT

SUMMARY = Path(__file__).with_name("constants_record.json")
REASONS = Path(__file__).with_name("constants_reasons.toml")
PACKAGES = ("synthesis", "solvers", "tasks", "optimization", "studies", "linkage", "validation")
CALLS = {"log", "radians", "exp", "sqrt", "array", "sin"}  # functions of numbers in the value of a constant
FACTORS = {"half": 0.5, "double": 2.0}
MOST, BUDGET = 3, 2.5  # searches for a constant; processor time [s] of them together, unless there is only one
LONGEST = 8.0  # times the processor time of the search with the stated value, and 5 s: then it is stopped
MANY = 10.0  # ratio of work from which it is told as a factor
DIGITS = 1e-9  # relative difference of an objective that counts
ROUNDING = 1e-16  # objective [SI] of a design without errors
TIMES, SECONDS = 2.0, 1.0  # ratio and difference [s] of the times of one search that count; on a busy machine others are noise


@dataclass(frozen=True)
class Constant:
    """A number, or several, that a module states, with the comment on its line."""

    module: str
    name: str
    text: str
    comment: str

    @property
    def key(self) -> str:
        return f"{self.module}.{self.name}"

    def measured(self, entry: Mapping[str, Any]) -> bool:
        """Whether an entry of a record is about this constant with this value."""
        return (entry["constant"], entry.get("value")) == (self.key, self.text)


def constants() -> Iterator[Constant]:
    """The numeric constants of the packages, by an analysis of their source."""
    for package in PACKAGES:
        for file in sorted((ROOT / "optlink" / package).rglob("*.py")):
            yield from _of_module(file)


@functools.cache
def reasons() -> dict[str, str]:
    """Why a constant has its value, by its key, of those that are not measured."""
    groups = tomllib.loads(REASONS.read_text(encoding="utf-8"))
    return {f"{module}.{name}": reason for module, group in groups.items() for name, reason in group.items()}


def _module(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts[1:])


def _of_module(file: Path) -> Iterator[Constant]:
    source = file.read_text(encoding="utf-8")
    module = _module(file)
    remarks = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    body = ast.parse(source).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        remark = remarks.get(node.end_lineno or 0, "")
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            remark = remark or str(after.value.value).partition("\n")[0]
        for name, value in _assigned(node):
            if _numeric(value):
                yield Constant(module, name, ast.unparse(value), remark)


def defaults() -> Iterator[str]:
    """The defaults of arguments that are numbers but 0 and 1, as text."""
    for package in PACKAGES:
        for file in sorted((ROOT / "optlink" / package).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    continue
                one, given = node.args, len(node.args.defaults)
                plain = [*one.posonlyargs, *one.args]
                pairs = [
                    *zip(plain[len(plain) - given :], one.defaults, strict=True),
                    *zip(one.kwonlyargs, one.kw_defaults, strict=True),
                ]
                for argument, value in pairs:
                    if isinstance(value, ast.Constant) and type(value.value) in (int, float) and value.value not in (0, 1):
                        yield f"{_module(file)}.{node.name}({argument.arg} = {value.value})"


def _assigned(node: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    """The names in capitals that a statement assigns, each with its value."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    for target in targets:
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from ((one.id, value) for one, value in zip(target.elts, node.value.elts, strict=True) if _capital(one))
        elif _capital(target) and node.value is not None:
            yield target.id, node.value


def _capital(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id.isupper()


def _numeric(node: ast.expr) -> bool:
    """Whether an expression has numbers alone, one at least, and is not computed from another constant."""
    leaves = [part for part in ast.walk(node) if isinstance(part, ast.Constant)]
    names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
    calls = {part.func.attr for part in ast.walk(node) if isinstance(part, ast.Call) and isinstance(part.func, ast.Attribute)}
    keys = {id(key) for part in ast.walk(node) if isinstance(part, ast.Dict) for key in part.keys}
    numbers = [leaf for leaf in leaves if id(leaf) not in keys]
    plain = all(type(leaf.value) in (int, float) for leaf in numbers) and names <= {"math", "np"} and calls <= CALLS
    return plain and bool(numbers) and not any(isinstance(part, (ast.Lambda, ast.Subscript)) for part in ast.walk(node))


# --- a module with another value, and what is read ---------------------------------------------------------------------------


def scaled(value: Any, factor: float) -> Any:
    """The value halved or doubled; a number near one moved in its distance from one."""
    if isinstance(value, dict):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, tuple):
        return tuple(scaled(one, factor) for one in value)
    if isinstance(value, int):
        moved = round(value * factor)
        return moved if moved != value else value + (1 if factor > 1.0 else -1)
    if isinstance(value, float) and 0.9 <= value < 1.1 and value != 1.0:
        return 1.0 + factor * (value - 1.0)
    return value * factor


class Watch(importlib.abc.MetaPathFinder):
    """Compiles the modules of optlink so that they tell which constants they read, and may read another value of one."""

    def __init__(self, watched: frozenset[str]) -> None:
        self.watched = watched
        self.read: set[str] = set()
        self.early: set[str] = set()  # read while the modules are imported: defaults, and constants computed from others
        self.change: tuple[str, float] | None = None
        self.codes: dict[str, Any] = {}

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """The specification of a module of optlink; None for others."""
        spec = importlib.machinery.PathFinder.find_spec(fullname, path) if fullname.partition(".")[0] == "optlink" else None
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        spec.loader = _Loader(fullname, spec.origin, self)
        return spec

    def transformed(self, tree: ast.Module, module: str) -> ast.Module:
        """The module with every reading of a constant told."""
        return _Watched(module, self.watched).visit(tree)

    def told(self, key: str, value: Any) -> Any:
        """The value of a constant that is read, or the other value."""
        self.read.add(key)
        return scaled(value, self.change[1]) if self.change and self.change[0] == key else value

    def load(self) -> None:
        """Import the modules, so that the processes of all searches share them."""
        sys.meta_path.insert(0, self)
        for package in PACKAGES:
            for file in sorted((ROOT / "optlink" / package).rglob("*.py")):
                importlib.import_module(f"optlink.{_module(file)}".removesuffix(".__init__"))
        self.early, self.read = self.read, set()

    def reached(self) -> set[str]:
        """The constants that were read, with defaults and the like of modules of which others were."""
        modules = {key.rpartition(".")[0] for key in self.read}
        return self.read | {key for key in self.early if key.rpartition(".")[0] in modules}

    def begin(self, change: tuple[str, float] | None) -> None:
        """Change a constant; the modules are imported again where it is read meanwhile."""
        self.change = change
        if change and change[0] in self.early:
            for name in [name for name in sys.modules if name.partition(".")[0] == "optlink"]:
                del sys.modules[name]


class _Watched(ast.NodeTransformer):
    """Replaces a constant by a call that tells that it is read."""

    def __init__(self, module: str, watched: frozenset[str]) -> None:
        self.watched = watched
        self.names = {key.rpartition(".")[2]: key for key in watched if key.rpartition(".")[0] == module}
        self.modules: dict[str, str] = {}

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.ImportFrom:
        base = (node.module or "").removeprefix("optlink").lstrip(".")
        for one in node.names:
            key = f"{base}.{one.name}".lstrip(".")
            if key in self.watched:
                self.names[one.asname or one.name] = key
            self.modules[one.asname or one.name] = key
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load) and node.id in self.names:
            return self._told(self.names[node.id], node)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        key = f"{self.modules.get(node.value.id, '')}.{node.attr}" if isinstance(node.value, ast.Name) else ""
        return self._told(key, node) if key in self.watched else self.generic_visit(node)  # type: ignore[return-value]

    @staticmethod
    def _told(key: str, node: ast.expr) -> ast.expr:
        return ast.Call(ast.Name("__told__", ast.Load()), [ast.Constant(key), node], [])


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, fullname: str, path: str, watch: Watch) -> None:
        super().__init__(fullname, path)
        self.watch = watch

    def get_code(self, fullname: str) -> Any:
        if fullname not in self.watch.codes:
            tree = self.watch.transformed(ast.parse(self.get_source(fullname) or ""), fullname.removeprefix("optlink."))
            self.watch.codes[fullname] = compile(ast.fix_missing_locations(tree), self.path, "exec", dont_inherit=True)
        return self.watch.codes[fullname]

    def exec_module(self, module: Any) -> None:
        vars(module)["__told__"] = self.watch.told
        super().exec_module(module)


# --- searches ----------------------------------------------------------------------------------------------------------------


Found = dict[str, Any]


def _design(
    name: str, backend: str = "ipopt", changes: Mapping[str, Any] | None = None, starts: int | None = None, **proof: Any
) -> Found:
    """What `optlink.solve` finds of a shipped problem."""
    import optlink

    result = optlink.solve(optlink.load(name).override(dict(changes or {})), backend, starts, 0, workers=1, **proof)
    found = getattr(result, "certificate", None)
    return {
        "objectives": [float(result.objective), *(float(one.objective) for one in getattr(result, "designs", ())[1:])],
        "valid": bool(result.valid),
        "starts": int(getattr(result, "starts", 0)),
        "told": [found.status, found.boxes] if found else [one.name for one in getattr(result, "conflict", ())],
    }


def _sweep(name: str, *vary: str) -> Found:
    import optlink
    from optlink.studies import sweep

    study = sweep(optlink.load(name), list(vary), workers=1)
    values = np.asarray(study.columns[next(title for title in study.columns if title.startswith("objective"))], dtype=float)
    return {"objectives": values.tolist(), "valid": study.complete, "starts": study.searched_points, "told": [study.valid]}


def _pareto(name: str, objectives: str, points: int) -> Found:
    import optlink
    from optlink.studies import pareto

    front = pareto(optlink.load(name), objectives, points=points, workers=1)
    told = [len(front.points), front.valid, front.infeasible]
    return {"objectives": front.costs[:, 0].tolist(), "valid": front.complete, "starts": front.solved, "told": told}


def _sensitivities(name: str, changes: Mapping[str, Any] | None = None, *, check: bool = False) -> Found:
    import optlink
    from optlink.studies import sensitivities

    study = sensitivities(optlink.load(name, dict(changes or {})), check=check)
    derivatives = [float((one.check or one).objective) for one in study.rows]
    return {"objectives": derivatives, "valid": True, "starts": 0, "told": [study.status, len(study.moving)]}


def _tolerance(name: str, *tolerances: str, **options: Any) -> Found:
    import optlink
    from optlink.studies import tolerance

    study = tolerance(optlink.load(name), list(tolerances), samples=1 << 14, **options)
    shares = [-float(study.monte_carlo.share)] if study.monte_carlo else []
    return {"objectives": shares, "valid": True, "starts": 0, "told": []}


def _tune(name: str, **options: Any) -> Found:
    from optlink.control import tune

    tuned = tune(name, "inverse+pid", ["proportional", "integral"], evaluations=8, starts=1, **options)
    return {"objectives": [float(tuned.cost)], "valid": True, "starts": 0, "told": []}


def _grown() -> Found:
    """A six-bar of a random path from the best design of its four-bar, before it is refined."""
    import optlink
    from optlink.synthesis.growth import contained_four_bar
    from optlink.tasks.search import Polisher, designs_from_four_bar
    from tests.random_six_bars import random_six_bar

    class Unrefined(Polisher):
        def each(self, *_: Any, **__: Any) -> Iterator[Any]:
            return iter(())

    file = random_six_bar(10, 12).file
    part = contained_four_bar(file)
    assert part is not None
    four_bars = optlink.solve(part.file, "ipopt", 60, 0, workers=1).designs[:1]
    designs = designs_from_four_bar(part, four_bars, Unrefined(file.variants(), "ipopt"), 0)
    return {"objectives": [float(one.objective) for one in designs], "valid": bool(designs), "starts": 0, "told": []}


def _error_bounded(name: str, best: float, changes: Mapping[str, Any], **limits: float) -> Found:
    """The bound of the largest error of a function; a higher one is better."""
    import optlink
    from optlink.solvers.global_search.function_generator import certify_function

    found = certify_function(optlink.load(name, dict(changes)).spec, best, **limits)
    return {"objectives": [found.best, -found.lower], "valid": True, "starts": 0, "told": [found.status, found.boxes]}


def _path_bounded(name: str, changes: Mapping[str, Any], gap: float, boxes: int) -> Found:
    """The proof of a timed path, begun from the best of few designs: its boxes, or those left of a proof that is stopped."""
    import optlink
    from optlink.tasks.certify import certify

    problem = optlink.load(name, dict(changes))
    result = certify(optlink.solve(problem, "ipopt", 20, 0, workers=1, certify=False), gap, boxes=boxes, original=problem)
    found = result.certificate
    objectives = [float(result.objective), -float(found.lower_bound)]
    return {
        "objectives": objectives,
        "valid": bool(result.valid),
        "starts": 0,
        "told": [found.status, found.open_boxes or found.boxes],
    }


PROBLEMS = (
    *("crank-rocker", "poses-and-law", "motion-5-poses", "steering-trapezoid", "stroke-slider-crank", "motion-3-poses"),
    *("path-watt-leg", "stroke-crank-rocker", "two-wipers", "straight-line", "function-sin", "path-slider-egg"),
    *("path-stephenson-dwell", "path-closed18", "path-arc5", "shaper-design", "transmission-optimal"),
    *("crank-rocker-robust", "balance-six-bar"),
)
"""Problems whose searches read as many of the constants as all shipped problems do, about from the quickest to the slowest."""
SECOND = ("crank-rocker", "stroke-slider-crank", "path-slider-egg")  # searched by the other back end too
SPAN = ("mechanism.frame=450..550 mm", "limits.transmission_angle.max=125..140 deg")
LENGTHS = ("crank=0.05 mm", "coupler=0.1 mm", "rocker=0.1 mm")


def cases() -> dict[str, Callable[[], Found]]:
    """The searches by name."""
    found: dict[str, Callable[[], Found]] = {name: partial(_design, name) for name in PROBLEMS}
    found |= {f"{name}, slsqp": partial(_design, name, "slsqp") for name in SECOND}
    steep = {"limits.transmission_angle": ["75 deg", "105 deg"]}
    found["crank-rocker, infeasible"] = partial(_design, "crank-rocker", changes=steep)
    found["stroke-crank-rocker, infeasible"] = partial(
        _design, "stroke-crank-rocker", changes={"limits.transmission_angle": ["60 deg", "120 deg"]}
    )
    found["path-crank-rocker, infeasible"] = partial(_design, "path-crank-rocker", changes=steep, starts=60)
    found["path-arc5, largest deviation"] = partial(_design, "path-arc5", changes={"requirement.measure": "max"}, starts=60)
    found["function-exp, 24 starts"] = partial(_design, "function-exp", starts=24)
    proof = {"certify": True, "gap": 0.2}
    found["crank-rocker, largest deviation, certified"] = partial(
        _design, "crank-rocker", changes={"requirement.measure": "max"}, **proof
    )
    wide = {"limits.link_ratio": [0.333, 3.0], "limits.transmission_angle": ["18 deg", "162 deg"]}
    found["path-arc5, certified"] = partial(_path_bounded, "path-arc5", wide, 0.9, 100_000)
    found["path-closed18, certified"] = partial(_path_bounded, "path-closed18", {}, 0.9, 2_000)
    left = {"mechanism.assembly": "left"}
    found["function-sin, certified"] = partial(_error_bounded, "function-sin", 0.006, left, gap=0.5)
    exact = partial(_error_bounded, "function-log10", 6.404826e-5, {}, gap=1e-3, boxes=6000)
    found["function-log10, certified closely"] = exact
    lengths = {f"mechanism.{name}": {"bounds": ["20 mm", "300 mm"]} for name in ("frame", "crank")}
    found["stroke-crank-rocker of any size"] = partial(_design, "stroke-crank-rocker", changes=lengths, starts=4)
    rod = {"mechanism.links.rod.length": {"bounds": ["100 mm", "300 mm"]}, "mechanism.guides.G.friction": 0}
    rod |= {"objective": {"quantity": "torque", "measure": "rms"}}
    found["rod of a pump"] = partial(_design, str(ROOT / "templates" / "pump.toml"), changes=rod, starts=2)
    found["path-watt-leg within its span"] = partial(_design, "path-watt-leg", changes={"limits.crank": "span"}, starts=60)
    found["path-ellipse10, 60 starts"] = partial(_design, "path-ellipse10", starts=60)
    found["six-bar from a four-bar"] = _grown
    found["sweep of crank-rocker"] = partial(_sweep, "crank-rocker", *(f"{axis}:7" for axis in SPAN))
    found["sweep of path-crank-rocker"] = partial(_sweep, "path-crank-rocker", "mechanism.crank=95..105 mm:3")
    found["grid of crank-rocker"] = partial(_sweep, "crank-rocker", "mechanism.frame=150..900 mm:4", f"{SPAN[1]}:3")
    found["sweep of the law of crank-rocker"] = partial(_sweep, "crank-rocker", "requirement.span=80..100 deg:3")
    found["front of crank-rocker in a range"] = partial(
        _pareto, "crank-rocker", "error, limits.transmission_angle.max=125..135 deg", 3
    )
    found["front of crank-rocker"] = partial(_pareto, "crank-rocker", "error, limits.transmission_angle.max", 5)
    found["sensitivities of crank-rocker"] = partial(_sensitivities, "crank-rocker")
    found["sensitivities of stroke-crank-rocker"] = partial(_sensitivities, "stroke-crank-rocker")
    found["sensitivities of law-slider-crank, checked"] = partial(
        _sensitivities, "law-slider-crank", {"requirement.measure": "max"}, check=True
    )
    found["yield of crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg")
    found["tolerance of stroke-crank-rocker"] = partial(
        _tolerance, "stroke-crank-rocker", *LENGTHS, limit="0.5 deg", output="rocker"
    )
    found["margin of crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg", robust="margin")
    found["control of crank-rocker-clearance"] = partial(_tune, "crank-rocker-clearance", revolutions=2, points=36)
    found["robust crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg", robust="yield")
    found["tolerances of crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg", target_yield=0.95)
    return found


# --- running -----------------------------------------------------------------------------------------------------------------


def run(search: Callable[[], Found], watch: Watch, change: tuple[str, float] | None, seconds: float) -> Found:
    """What a search finds in a process of its own, with its processor time and evaluations; `fault`: why it found nothing."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        limit = math.ceil(seconds)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        watch.begin(change)
        try:
            found = _counted(search)
            if change is None:
                found |= {"read": sorted(watch.reached()), "modules": sorted(sys.modules)}
        except BaseException as error:  # noqa: BLE001 - whatever another value leads to is a result
            found = {"fault": f"{type(error).__name__}: {error}"[:160]}
        with os.fdopen(writer, "w") as out:
            json.dump(found, out)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as text:
        found = text.read()
    os.waitpid(child, 0)
    return json.loads(found) if found else {"fault": "stopped: it took too long"}


def _counted(search: Callable[[], Found]) -> Found:
    """Run a search; count evaluations of programmes and of designs in batches."""
    from optlink.optimization.nlp import NLP
    from optlink.synthesis.batch import Batch

    counts = {"evaluations": 0}

    def count(owner: Any, name: str, size: Callable[..., int]) -> None:
        plain = getattr(owner, name)

        @functools.wraps(plain)
        def counted(self: Any, *arguments: Any) -> Any:
            counts["evaluations"] += size(*arguments)
            return plain(self, *arguments)

        setattr(owner, name, counted)

    for name in ("at", "values", "hessian"):
        count(NLP, name, lambda *_: 1)
    count(Batch, "residuals", lambda x, *_: len(x))
    begin = time.process_time()
    found = search()
    return found | {"seconds": time.process_time() - begin} | counts


def record(out: Path, wanted: list[Constant], names: list[str]) -> None:
    """Run what the file lacks of some constants, with the searches of these names."""
    searches, watch = cases(), Watch(frozenset(constant.key for constant in constants()))
    names = names or list(searches)
    watch.load()
    entries = _lines(out)
    done = {(one["constant"], one["factor"], one["case"], one.get("value", "")) for one in entries}
    with out.open("a", encoding="utf-8") as file:

        def keep(entry: Found) -> None:
            entries.append(entry)
            file.write(json.dumps(entry) + "\n")
            file.flush()

        for name, search in searches.items():
            if name in names and ("", "stated", name, "") not in done:
                found = run(search, watch, None, 20.0)
                for module in found.pop("modules", ()):
                    if module.partition(".")[0] in ("scipy", "numpy", "casadi"):
                        importlib.import_module(module)  # once, instead of in every process
                keep({"constant": "", "factor": "stated", "case": name} | found)
        stated = {one["case"]: one for one in entries if one["case"] in names and "read" in one}
        for constant in wanted:
            for name in chosen(constant, stated):
                if any(changes(stated[one["case"]], one) for one in entries if constant.measured(one) and one["case"] in stated):
                    break  # it matters: further searches would not tell more
                for factor, number in FACTORS.items():
                    if (constant.key, factor, name, constant.text) not in done:
                        limit = LONGEST * stated[name]["seconds"] + 5.0
                        found = run(searches[name], watch, (constant.key, number), limit)
                        keep({"constant": constant.key, "value": constant.text, "factor": factor, "case": name} | found)
                        print(constant.key, factor, name, effect(stated[name], found), flush=True)


def chosen(constant: Constant, stated: Mapping[str, Found]) -> list[str]:
    """The quickest searches that read a constant."""
    names, left = [], BUDGET
    for name in sorted(stated, key=lambda name: float(stated[name]["seconds"])):
        if constant.key in stated[name]["read"] and len(names) < MOST and (stated[name]["seconds"] <= left or not names):
            names.append(name)
            left -= stated[name]["seconds"]
    return names


def _lines(file: Path) -> list[Found]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def effect(stated: Found, found: Found) -> str:
    """What another value changes, and whether the time differs, in words; empty if nothing."""
    words = changes(stated, found)
    before, after = stated["seconds"], found.get("seconds", stated["seconds"])
    ratio = after / before
    if not 1.0 / TIMES <= ratio <= TIMES and abs(after - before) > SECONDS:
        words.append(f"time x {ratio:.2g}")
    return ", ".join(words)


def changes(stated: Found, found: Found) -> list[str]:
    """What another value changes but for times, in words."""
    if "fault" in found:
        return [found["fault"]]
    words = []
    one, other = stated["objectives"], found["objectives"]
    if len(one) != len(other):
        words.append(f"{len(other)} designs instead of {len(one)}")
    gaps = [_gap(a, b) for a, b in zip(one, other, strict=False)]
    if gaps and max(map(abs, gaps)) > DIGITS:
        gap = gaps[0] if abs(gaps[0]) > DIGITS else max(gaps, key=abs)
        words.append(f"{'worse' if gap > 0.0 else 'better'} by {abs(gap):.1g}")
    if stated["valid"] != found["valid"]:
        words.append("valid" if found["valid"] else "not valid")
    (proof, boxes), (other_proof, other_boxes) = _proof(stated), _proof(found)
    if proof != other_proof:
        words.append(f"{proof or 'no proof'} -> {other_proof or 'no proof'}"[:60])
    if boxes and other_boxes and boxes != other_boxes:
        words.append(f"boxes {_amount(other_boxes / boxes)}")
    if stated["starts"] != found["starts"]:
        words.append(f"{found['starts']} starts instead of {stated['starts']}")
    if stated["evaluations"] != found["evaluations"]:
        words.append(f"evaluations {_amount(found['evaluations'] / max(stated['evaluations'], 1))}")
    return words


def _amount(ratio: float) -> str:
    return f"x {ratio:.3g}" if ratio > MANY else f"{100.0 * (ratio - 1.0):+.3g} %"


def _proof(found: Found) -> tuple[Any, int]:
    """The status of a certificate, or what else was told, and the number of boxes, or zero."""
    told = found["told"]
    return (told[0], told[1]) if len(told) == 2 and isinstance(told[0], str) and isinstance(told[1], int) else (told, 0)


def _gap(one: float, other: float) -> float:
    """How much a number is above another, as a share; 0 for both without errors."""
    if one == other or (one != one and other != other) or max(abs(one), abs(other)) <= ROUNDING:
        return 0.0
    share = (other - one) / max(abs(one), abs(other))
    return share if math.isfinite(share) else math.inf


def summarise(out: Path | None) -> None:
    """Write what was found for the constants that the source has, now or in the record, for the documentation."""
    entries = _lines(out) if out else []
    stated = {one["case"]: one for one in entries if one["factor"] == "stated"}
    known = recorded()
    rows = []
    for constant in constants():
        row = {"constant": constant.key, "value": constant.text, "what": constant.comment}
        own = [one for one in entries if constant.measured(one) and one["case"] in stated]
        effects = known.get((constant.key, constant.text), {factor: {} for factor in FACTORS})
        for one in own:
            effects[one["factor"]][one["case"]] = effect(stated[one["case"]], one)
        if all(effects.values()):
            row |= effects
        if constant.key in reasons():
            row["reason"] = reasons()[constant.key]
        rows.append(row)
    files = {_module(file): file for package in PACKAGES for file in (ROOT / "optlink" / package).rglob("*.py")}
    modules = {row["constant"].rpartition(".")[0]: "" for row in rows}
    for module in modules:
        modules[module] = (ast.get_docstring(ast.parse(files[module].read_text(encoding="utf-8"))) or "").partition("\n")[0]
    lines = ",\n".join(map(json.dumps, rows))  # a row a line, for the differences of two versions
    SUMMARY.write_text(f'{{"modules": {json.dumps(modules, indent=1)},\n"rows": [\n{lines}\n]}}\n', encoding="utf-8")


def recorded() -> dict[tuple[str, str], Found]:
    """What the record says of halving and doubling, by constant and value."""
    rows = json.loads(SUMMARY.read_text(encoding="utf-8"))["rows"]
    return {(row["constant"], row["value"]): {factor: row[factor] for factor in FACTORS} for row in rows if "half" in row}


def main() -> int:
    """List the constants, or run the searches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", metavar="OUT.jsonl")
    parser.add_argument("--only", metavar="PREFIX", nargs="+", default=[], help="such as solvers.multistart")
    parser.add_argument("--cases", metavar="NAME", nargs="+", default=[], help="searches, such as crank-rocker; all if omitted")
    parser.add_argument("--list", action="store_true", help="print the constants of these modules")
    parser.add_argument("--missing", action="store_true", help=f"leave out the constants that {SUMMARY.name} has")
    parser.add_argument("--summary", action="store_true", help=f"write {SUMMARY.name}")
    options = parser.parse_args()
    if options.summary:
        summarise(options.out)
        return 0
    if options.list or options.out is None:
        for one in constants():
            if not options.only or one.key.startswith(tuple(options.only)):
                print(f"{one.key} = {one.text}  # {one.comment}")
        print("\n".join(() if options.only else defaults()))
        return 0
    sys.path.insert(0, str(ROOT))
    known = recorded() if options.missing else {}
    wanted = [one for one in constants() if one.key not in reasons() and (one.key, one.text) not in known]
    record(options.out, [one for one in wanted if one.key.startswith(tuple(options.only) or "")], options.cases)
    return 0


if __name__ == "__main__":
    sys.exit(main())
