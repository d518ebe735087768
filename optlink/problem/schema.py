"""JSON schema of problem files, from the models that read them and from the registries: editors complete and check TOML by it.

What a model does not tell, the forms of a value that a function reads, is in `READERS` and `FORMS`; the reference of keys
shows their titles. A value that only a part of the checks can judge, such as a unit, is described and not decided.
"""

import ast
import functools
import inspect
import itertools
import operator
import re
import textwrap
from collections.abc import Callable
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from optlink.clearance.joint import DAMPING
from optlink.io import load_extensions
from optlink.linkage.laws import SEGMENTS
from optlink.problem.base_model import NAME, SPELLINGS, Section, spellings
from optlink.problem.design import DesignProblem
from optlink.problem.limits import OF_QUANTITY, OF_REGION
from optlink.problem.machine.balance import BalanceSection
from optlink.problem.machine.bodies import STATIC
from optlink.problem.machine.loads import OVER
from optlink.problem.machine.model import FORMAT, marked_kinds
from optlink.problem.quantity import SIDES, STROKES, Quantity, range_example
from optlink.problem.requirements.laws import DEAD_CENTRES, TIED
from optlink.problem.targets.law import KEYS as FUNCTION_KEYS
from optlink.problem.targets.points import POINT_KEYS
from optlink.problem.targets.target_points import POINT_COLUMNS
from optlink.problem.terms import QUANTITIES
from optlink.problem.tolerances import CHOICES, EXPECTED, WORST
from optlink.units import DEFINITIONS, KINDS, measures

Form = dict[str, Any]
"""A JSON schema; `title` describes it in words."""

_NUMBER = r"[-+\u2010\u2011\u2013\u2212]?(\d+(\.\d*)?|\.\d+)([eE][-+\u2212]?\d+)?"
_ANY_UNIT = r"1\s*/|[^\s\d.,<>=]"
_FIRST = r"[^\s\d.,<>=][^<>=]*"
_PRODUCT = (
    rf"1\s*/|{_FIRST}[*/^\u00b7\u22c5\u2219\u00d7\u207b\u00b2\u00b3\u2074]|({_FIRST})?[A-Za-z](\s+[A-Za-z]|-[A-Za-z]|[2-4])"
)
"""The beginning of a unit, and of one that is a product or power."""
_NAMES = ["\u00b0", "\u00ba", "\u00b5m", "\u03bcm", "Nm", "kNm", "Nmm", *re.findall(r"[A-Za-z_]+", " ".join(DEFINITIONS))]
RANGE = r"^\s*[<>\u2264\u2265]|\.\.|\u2026|\u00b1|\+/?[-\u2010\u2011\u2013\u2212]"
PERCENT: Form = {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*%\s*$"}
NUMBER: Form = {"type": "number"}
TEXT: Form = {"type": "string"}
_NAME: Form = {"type": "string", "pattern": f"^{NAME}$"}


def either(title: str, *forms: Form) -> Form:
    """Return one of several forms; the model's own where there is no title."""
    return {"title": title, "anyOf": list(forms)} if title else {"anyOf": list(forms)}


def pair(form: Form) -> Form:
    """Return a list of two values."""
    return {"type": "array", "items": form, "minItems": 2, "maxItems": 2}


def column(*kinds: str) -> Form:
    """Return a list of quantities."""
    return {"type": "array", "items": text(*kinds)}


def table(*names: str, form: Form | None = None, **forms: Form) -> Form:
    """Return a table with these keys and no others: those by name take any value, or this form."""
    return {"type": "object", "properties": {**dict.fromkeys(names, form or {}), **forms}, "additionalProperties": False}


def named(form: Form) -> Form:
    """Return a table of names."""
    return {"type": "object", "additionalProperties": form}


@functools.cache
def _units(kind: str) -> tuple[str, ...]:
    """Return the single units of a kind, as they may be spelled."""
    spelled = (f"{word}{plural}" for name in _NAMES for word in (name, name.upper(), name.capitalize()) for plural in ("", "s"))
    return tuple(dict.fromkeys(unit for unit in spelled if measures(f"1 {unit}", kind)))


def text(*kinds: str | None) -> Form:
    """Return a quantity of one of these kinds, of any without one, as text; for None a number or a share in percent."""
    if kinds == (None,):
        return {"anyOf": [NUMBER, PERCENT]}
    if kinds == ("ratio",):
        return {"anyOf": [NUMBER, {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*$"}]}
    known = [kind for kind in kinds if kind]
    single = [rf"{unit}\s*$" for kind in known for unit in _units(kind)]
    units = "|".join([*single, r"1\s*/", _PRODUCT] if known else [_ANY_UNIT])
    examples = [KINDS[kind].example for kind in known]
    return {
        "title": "/".join(known) or "number and unit",
        "type": "string",
        "pattern": rf"^\s*{_NUMBER}\s*({units})",
        "examples": examples,
    }


def ranges(*kinds: str | None) -> tuple[Form, Form]:
    """Return a range as text, and as a list of its ends."""
    examples = [range_example(kind).strip('"') for kind in kinds]
    return {"type": "string", "pattern": RANGE, "examples": examples}, pair(text(*kinds))


def free(*kinds: str) -> tuple[Form, ...]:
    """Return a quantity that is fixed, free or linked."""
    value, bounds = text(*kinds), ranges(*kinds)
    return value, bounds[0], table(start=value, bounds={"anyOf": list(bounds)}, equals=TEXT)


def interval(*kinds: str | None) -> tuple[Form, ...]:
    """Return limits of a measure."""
    return text(*kinds), *ranges(*kinds), table(*SIDES, form=text(*kinds))


def size(kind: str) -> Form:
    """Return a force or torque."""
    at = column(*OVER.values())
    keys = table(at=at, values=column(kind), csv=TEXT, over={"enum": list(OVER)}, expression=TEXT, unit=TEXT)
    return either(f"{kind}, table or expression", text(kind), keys)


def _by_joint(title: str, *forms: Form) -> Form:
    return either(title, *forms, named({"anyOf": list(forms)}))


def _stroke_ratio(_: None) -> Form:
    keys = table(*SIDES, form=text(None), stroke={"enum": list(STROKES)})
    title = "range of numbers, with `stroke` `forward`, `backward`, `slow` or `quick`"
    return either(title, *interval(None)[:-1], keys)


READERS: dict[str, Callable[[Any], Form]] = {
    "read_quantity": lambda kind: either(f"{kind}, fixed, free or linked", *free(kind)),
    "read_fixed": text,
    "read_positive": lambda kind: either(f"{kind}, not negative", text(kind)),
    "read_interval": lambda kind: either(f"range of {kind or 'numbers'}", *interval(kind)),
    "_read_joint_ranges": lambda kind: _by_joint(f"range of {kind}, or table of ranges by joint", *interval(kind)),
    "_read_joint_maxima": lambda kind: _by_joint(
        f"largest {kind}, or table of them by joint", text(kind), ranges(kind)[0], table("max", form=text(kind))
    ),
    "_read_stroke_ratio": _stroke_ratio,
    "read_number": lambda _: either("number", NUMBER, PERCENT),
    "_read_name": lambda _: _NAME,
    "_check_quantity": lambda _: {"title": "quantity of the cycle", "enum": list(QUANTITIES)},
}
"""Forms by the name of the function that reads a field, for the physical kind that it reads."""

_PLACE = pair(either("coordinate, fixed, free or linked", *free("coordinate")))
_WHEELS = {"title": "list of two lengths, fixed, free or linked", **pair({"anyOf": [*free("length")]})}
_PLACES = {**named(_PLACE), "propertyNames": _NAME}
_FIXED_PLACE = pair(text("coordinate"))
_ACCELERATION, _PRESSURE = text("acceleration"), text("pressure")
_MEASURE = either("length, angle or number", text("length", "angle"), NUMBER)
_OUTPUT = "range of these, or table of `min`, `max`, `exactly`"
_ANY_QUANTITY = either("quantity", text(), NUMBER)

_TOLERANCE = {
    **table(tolerance=TEXT, distribution={"enum": [*CHOICES]}, cost=NUMBER),
    "additionalProperties": True,
}  # D.x is a table

_TEETH = {"title": "list of two whole numbers", **pair({"type": "integer", "minimum": 1})}
_STOCK = {"type": "array", "items": _ANY_QUANTITY}
_GRID = {**table("step", "from", form=_ANY_QUANTITY, teeth=_TEETH), "additionalProperties": True}

_LAW = table(
    *FUNCTION_KEYS,
    **{"phi": column("angle"), "psi": column("angle"), "s": column("coordinate"), "input": text("angle")},
    **dict.fromkeys(("function", "slide", "unit", "csv"), TEXT),
    measured_from={"enum": ["start", "frame"]},
)
_ROW = table(**{name: text(kind) if kind else NUMBER for name, kind in POINT_COLUMNS.items()})
_CURVE = table(*itertools.chain(*POINT_KEYS.values()), **dict.fromkeys(("csv", "svg", "unit"), TEXT), points={"type": "integer"})

_RISE = text("angle", "length")
_CAM_SEGMENT = table(to=text("angle"), rise=_RISE, fall=_RISE, law={"enum": list(SEGMENTS)})

FORMS: dict[str, Form] = {
    "Problem.gravity": either("acceleration, or `[x, y]`", _ACCELERATION, pair(_ACCELERATION)),
    "Problem.measured": {
        **table("column", "per_volt", "at_zero", form=TEXT, csv=TEXT),
        "title": "table of `csv`, `column`, `per_volt`, `at_zero`",
        "required": ["csv"],
    },
    "Problem.tolerances": {"title": "names with text or tables", **named({"anyOf": [TEXT, _TOLERANCE]})},
    "DesignProblem.rounding": {
        "title": "names with a step, a list or a table",
        **named({"anyOf": [TEXT, NUMBER, _STOCK, _GRID]}),
    },
    "BodySection.centroid": either("text, or `[along, across]`", TEXT, _FIXED_PLACE),
    "BodySection.inertia": either("moment of inertia, or `uniform bar`", {"const": "uniform bar"}, text("moment of inertia")),
    "DriveMotion.torque": size("torque"),
    "DriveMotion.force": size("force"),
    "DriveMotion.stops": either("", {"const": "rigid"}),
    "DriveMotion.initial_speed": either("angular velocity or velocity", text("angular velocity", "velocity")),
    "StopsSection.stiffness": either("stiffness or torsional stiffness", text("stiffness", "torsional stiffness")),
    "ControllerSection.proportional": either("stiffness or torsional stiffness", text("stiffness", "torsional stiffness")),
    "ControllerSection.derivative": either("damping or torsional damping", text("damping", "torsional damping")),
    "ControllerSection.limit": either("force or torque", text("force", "torque")),
    "DriveMotion.range": either("`[low, high]`, angles or lengths", pair(text("angle", "coordinate")), TEXT, table("min", "max")),
    "DriveMotion.start": either("angle, or length", text("angle", "coordinate")),
    "DriveMotion.speed": either(
        f"angular velocity, velocity, `{STATIC}`, or a table over `phi`",
        {"const": STATIC},
        text("angular velocity", "velocity"),
        table("over", "csv", at=column("angle"), values=column("angular velocity")),
    ),
    "DriveMotion.law": either(
        "list of motions, expression of `t`, or table of `csv`",
        {"type": "array", "items": table(time=text("time"), to=text("angle", "coordinate"), law={"enum": list(SEGMENTS)})},
        TEXT,
        table("expression", "unit", "period", "duration", "csv", form=TEXT),
    ),
    "CylinderSection.joints": {"title": "list of two names", **pair(_NAME)},
    "GearSection.bodies": {"title": "list of two names", **pair(_NAME)},
    "BeltSection.bodies": {"title": "list of two names", **pair(_NAME)},
    "GearSection.teeth": _TEETH,
    "BeltSection.diameters": _WHEELS,
    "BeltSection.radii": _WHEELS,
    "CamSection.lift": either("length or angle, fixed, free or linked", *free("length", "angle")),
    "CamSection.law": {"title": "list of segments", "type": "array", "items": _CAM_SEGMENT},
    "CamSection.start": either("angle or coordinate", text("angle", "coordinate")),
    **dict.fromkeys(("ForceLoad.force", "SpringLoad.force"), size("force")),
    "GasSection.pressure": size("pressure"),
    "TorqueLoad.torque": size("torque"),
    "JointSection.clearance": text("length"),
    "JointSection.law": {"title": ", ".join(f"`{law}`" for law in DAMPING), "enum": list(DAMPING)},
    "JointSection.modulus": either("pressure, or `[journal, bearing]`", _PRESSURE, pair(_PRESSURE)),
    "JointSection.poisson": either("number, or `[journal, bearing]`", NUMBER, pair(NUMBER)),
    "ControlSection.known": {"title": "list of names", "type": "array", "items": TEXT},
    "ControlSection.regularisation": either("length or angle", text("length", "angle")),
    "FourBarSection.points": {"title": "names with `[along, across]`, each fixed, free or linked", **_PLACES},
    "FourBarSection.pivot": {"title": "`[x, y]`, each fixed, free or linked", **_PLACE},
    "FourBarSection.assembly": either("", {"type": "string", "pattern": "[nN][eE][aA][rR]|,"}),
    "LinkSection.joints": {"title": "list of one or two names", "type": "array", "items": _NAME, "minItems": 1, "maxItems": 2},
    "LinkSection.points": {"title": "names with `[along, across]`, each fixed, free or linked", **_PLACES},
    "GuideSection.through": either("text, or `[x, y]`, each fixed, free or linked", TEXT, _PLACE),
    "DyadsSection.ground": {"title": "names with `[x, y]`, each fixed, free or linked", **_PLACES},
    "Requirement.tolerance": _MEASURE,
    "Requirement.scale": _MEASURE,
    "Requirement.robust": {"title": "text", **TEXT, "examples": ["3 sigma", WORST, EXPECTED]},
    "FunctionRequirement.law": either("text or table", TEXT, _LAW),
    "FunctionRequirement.psi0": either("angle, fixed, free or linked, or `output at the start`", {"const": TIED}, *free("angle")),
    "FunctionRequirement.zero": either(
        "coordinate, fixed, free or linked, or `output at the start`", {"const": TIED}, *free("coordinate")
    ),
    "FunctionRequirement.start": either(
        " or ".join(f"`{start}`" for start in DEAD_CENTRES) + ", or angle, fixed, free or linked",
        {"enum": [*DEAD_CENTRES, *(also for also, usual in SPELLINGS.items() if usual in DEAD_CENTRES)]},
        *free("angle"),
    ),
    "DwellRequirement.over": either("angle, or `[begin, end]`", text("angle"), *ranges("angle"), table("bounds")),
    "DwellRequirement.band": either("length or angle", text("length", "angle")),
    "DwellRequirement.value": either("angle or coordinate, fixed or free", *free("angle", "coordinate")),
    "PositionRequirement.value": either(f"angle or coordinate, {_OUTPUT}", *interval("angle", "coordinate"), table("bounds")),
    "PathRequirement.points": either("list or table", {"type": "array", "items": {"anyOf": [_FIXED_PLACE, _ROW]}}, _CURVE),
    "StrokeRequirement.stroke": either(f"length or angle, {_OUTPUT}", *interval("length", "angle")),
    "RegionLimit.centre": {"title": "`[x, y]`", **_FIXED_PLACE},
    "RegionLimit.through": {"title": "`[x, y]`", **_FIXED_PLACE},
    "RegionLimit.clearance": either("length, or zero", text("coordinate")),
    **dict.fromkeys(("Goal.scale", "Limit.min", "Limit.max", "Limit.exactly"), _ANY_QUANTITY),
    "CounterweightSection.at": either("text, or `[along, across]`", TEXT, _FIXED_PLACE),
    "TermSection.about": either("text, or `[x, y]`", TEXT, _FIXED_PLACE),
    "BalanceSection.about": either("text, or `[x, y]`", TEXT, _FIXED_PLACE),
    "BalanceSection.objective": either("", TEXT, named(NUMBER)),
    "BalanceSection.limits": either("", named(_ANY_QUANTITY)),
    "BalanceLimit.max": either("quantity or percentage", text(), PERCENT, NUMBER),
}
"""Forms of fields with a reader of their own, by model and name."""


@functools.cache
def _strings(model: type[Section]) -> dict[str, str]:
    """Strings below the fields that a class states itself, by field; none if its source is not there."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    except (OSError, TypeError):
        return {}
    found = {}
    for field, below in itertools.pairwise(getattr(tree, "body", ())):
        said = below.value.value if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) else None
        if isinstance(said, str) and isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            found[field.target.id] = " ".join(said.split())
    return found


def owner(model: type[Section], name: str) -> type[Section]:
    """Return the class that defines a field: the model itself or its nearest base class."""
    return next((base for base in model.__mro__ if name in vars(base).get("__annotations__", {})), model)


def description(model: type[Section], name: str) -> str:
    """Return the string below a field, or what was registered with it; else an empty text."""
    return _strings(owner(model, name)).get(name, model.model_fields[name].description or "")


STATED: dict[str, list[Form]] = {
    "dyads": [{"required": [key]} for key in ("links", "ground", "guides")],
    OF_REGION: [{"required": ["region"]}],
}
"""What states a form beside the key for it, by its tag."""


class _Generator(GenerateJsonSchema):
    """Schemas of what a file states, where the models tell what they hold."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def nullable_schema(self, schema: core_schema.NullableSchema) -> Form:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> Form:
        default, form = schema.get("default"), self.generate_inner(schema["schema"])
        shown = str(default) if isinstance(default, Quantity) else default
        return {**form, "default": shown} if shown and isinstance(shown, str | int | float) else form

    def literal_schema(self, schema: core_schema.LiteralSchema) -> Form:
        words = schema["expected"]
        return {"enum": [*words, *(also for also, usual in SPELLINGS.items() if usual in words)]}

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> Form:
        """Decide by the tag, so that a fault is found at its key; editors, which complete by `anyOf`, are offered all."""
        forms = {str(tag): self.generate_inner(choice) for tag, choice in schema["choices"].items()}
        key = schema["discriminator"] if isinstance(schema["discriminator"], str) else "kind"
        first, *others = forms
        result = forms[first]
        for tag in others:
            states = {"properties": {key: {"const": tag}}, "required": [key]}
            result = {"if": {"anyOf": [states, *STATED.get(tag, ())]}, "then": forms[tag], "else": result}
        tags = {} if first == OF_QUANTITY else {"properties": {key: {"enum": list(forms)}}}
        return {**result, **tags, "anyOf": [*forms.values(), {}]}

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> Form:
        call: Any = schema["function"]["function"]
        read = READERS.get(getattr(call, "func", call).__name__)
        return super().function_before_schema(schema) if read is None else read(getattr(call, "keywords", {}).get("kind"))

    def dict_schema(self, schema: core_schema.DictSchema) -> Form:
        form = super().dict_schema(schema)
        for pattern, inner in form.pop("patternProperties", {}).items():
            form |= {"propertyNames": {"pattern": pattern}, "additionalProperties": inner}
        return form

    def model_schema(self, schema: core_schema.ModelSchema) -> Form:
        if "" not in (models := schema["cls"].models()):
            forms = [(key, self.generate_inner(TypeAdapter(form).core_schema)) for key, form in models.items()]
            result = forms[-1][1]
            for key, form in reversed(forms[:-1]):
                result = {"if": {"required": [key]}, "then": form, "else": result}
            return {**result, "anyOf": [*(form for _, form in forms), {}]}
        result, model = super().model_schema(schema), schema["cls"]
        keys, others = result.get("properties", {}), result.get("additionalProperties")
        result |= {"description": result.get("description", "").split("\n\n")[0]}
        del result["title"]
        for name, field in model.model_fields.items():
            also = spellings(name, field)
            stated = keys.pop(also[0])
            about = {"default": stated.pop("default")} if "default" in stated else {}
            form = FORMS.get(f"{owner(model, name).__name__}.{name}", stated)
            if form is not stated and "title" not in form:
                form = either("", stated, *form["anyOf"])
            if others:  # a limit of a quantity may have the name of any other limit
                form = either("", form, others["anyOf"][0])
            if said := description(model, name):
                about["description"] = said
            for key in (*also, *(spelled for spelled, usual in SPELLINGS.items() if usual == name)):
                keys[key] = form | about
        if model is BalanceSection:  # its objective had another name
            names = ("objective", "minimise", "minimize")
            keys |= dict.fromkeys(names, keys["objective"])
            result["anyOf"] = [{"required": [name]} for name in names]
            del result["required"]
        return result


def _shared(part: Any, parts: Form) -> Any:
    """Return a part of a schema with references to forms in place of them, which are added to `parts`."""
    if isinstance(part, list):
        return [_shared(item, parts) for item in part]
    if not isinstance(part, dict):
        return part
    part = {key: _shared(item, parts) for key, item in part.items()}
    if not isinstance(part.get("title"), str):
        return part
    name = re.sub(r"\W+", "-", part["title"]).strip("-")
    own = {key: part.pop(key) for key in ("description", "default") if key in part}
    if parts.setdefault(name, part) != part:
        return {**part, **own}
    referring = {"$ref": f"#/$defs/{name}"}
    return {"anyOf": [referring], **own} if own else referring  # beside a reference, editors pass over what is said of a key


def schema_of(kind: Any) -> Form:
    """Return the schema of a model, or of the type of a field, with what it refers to under `$defs`."""
    return TypeAdapter(kind).json_schema(schema_generator=_Generator)


def problem_schema() -> Form:
    """Return the JSON schema (draft 2020-12) of problem files, with what extensions have registered."""
    load_extensions()
    models: Any = functools.reduce(operator.or_, marked_kinds().values(), DesignProblem)
    forms: Form = {}
    schema = _shared(schema_of(models), forms)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:optlink:problem:{FORMAT}",
        "title": "optlink problem",
        **schema,
        "$defs": dict(sorted((schema.pop("$defs") | forms).items())),
    }
