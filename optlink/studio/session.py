"""One open problem: the requests of its page, and the states that answer them. It runs in its own process."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError, OptlinkError
from optlink.presentation.format import pretty
from optlink.presentation.scene import regions_of
from optlink.problem.assignment import parse_assignment
from optlink.problem.enclosed import references
from optlink.problem.file import ProblemFile, load
from optlink.problem.renaming import kinds, own_names, rename
from optlink.studio import design as state, dyads, forms, parts, region, solutions
from optlink.studio.design import (
    Design,
    Follower,
    carried_design,
    failure,
    fault_text,
    from_solution,
    in_modes,
    kind_of,
    moved_machine,
    same_parts,
    solved_design,
    started,
    structure,
    validated_design,
    verdict,
)
from optlink.studio.document import (
    MAX_STEPS,
    Document,
    History,
    deflated,
    exported,
    from_template,
    from_text,
    inflated,
    named,
    shipped_problem,
)
from optlink.studio.handles import Handle, handles, same_kind
from optlink.studio.picture import Picture
from optlink.tasks.exact import exact

if TYPE_CHECKING:
    from optlink.studio.curve import CurveSearch

Send = Callable[[Mapping[str, Any]], None]

HALVINGS = 10  # of the way of a handle, to where feasibility ends
WARM_UP_TIME = 0.5  # s
SEARCHING_TEXT = "The search for the best design runs."
SIX_BAR = "six-bar"  # in place of the number of a four-bar
NONE_TEXT = "The search found none either."
FIRST_TEXT = "Validated; the full search for a better design runs."


class Session:
    """The requests of one page.

    `send` sends a message to the page; `interruptible` runs a function that the page may stop, which raises KeyboardInterrupt.
    """

    def __init__(self, send: Send, interruptible: Callable[[Callable[[], Any]], Any] = lambda work: work()) -> None:
        self._send, self._interruptible = send, interruptible
        self._history: History[Document] | None = None
        self._origin = ""
        self._design: Design | None = None  # the last usable one
        self._follower: tuple[Any, Follower | None] = (None, None)
        self._handles: dict[str, Handle] = {}
        self._rest: dict[str, Handle] = {}  # when no hand moves
        self._curve: CurveSearch | None = None
        self._reached: dict[str, dict[str, Any]] = {}  # how far a handle was feasible, by its name
        self._verdict = ""
        self._last: tuple[Design, ProblemFile] | None = None  # what was shown last
        self._settled: tuple[str, Design] | None = None  # hash of a problem, and what its search has shown
        self._exact: Any = None  # the result with the listed exact solutions
        self._begun = 0.0
        self._id = 0

    # --- requests -----------------------------------------------------------------------------------------------------------

    def handle(self, request: Mapping[str, Any]) -> None:
        """Handle a request; invalid input sends a fault and changes nothing."""
        self._begun, self._id = time.perf_counter(), request["id"]
        try:
            act = _ACTIONS.get(request["type"])
            if act is None:
                raise InputError("unknown request", f"One of: {', '.join(_ACTIONS)}", key="type", value=request["type"])
            if self._history is None and request["type"] not in OPENING:
                raise InputError("no problem is open", "Open one, or draw a curve")
            act(self, request)
        except InputError as error:
            self._answer("fault", message=str(error), faults=[{"key": one.key, "text": fault_text(one)} for one in error.faults])
        except OptlinkError as error:
            self.fault(str(error))
        except OSError as error:  # no folder for temporary files, or no space
            self.fault(f"A file cannot be read or written: {error.strerror or error}. Set TMPDIR to a folder with free space")
        except KeyboardInterrupt:
            self._answer("progress", fraction=1.0, text="stopped")
        except RecursionError:
            self.fault("The request is nested too deeply. Simplify it")

    def fault(self, message: str) -> None:
        """Answer the present request with a fault."""
        self._answer("fault", message=message)

    def _answer(self, kind: str, **fields: Any) -> None:
        """Send a message about the present request; by those of the kind "kept" another process resumes if this one ends."""
        self._send({"type": kind, "id": self._id, **fields})

    @property
    def _document(self) -> Document:
        assert self._history is not None
        return self._history.present

    def _open(self, request: Mapping[str, Any]) -> None:
        if "name" in request:
            document = shipped_problem(_text(request, "name"))
        elif "fragment" in request:
            document = from_text(inflated(_text(request, "fragment")), _text(request, "title", "shared"))
        else:
            document = from_text(_text(request, "text"), _text(request, "title", "problem"))
        self._begin([document])

    def _begin(self, steps: list[Document], at: int = 0, origin: str | None = None, design: Design | None = None) -> None:
        """Open a document, or one with its history: `at` is the index of the present step, `origin` the text that was opened."""
        _ = steps[at].problem  # refuses what is not usable before anything changes
        self._history, self._origin = History(steps, at), steps[at].text if origin is None else origin
        self._design, self._follower, self._settled = design, (None, None), None
        self._answer("kept", step="open", steps=[step.message() for step in steps], at=at, origin=self._origin)
        self._reached = {}
        if design is not None:
            self._show(
                replace(design, conclusion=SEARCHING_TEXT), self._definite(steps[at].problem), moving=False, searching=True
            )
        self._settle()

    def _resume(self, request: Mapping[str, Any]) -> None:
        """Open what an earlier process of this page had open, with its history."""
        self._begin([Document.of(step) for step in request["steps"]], request["at"], request["origin"])

    def _drag(self, request: Mapping[str, Any]) -> None:
        handle = self._handles.get(_text(request, "handle"))
        if handle is None:
            self._document.check_not_linked(request["handle"])
            raise InputError("no such handle", f"Handles: {', '.join(self._handles)}", key="handle", value=request["handle"])
        base = self._document.problem
        changes = handle.changes(base, request)
        if request.get("moving"):
            self._show_moving(base, changes)
            return
        begin, rest = self._design, self._rest.get(handle.id)
        try:
            document = self._document.with_changes(changes)
            _ = document.problem
        except InputError as error:
            self.fault(f"{fault_text(error.faults[0])} The problem is as before the drag.")
            self._settle()
            return
        self._commit(document)
        if self._verdict in ("infeasible", "failed") and base.model.free and begin is not None and rest is not None:
            self._interruptible(lambda: self._bisect(rest, base, request))

    def _set(self, request: Mapping[str, Any]) -> None:
        key, value = parse_assignment(f"{_text(request, 'key')}={_text(request, 'value')}", "set")
        self._change({key: value})

    def _edit(self, request: Mapping[str, Any]) -> None:
        """Replace whole tables by dotted key, all at once; None removes one. Changed texts are read as on the command line."""
        stated = request.get("tables")
        if not isinstance(stated, Mapping):
            raise InputError("expected tables by key", "Send the tables that change", key="tables", value=stated)
        self._change(forms.changes(self._document.problem, stated))

    def _change(self, changes: Mapping[str, object]) -> None:
        for key, value in changes.items():
            nested: Any = value
            for name in reversed(key.split(".")):
                nested = {name: nested}
            if any(references(nested)):
                raise InputError("a value that is set on the page cannot name a file", "Write it into the problem file", key=key)
        document = self._document.with_changes(changes)
        parts.check(self._design, self._document.problem, document.problem)
        self._commit(document)

    def _rename(self, request: Mapping[str, Any]) -> None:
        """Give a part of the linkage another name; the last design stays that of the problem."""
        old, new, last = _text(request, "old"), _text(request, "new").strip(), self._design
        if old == new:
            return
        document = self._document.renamed(old, new)
        if last is not None:
            values = dict(zip(document.problem.model.quantities, last.values.values(), strict=True))
            self._design = Design(rename(last.problem, old, new), values, crank_angles=last.crank_angles)
        self._commit(document)

    def _lock(self, request: Mapping[str, Any]) -> None:
        size = _text(request, "size")
        if not request.get("locked"):
            self._commit(self._document.released(size))
            return
        self._commit(self._document.locked(size, None if self._design is None else self._design.values.get(size)))

    def _search(self, request: Mapping[str, Any]) -> None:
        self._settled = None
        self._settle()

    def _undo(self, request: Mapping[str, Any]) -> None:
        assert self._history is not None
        direction = -1 if request["type"] == "undo" else 1
        self._history.move(direction)
        self._answer("kept", step="move", way=direction)
        self._reached = {}
        self._settle()

    def save(self, request: Mapping[str, Any]) -> None:
        """Send the problem file; also from another thread, while a computation for this document runs."""
        assert self._history is not None
        document, steps = self._document, self._history.steps
        changed = len(steps) < MAX_STEPS and document.changed_on_disk({self._origin, *(step.text for step in steps)})
        self._origin = document.text
        fields = {"text": document.text, "files": document.files, "changed_on_disk": changed}
        self._send({"type": "kept", "id": request["id"], "step": "save"})
        self._send({"type": "file", "id": request["id"], "name": document.file, "media": "application/toml", **fields})

    def _link(self, request: Mapping[str, Any]) -> None:
        if self._document.files:
            remedy = "Send the problem file and that file"
            raise InputError("a link contains no other files", remedy, value=self._document.files[0])
        self._answer("link", fragment=deflated(self._document.text))

    def _export(self, request: Mapping[str, Any]) -> None:
        if self._last is None:
            raise InputError("there is no design yet", "Wait for the search")
        self._answer("file", **exported(self._last[0], self._document, _text(request, "format")))

    def _parts(self, request: Mapping[str, Any]) -> None:
        if self._last is not None:
            self._answer("parts", **parts.document(self._last[0], self._document.problem))

    def _draw(self, request: Mapping[str, Any]) -> None:
        from optlink.studio.curve import CurveSearch, curve_problem

        search = CurveSearch(curve_problem(request.get("points"), closed=bool(request.get("closed"))))
        self._curve = search
        self._interruptible(lambda: search.run(lambda done: self._send(search.message(self._id, done=done))))
        if not search.designs:
            remedy = "Draw a smoother curve, or one without sharp corners"
            raise InputError("no four-bar was found for this curve within its limits", remedy)

    def _choose(self, request: Mapping[str, Any]) -> None:
        if self._curve is None:
            raise InputError("there are no candidates", "Draw a curve first")
        if request.get("candidate") == SIX_BAR:
            self._begin([self._curve.six_bar()])
            return
        chosen = self._curve.design(request.get("candidate"))
        self._begin([self._curve.document], design=chosen)

    def _dyads(self, request: Mapping[str, Any]) -> None:
        """Send the curves of a family of linkages, or the partners of a driver; a driver and a follower are a new design."""
        driver, follower = request.get("driver"), request.get("follower")
        if self._last is None:
            return
        if follower is None:
            self._answer("dyads", **dyads.curves(self._document.problem, self._last[0], driver))
            return
        self._adopt(*dyads.joined(self._document, self._last[0], driver, follower))

    def _solutions(self, request: Mapping[str, Any]) -> None:
        """Send all exact solutions, ranked by a quantity; one that is chosen by its number is a new design."""
        chosen, problem = request.get("chosen"), self._document.problem
        if chosen is not None:
            self._adopt(*solutions.chosen(self._document, self._exact, chosen))
            return
        by = _text(request, "by", "").strip() or None
        self._exact = self._interruptible(lambda: exact(problem, by))
        self._answer("solutions", **solutions.document(self._exact))

    def _adopt(self, document: Document, design: Design) -> None:
        """Show a validated design that is the start of the search in its document, as a step."""
        assert self._history is not None
        if document.text != self._document.text:
            self._history.add(document)
            self._answer("kept", step="add", document=document.message())
        self._design, self._reached, self._settled = design, {}, (document.problem.hash, design)
        self._answer("kept", step="settled")
        self._show(design, document.problem, moving=False)

    # --- designs ------------------------------------------------------------------------------------------------------------

    def _definite(self, problem: ProblemFile) -> ProblemFile:
        """Return a problem with the assembly modes of the last design."""
        if self._design is None:
            return problem.variants()[0] if problem.model.free else problem
        return in_modes(problem, self._design)

    def _followed(self, problem: ProblemFile) -> Design:
        """Return the optimum of a problem near the last design."""
        last = self._design or started(problem)
        if kind_of(problem).slow_programme and self._follower[0] != structure(problem):  # it is prepared after a release
            return carried_design(problem, last)
        follower = self._follower_of(problem, last)
        solution = None if follower is None else follower.follow(problem, last.solution)
        if solution is None:
            return carried_design(problem, last)
        if solution.usable:
            return from_solution(problem, solution)
        from optlink.studies.reoptimise_task import conflicting

        violated, at_bound = conflicting(solution)
        words = f"No design near the last one meets all limits: {'; '.join((*violated, *at_bound)) or 'no design was found'}."
        return replace(carried_design(problem, last), status="infeasible", conclusion=words, conflicts=(words,))

    def _follower_of(self, problem: ProblemFile, last: Design) -> Follower | None:
        """Return the present follower, or a new one if the problem has another structure; None without design variables."""
        own = structure(problem)
        if self._follower[0] != own:
            direction, kind = -1 if last.speed < 0.0 else 1, kind_of(problem)
            self._follower = own, kind.follower(problem, last.values, direction) if problem.model.free else None
        return self._follower[1]

    def _bisect(self, handle: Handle, base: ProblemFile, request: Mapping[str, Any]) -> None:
        """Find how far a handle could be dragged, and show it."""
        begin, end = handle.place, handle.place_of(request)
        if begin is None or end is None:
            return
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            place = [a + middle * (b - a) for a, b in zip(begin, end, strict=True)]
            try:
                followed = self._followed(self._definite(base.override(handle.changes(base, handle.message(place)))))
                good = followed.solution is not None
            except InputError:
                good = False
            low, high = (middle, high) if good else (low, middle)
        self._reached = {handle.id: handle.reached([a + low * (b - a) for a, b in zip(begin, end, strict=True)])}
        if self._last is not None:
            self._show(*self._last, moving=False)

    def _show_moving(self, base: ProblemFile, changes: Mapping[str, object]) -> None:
        """Show the optimum of a changed problem; if the change is impossible, that of the last one with the reason."""
        try:
            definite = self._definite(base.override(changes))
        except InputError as error:
            if self._design is None:
                raise
            impossible = replace(self._design, **failure(error, "infeasible"))
            self._show(impossible, self._definite(base), moving=True)
            return
        design = self._followed(definite)
        if design.status != "infeasible" or self._design is None:
            self._show(design, definite, moving=True)
            self._design = design
        else:
            self._show(replace(self._design, **verdict(design)), definite, moving=True)

    def _commit(self, document: Document) -> None:
        _ = document.problem
        assert self._history is not None
        if document.text != self._document.text:
            self._history.add(document)
            self._answer("kept", step="add", document=document.message())
        self._reached = {}
        self._settle()

    def _settle(self) -> None:
        """Show the optimum near the last design with its validation, then the result of the ordinary search."""
        problem, ident = self._document.problem, self._id
        if self._design is not None and not same_parts(problem, self._design.problem):
            self._design = None  # its dimensions and assembly modes are those of other parts
        self._answer("kept", step="settled")  # the document can be saved from now on
        if self._settled is not None and self._settled[0] == problem.hash:  # nothing that the result depends on has changed
            self._design = self._settled[1] if self._settled[1].result is not None else self._design
            self._show(self._settled[1], problem, moving=False)
            self._interruptible(self._prepare)
            return
        near = self._show_near(problem)

        def progress(share: float) -> None:
            self._send({"type": "progress", "id": ident, "fraction": share, "text": "searching"})

        try:
            design: Design = self._interruptible(lambda: solved_design(problem, progress))
        except OptlinkError as error:  # the page must not keep the state of another problem
            failed = failure(error)
            failed["conflicts"] = (*near, *failed["conflicts"])
            self._show(replace(self._design or started(problem), **failed), problem, moving=False)
            return
        if getattr(design.result, "interrupted", False):
            raise KeyboardInterrupt
        if design.status != "infeasible" or self._design is None:
            self._design = design
            self._show(design, problem, moving=False)
        else:
            if near and not design.conflicts:  # the search says less than the optimum near the last design
                design = replace(design, conclusion=f"{' '.join(near)} {NONE_TEXT}", conflicts=near)
            design = replace(self._design, **verdict(design))
            self._show(design, problem, moving=False)
        self._settled = problem.hash, design
        self._interruptible(self._prepare)

    def _show_near(self, problem: ProblemFile) -> tuple[str, ...]:
        """Show the optimum near the last design, else that design; never the verdict of another problem. Return the conflicts."""
        last = self._design
        if last is None:
            self._show(replace(started(problem), conclusion=SEARCHING_TEXT), problem, moving=False, searching=True)
            return ()
        definite = self._definite(problem)
        near = carried_design(definite, last)
        if last.solution is not None and problem.model.free:
            near = self._followed(definite)
            settle = getattr(self._follower[1], "refined", None)
            if near.solution is not None and settle is not None:
                begun = near.solution
                try:
                    near = from_solution(definite, self._interruptible(lambda: settle(begun)))
                except KeyboardInterrupt:
                    self._show(near, problem, moving=False, searching=True)
                    raise
        if near.solution is not None and near.solution.usable:
            validated = validated_design(near)
            self._design = (
                replace(validated, conclusion=FIRST_TEXT)
                if validated.status == "verified"
                else replace(near, conclusion=SEARCHING_TEXT)
            )
            self._show(self._design, problem, moving=False, searching=True)
        elif near.status == "infeasible":
            self._show(replace(last, **verdict(near)), problem, moving=False, searching=True)
        else:
            near = replace(near, conclusion=SEARCHING_TEXT) if problem.model.free else near
            self._show(near, definite, moving=False, searching=True)
        return near.conflicts

    def _prepare(self) -> None:
        """Build the programme of the present problem, so that the next drag finds it."""
        last = self._design
        if last is not None and last.solution is not None and last.solution.usable:
            self._follower_of(self._definite(self._document.problem), last)

    # --- the state ----------------------------------------------------------------------------------------------------------

    def _show(self, design: Design, problem: ProblemFile, *, moving: bool, searching: bool = False) -> None:
        """Send the state of a design; `searching`: whether the full search for a better one runs."""
        assert self._history is not None
        problem, done = in_modes(problem, design), time.perf_counter()
        try:
            regions = regions_of(problem, design.checks or ())
            picture: Picture | None = Picture(design.machine, design.start, design.speed, regions, problem.model.driving)
        except (ArithmeticError, ValueError):
            picture = None
        if not problem.model.free:
            design = moved_machine(design, None if picture is None else picture.complete)
        self._verdict, self._last = design.status, (design, problem)
        self._handles = handles(problem, picture)
        if moving:  # no handle vanishes, or becomes another one, under the hand
            self._handles = {
                name: new if same_kind(new := self._handles.get(name), rest) else rest for name, rest in self._rest.items()
            }
        else:
            self._rest = self._handles
        undo, redo = self._history.ends
        document = self._document
        title = str(problem.model.title or document.name)
        message: dict[str, Any] = {
            "type": "state",
            "id": self._id,
            "moving": moving,
            "searching": searching,
            "document": {
                "name": document.name,
                "title": title,
                "changed": document.text != self._origin,
                "can_undo": undo,
                "can_redo": redo,
            }
            | ({} if moving else {"text": document.text}),
            "kind": kind_of(problem).name(problem.model),
            "status": design.status,
            "conclusion": pretty(design.conclusion),
            "targets": state.targets(problem, design),
            "handles": [handle.document() | self._reached.get(handle.id, {}) for handle in self._handles.values()],
            "variables": state.variables(problem, design, document.freed),
            "objective": state.objective(problem, design.objective),
            "active": state.active(design),
            "checks": state.checks(design),
            "unchecked": design.unchecked,
            "conflicts": [pretty(words) for words in design.conflicts],
            "scene": None if picture is None else picture.document(),
            "charts": [] if picture is None else state.charts(design, picture, problem),
        }
        if not moving:
            message |= {"tables": forms.groups(document.problem), "names": kinds(document.problem)}
            message["renamable"] = own_names(document.problem)
            message |= {"dyads": dyads.offered(document.problem), "solutions": solutions.offered(document.problem)}
            message["pivots"] = region.shown(document.problem)
        total = time.perf_counter()
        message["seconds"] = {"solve": done - self._begun, "total": total - self._begun}
        self._send(message)


def warm() -> None:
    """Import what the first request would otherwise wait for."""
    from optlink.studio import curve, document as files
    from optlink.tasks import certify, design
    from optlink.tasks.analyze import analyze

    solved_design(load("crank-rocker"))
    forms.groups(load("six-bar"))
    _ = certify, design, analyze, curve, files


def warm_drawing() -> None:
    """Import and run in advance, while the server is idle, the code for drawn curves and paths."""
    from optlink.studio.curve import CurveSearch, curve_problem

    CurveSearch(curve_problem([[50.0, 0.0], [-20.0, 40.0], [-30.0, -40.0]], closed=True), WARM_UP_TIME).run(lambda done: None)


OPENING = ("start", "open", "new", "draw", "choose", "resume")

_ACTIONS: dict[str, Callable[[Session, Mapping[str, Any]], None]] = {
    "start": lambda session, request: session._begin([named(_text(request, "name"))]),  # any file: of the command line
    "open": Session._open,
    "new": lambda session, request: session._begin([from_template(_text(request, "template"))]),
    "resume": Session._resume,
    "drag": Session._drag,
    "set": Session._set,
    "edit": Session._edit,
    "region": lambda session, request: session._change(region.changes(session._document.problem, request.get("box"))),
    "rename": Session._rename,
    "lock": Session._lock,
    "search": Session._search,
    "undo": Session._undo,
    "redo": Session._undo,
    "save": Session.save,
    "link": Session._link,
    "export": Session._export,
    "draw": Session._draw,
    "choose": Session._choose,
    "dyads": Session._dyads,
    "solutions": Session._solutions,
    "parts": Session._parts,
}


def _text(request: Mapping[str, Any], key: str, default: str | None = None) -> str:
    """Return a text of a request."""
    value = request.get(key, default)
    if not isinstance(value, str):
        raise InputError("expected a text", f"Send {key} as a text", key=key, value=value)
    return value
