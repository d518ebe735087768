from optlink.dynamics.inverse import GroupForces as GroupForces, solve_two_by_two as solve_two_by_two
from optlink.io import register as register
from optlink.linkage.assur import DyadType as DyadType
from optlink.linkage.extrema import extremes as extremes
from optlink.linkage.mechanism import Dyad as Dyad, Guide as Guide
from optlink.linkage.vector2d import (
    cross as cross,
    dot as dot,
    minus as minus,
    plus as plus,
    turn as turn,
    turn_back as turn_back,
)
from optlink.presentation.registry import ResultKind as ResultKind
from optlink.presentation.table_spec import summary as summary
from optlink.presentation.view import View as View
from optlink.presentation.views.search_tables import checks as checks
from optlink.problem.base_model import Section as Section
from optlink.problem.limits import LimitTerm as LimitTerm
from optlink.problem.machine.model import Problem as Problem, ProblemKind as ProblemKind
from optlink.problem.quantity import (
    AngleInterval as AngleInterval,
    FixedLength as FixedLength,
    LengthInterval as LengthInterval,
    NumberInterval as NumberInterval,
)
from optlink.problem.terms import Element as Element, QuantityType as QuantityType
from optlink.solvers.contract import Solver as Solver
from optlink.solvers.solution import Attempt as Attempt
from optlink.tasks.protocol import DesignTask as DesignTask
from optlink.tasks.results.common import SingleResult as SingleResult
from optlink.validation.check import Check as Check, Validation as Validation
