"""What the constants that steer the searches do: each one halved and doubled, on the first problems whose search reads it.

    python benchmarks/constants.py --list                     # the constants, by an analysis of the source
    python benchmarks/constants.py OUT.jsonl                  # one line for every constant, factor and problem
    python benchmarks/constants.py OUT.jsonl --only solvers.multistart tasks.search
    python benchmarks/constants.py OUT.jsonl --summary        # run nothing; write what was found, for docs/constants.md

Every search runs in a process of its own, in which the module is compiled with the other value, so that defaults and constants
that are computed from it follow. A number near one is moved towards or away from one, a whole number by one at least. What was
run before for the same value is not run again. A constant is tried on one search after the other until something changes but
times, which are processor times.
"""

from __future__ import annotations

import argparse
import ast
import functools
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
PACKAGES = ("synthesis", "solvers", "tasks", "optimization", "studies", "linkage", "validation")
CALLS = {"log", "radians", "exp", "sqrt", "array", "sin"}  # functions of numbers in the value of a constant
FACTORS = {"half": 0.5, "double": 2.0}
MOST, BUDGET = 2, 4.0  # searches for a constant; processor time [s] of them together, unless there is only one
LONGEST = 8.0  # times the processor time of the search with the stated value, and 5 s: then it is stopped
DIGITS = 1e-9  # relative difference of an objective that counts
ROUNDING = 1e-16  # objective [SI] of a design without errors
TIMES = 2.0  # ratio of the times of one search that counts; on a busy machine others are noise


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


class Changed(importlib.abc.MetaPathFinder):
    """Compiles a module with another value of a constant; or all modules so that they tell which constants they read."""

    def __init__(self, change: tuple[Constant, float] | None, watched: frozenset[str] = frozenset()) -> None:
        self.change, self.watched = change, watched
        self.read: set[str] = set()

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """The specification of a module of optlink that is compiled here; None for others."""
        wanted = fullname == f"optlink.{self.change[0].module}" if self.change else fullname.startswith("optlink.")
        spec = importlib.machinery.PathFinder.find_spec(fullname, path) if wanted else None
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        spec.loader = _Loader(fullname, spec.origin, self)
        return spec

    def transformed(self, tree: ast.Module, module: str) -> ast.Module:
        """The module with the other value, or with every reading of a constant told."""
        if self.change:
            constant, factor = self.change
            values = {id(value) for node in tree.body for name, value in _assigned(node) if name == constant.name}
            return _Scaled(values, factor).visit(tree)
        return _Watched(module, self.watched).visit(tree)


class _Scaled(ast.NodeTransformer):
    """Halves or doubles some expressions."""

    def __init__(self, values: set[int], factor: float) -> None:
        self.values, self.factor = values, factor

    def visit(self, node: ast.AST) -> Any:
        if id(node) not in self.values:
            return self.generic_visit(node)
        return ast.Call(ast.Name("__scaled__", ast.Load()), [node, ast.Constant(self.factor)], [])


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
    def __init__(self, fullname: str, path: str, changed: Changed) -> None:
        super().__init__(fullname, path)
        self.changed = changed

    def get_code(self, fullname: str) -> Any:
        tree = self.changed.transformed(ast.parse(self.get_source(fullname) or ""), fullname.removeprefix("optlink."))
        return compile(ast.fix_missing_locations(tree), self.path, "exec", dont_inherit=True)

    def exec_module(self, module: Any) -> None:
        vars(module)["__scaled__"] = scaled
        vars(module)["__told__"] = self._told
        super().exec_module(module)

    def _told(self, key: str, value: Any) -> Any:
        self.changed.read.add(key)
        return value


# --- searches ----------------------------------------------------------------------------------------------------------------


Found = dict[str, Any]


def _design(name: str, backend: str = "ipopt", changes: Mapping[str, str] | None = None, starts: int | None = None) -> Found:
    """What `optlink.solve` finds of a shipped problem."""
    import optlink

    result = optlink.solve(optlink.load(name).override(dict(changes or {})), backend, starts, 0, workers=1)
    proof = getattr(result, "certificate", None)
    return {
        "objectives": [float(result.objective), *(float(one.objective) for one in getattr(result, "designs", ())[1:])],
        "valid": bool(result.valid),
        "starts": int(getattr(result, "starts", 0)),
        "told": [proof.status, proof.boxes] if proof else [one.name for one in getattr(result, "conflict", ())],
    }


def _sweep(name: str, *vary: str) -> Found:
    import optlink
    from optlink.studies import sweep

    study = sweep(optlink.load(name), list(vary), workers=1)
    values = np.asarray(study.columns[next(title for title in study.columns if title.startswith("objective"))], dtype=float)
    return {"objectives": values.tolist(), "valid": study.complete, "starts": study.searched, "told": [study.valid]}


def _pareto(name: str, objectives: str, points: int) -> Found:
    import optlink
    from optlink.studies import pareto

    front = pareto(optlink.load(name), objectives, points=points, workers=1)
    told = [len(front.points), front.valid, front.infeasible]
    return {"objectives": front.costs[:, 0].tolist(), "valid": front.complete, "starts": front.solved, "told": told}


def _sensitivities(name: str) -> Found:
    import optlink
    from optlink.studies import sensitivities

    study = sensitivities(optlink.load(name))
    derivatives = [float(one.objective) for one in study.rows]
    return {"objectives": derivatives, "valid": True, "starts": 0, "told": [study.status, len(study.moving)]}


def _tolerance(name: str, *tolerances: str, **options: Any) -> Found:
    import optlink
    from optlink.studies import tolerance

    study = tolerance(optlink.load(name), list(tolerances), samples=1 << 14, **options)
    shares = [-float(study.monte_carlo.share)] if study.monte_carlo else []
    return {"objectives": shares, "valid": True, "starts": 0, "told": []}


PROBLEMS = ("straight-line", "path-slider-egg", "stroke-slider-crank", "law-slider-crank", "path-arc5", "two-wipers")
PROBLEMS += (
    "path-stephenson-dwell",
    "motion-5-poses",
    "crank-rocker",
    "path-closed18",
    "law-six-bar",
    "shaper-design",
    "path-crank-rocker",
    "path-watt-leg",
)
PROBLEMS += (
    "poses-and-law",
    "motion-3-poses",
    "steering-trapezoid",
    "stroke-crank-rocker",
    "transmission-optimal",
    "function-sin",
)
PROBLEMS += ("crank-rocker-robust", "balance-six-bar")
"""Problems in the order in which they are chosen: a constant is tried on the first ones whose search reads it."""
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
    found["sweep of crank-rocker"] = partial(_sweep, "crank-rocker", *(f"{axis}:20" for axis in SPAN))
    found["sweep of path-crank-rocker"] = partial(_sweep, "path-crank-rocker", "mechanism.crank=95..105 mm:6")
    found["front of crank-rocker"] = partial(_pareto, "crank-rocker", "error, limits.transmission_angle.max", 9)
    found["sensitivities of crank-rocker"] = partial(_sensitivities, "crank-rocker")
    found["sensitivities of stroke-crank-rocker"] = partial(_sensitivities, "stroke-crank-rocker")
    found["yield of crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg")
    found["robust crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg", robust="yield")
    found["tolerances of crank-rocker"] = partial(_tolerance, "crank-rocker", *LENGTHS, limit="2.3 deg", target_yield=0.95)
    return found


# --- running -----------------------------------------------------------------------------------------------------------------


def run(search: Callable[[], Found], hook: Changed | None, seconds: float) -> Found:
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
        if hook:
            sys.meta_path.insert(0, hook)
        try:
            found = _counted(search) | ({"read": sorted(hook.read)} if hook and hook.watched else {})
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


def record(out: Path, only: list[str]) -> None:
    """Run what the record lacks."""
    known = list(constants())
    searches, watched = cases(), frozenset(constant.key for constant in known)
    entries = _lines(out)
    done = {(one["constant"], one["factor"], one["case"], one.get("value", "")) for one in entries}
    with out.open("a", encoding="utf-8") as file:

        def keep(entry: Found) -> None:
            entries.append(entry)
            file.write(json.dumps(entry) + "\n")
            file.flush()

        for name, search in searches.items():
            if ("", "reads", name, "") not in done:
                keep({"constant": "", "factor": "reads", "case": name} | run(search, Changed(None, watched), 60.0))
            if ("", "stated", name, "") not in done:
                keep({"constant": "", "factor": "stated", "case": name} | run(search, None, 60.0))
        stated = {one["case"]: one for one in entries if one["factor"] == "stated" and "seconds" in one}
        reads = {one["case"]: set(one.get("read", ())) for one in entries if one["factor"] == "reads"}
        for constant in known:
            if only and not constant.key.startswith(tuple(only)):
                continue
            for name in chosen(constant, reads, {name: one["seconds"] for name, one in stated.items()}):
                if any(changes(stated[one["case"]], one) for one in entries if constant.measured(one)):
                    break  # it matters: further searches would not tell more
                for factor, number in FACTORS.items():
                    if (constant.key, factor, name, constant.text) not in done:
                        limit = LONGEST * stated[name]["seconds"] + 5.0
                        found = run(searches[name], Changed((constant, number)), limit)
                        keep({"constant": constant.key, "value": constant.text, "factor": factor, "case": name} | found)
                        print(constant.key, factor, name, effect(stated[name], found), flush=True)


def chosen(constant: Constant, reads: Mapping[str, set[str]], seconds: Mapping[str, float]) -> list[str]:
    """The first searches that read a constant and are quick enough together."""
    names, left = [], BUDGET
    for name in (name for name in seconds if constant.key in reads[name]):
        if len(names) < MOST and (seconds[name] <= left or not names):
            names.append(name)
            left -= seconds[name]
    return names


def _lines(file: Path) -> list[Found]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def effect(stated: Found, found: Found) -> str:
    """What another value changes, and whether the time differs, in words; empty if nothing."""
    words = changes(stated, found)
    ratio = found.get("seconds", stated["seconds"]) / stated["seconds"]
    if not 1.0 / TIMES <= ratio <= TIMES:
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
    if stated["told"] != found["told"]:
        words.append(f"{stated['told']} -> {found['told']}"[:60])
    if stated["starts"] != found["starts"]:
        words.append(f"{found['starts']} starts instead of {stated['starts']}")
    if stated["evaluations"] != found["evaluations"]:
        words.append(f"evaluations {100.0 * (found['evaluations'] / max(stated['evaluations'], 1) - 1.0):+.3g} %")
    return words


def _gap(one: float, other: float) -> float:
    """How much a number is above another, as a share; 0 for both without errors."""
    if one == other or (one != one and other != other) or max(abs(one), abs(other)) <= ROUNDING:
        return 0.0
    share = (other - one) / max(abs(one), abs(other))
    return share if math.isfinite(share) else math.inf


def summarise(out: Path) -> None:
    """Write what was found for the constants that the source still has, for the documentation."""
    entries = _lines(out)
    stated = {one["case"]: one for one in entries if one["factor"] == "stated"}
    rows = []
    listed = list(constants())
    for constant in listed:
        own = [one for one in entries if constant.measured(one)]
        if {one["factor"] for one in own} == set(FACTORS):
            told = {factor: [one for one in own if one["factor"] == factor] for factor in FACTORS}
            effects = {factor: {one["case"]: effect(stated[one["case"]], one) for one in some} for factor, some in told.items()}
            rows.append({"constant": constant.key, "value": constant.text, "what": constant.comment} | effects)
    SUMMARY.write_text(json.dumps({"listed": len(listed), "rows": rows}, indent=1) + "\n", encoding="utf-8")


def main() -> int:
    """List the constants, or run the searches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", metavar="OUT.jsonl")
    parser.add_argument("--only", metavar="PREFIX", nargs="+", default=[], help="such as solvers.multistart")
    parser.add_argument("--list", action="store_true", help="print the constants of these modules")
    parser.add_argument("--summary", action="store_true", help=f"write {SUMMARY.name}")
    options = parser.parse_args()
    if options.out and options.summary:
        summarise(options.out)
        return 0
    if options.list or options.out is None:
        for one in constants():
            if not options.only or one.key.startswith(tuple(options.only)):
                print(f"{one.key} = {one.text}  # {one.comment}")
        print("\n".join(() if options.only else defaults()))
        return 0
    sys.path.insert(0, str(ROOT))
    record(options.out, options.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
