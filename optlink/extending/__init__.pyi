from optlink.dynamics.columns import MotionColumns as MotionColumns
from optlink.dynamics.inverse import (
    ForceBalance as ForceBalance,
    GroupForces as GroupForces,
    Reactions as Reactions,
    solve_two_by_two as solve_two_by_two,
)
from optlink.dynamics.machine import Acting as Acting, Load as Load, Moving as Moving
from optlink.errors import InvalidValue as InvalidValue
from optlink.io import register as register
from optlink.linkage.assur import Assembly as Assembly, DyadType as DyadType, Former as Former
from optlink.linkage.extrema import extremes as extremes
from optlink.linkage.mechanism import Dyad as Dyad, Guide as Guide, Joint as Joint, Link as Link
from optlink.linkage.vector2d import (
    Array as Array,
    Value as Value,
    Vector as Vector,
    cross as cross,
    dot as dot,
    minus as minus,
    plus as plus,
    turn as turn,
    turn_back as turn_back,
)
from optlink.optimization.nlp import NLP as NLP
from optlink.presentation.chart_spec import (
    Axis as Axis,
    Bars as Bars,
    ChartSpec as ChartSpec,
    Curve as Curve,
    Panel as Panel,
    crank_angle as crank_angle,
)
from optlink.presentation.registry import ResultKind as ResultKind
from optlink.presentation.table_spec import Summary as Summary, summary as summary
from optlink.presentation.view import ResultChart as ResultChart, View as View
from optlink.presentation.views.search_tables import checks as checks
from optlink.problem.base_model import Section as Section
from optlink.problem.design import DesignProblem as DesignProblem
from optlink.problem.limits import LimitTerm as LimitTerm, Moved as Moved, Reach as Reach
from optlink.problem.machine.loads import (
    LoadKind as LoadKind,
    LoadSection as LoadSection,
    OnBody as OnBody,
    RevolutionSamples as RevolutionSamples,
)
from optlink.problem.machine.model import Problem as Problem, ProblemKind as ProblemKind
from optlink.problem.quantity import (
    AngleInterval as AngleInterval,
    FixedLength as FixedLength,
    Interval as Interval,
    LengthInterval as LengthInterval,
    Number as Number,
    NumberInterval as NumberInterval,
)
from optlink.problem.terms import (
    Course as Course,
    Element as Element,
    ElementTerm as ElementTerm,
    QuantityType as QuantityType,
    Signal as Signal,
)
from optlink.solvers.contract import Solver as Solver
from optlink.solvers.solution import Attempt as Attempt, Backend as Backend
from optlink.tasks.protocol import DesignTask as DesignTask, Search as Search
from optlink.tasks.results.common import SingleResult as SingleResult
from optlink.validation.check import Check as Check, Validation as Validation
