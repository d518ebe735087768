"""The requests of a page: what is shown, what is saved, what is refused."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.problem.file import read
from optlink.problem.toml_text import rewritten
from optlink.studies.grid import exact_text, knobs
from optlink.studio import design as state
from optlink.studio.curve import curve_problem
from optlink.studio.design import design_of
from optlink.studio.document import Document, deflated, from_template, from_text, inflated, named, tables
from optlink.studio.session import Session
from optlink.studio.worker import Interrupts


class Page:
    """A page without a browser: its session and what it was sent; `patient`: whether it waits after the first state."""

    def __init__(self, patient: bool = True) -> None:
        self.sent: list[Mapping[str, Any]] = []
        self.patient, self.ident = patient, 0
        self.session = Session(self.sent.append, self._interruptible)

    def _interruptible(self, work: Callable[[], Any]) -> Any:
        if not self.patient and any(message["type"] == "state" for message in self.sent):
            raise KeyboardInterrupt
        return work()

    def ask(self, kind: str, **fields: Any) -> list[Mapping[str, Any]]:
        """Send a request; return the answers to it, which must be plain JSON."""
        self.ident += 1
        del self.sent[:]
        self.session.handle({"type": kind, "id": self.ident, **fields})
        answers = [message for message in self.sent if message["type"] not in ("progress", "kept")]
        assert all(message["id"] == self.ident for message in answers)
        json.dumps(answers, allow_nan=False)
        return answers

    def state(self, kind: str, **fields: Any) -> Mapping[str, Any]:
        """Send a request; return the last state that answers it."""
        answers = self.ask(kind, **fields)
        assert answers[-1]["type"] == "state", answers[-1]
        return answers[-1]


@pytest.fixture(scope="module")
def page() -> Page:
    made = Page()
    made.ask("open", name="crank-rocker")
    return made


def saved(page: Page) -> optlink.ProblemFile:
    return read(tables(page.ask("save")[0]["text"], "saved.toml"))


def values(state: Mapping[str, Any]) -> dict[str, float]:
    return {one["name"]: one["value"] for one in state["variables"]}


def test_a_move_shows_the_optimum_of_the_moved_problem_without_a_verdict(page: Page) -> None:
    """For every kind of number that is a parameter of the programme: the same optimum as a search from the start."""
    for handle, value in (
        ("mechanism.frame", 530.0),
        ("mechanism.crank", 90.0),
        ("requirement.span", 84.0),
        ("limits.transmission_angle.min", 50.0),
        ("limits.transmission_angle.max", 130.0),
    ):
        state = page.state("drag", handle=handle, value=value, moving=True)
        assert state["status"] == "not verified"
        assert state["checks"] is None
        unit = "mm" if handle.startswith("mechanism") else "deg"
        best = optlink.solve(optlink.load("crank-rocker", {handle: f"{value} {unit}"}), certify=False)
        for name, computed in values(state).items():
            assert computed == pytest.approx(1e3 * best.design[name], rel=1e-9), handle


def test_a_released_design_agrees_with_the_saved_file(page: Page) -> None:
    page.ask("drag", handle="mechanism.frame", value=512.0, moving=True)
    state = page.state("drag", handle="mechanism.frame", value=512.5, moving=False)
    assert state["status"] == "verified"
    assert all(check["ok"] for check in state["checks"])
    again = optlink.solve(saved(page))
    assert values(state) == pytest.approx({n: 1e3 * again.design[n] for n in ("coupler", "rocker")}, rel=1e-9)
    text = page.ask("save")[0]["text"]
    assert 'frame = "512.5 mm"' in text
    assert "[expected]" not in text
    assert state["document"] == {
        "name": "crank-rocker", "title": state["document"]["title"], "changed": True, "can_undo": True, "can_redo": False,
        "text": text,
    }  # fmt: skip
    back = page.state("undo")
    assert back["document"]["changed"]  # from the file that was saved
    assert back["document"]["can_redo"]
    assert "[expected]" in page.ask("save")[0]["text"]


@pytest.mark.slow
def test_an_infeasible_limit_is_reported_with_its_boundary(page: Page) -> None:
    before = page.state("drag", handle="mechanism.frame", value=500.0, moving=False)
    moved = page.state("drag", handle="limits.transmission_angle.min", value=88.0, moving=True)
    assert moved["status"] == "infeasible"
    assert "transmission angle" in moved["conflicts"][0]
    assert values(moved) == pytest.approx(values(before))  # the last feasible linkage stays
    state = page.state("drag", handle="limits.transmission_angle.min", value=88.0, moving=False)
    assert state["status"] == "infeasible"
    low, high = next(one["feasible"] for one in state["handles"] if one["id"] == "limits.transmission_angle.min")
    assert low == 45.0
    for angle, feasible in ((high - 0.5, True), (high + 0.5, False)):
        edge = optlink.load("crank-rocker", {"limits.transmission_angle.min": f"{angle} deg"})
        assert optlink.solve(edge, certify=False).valid is feasible
    page.ask("undo")
    short = page.state("drag", handle="mechanism.frame", value=30.0, moving=True)
    assert "crank ≤ frame" in short["conclusion"]
    assert "<=" not in " ".join((short["conclusion"], *short["conflicts"]))


def test_a_locked_size_keeps_its_value_and_is_released_within_its_bounds(page: Page) -> None:
    state = page.state("lock", size="coupler", locked=True)
    coupler = next(one for one in state["variables"] if one["name"] == "coupler")
    assert coupler["locked"]
    assert "mechanism.coupler" in [handle["id"] for handle in state["handles"]]
    moved = page.state("drag", handle="mechanism.coupler", value=coupler["value"] + 20.0, moving=False)
    assert values(moved)["coupler"] == pytest.approx(coupler["value"] + 20.0)
    state = page.state("lock", size="coupler", locked=False)
    assert saved(page).raw["mechanism"]["coupler"]["bounds"] == ["100 mm", "900 mm"]
    assert values(state)["coupler"] == pytest.approx(coupler["value"], rel=1e-7)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"type": "set", "key": "mechanism.cranc", "value": "1 mm"}, 'Did you mean "crank"'),
        ({"type": "drag", "handle": "mechanism.frame", "value": float("inf")}, "no usable place"),
        ({"type": "drag", "handle": "mechanism.frame", "value": [1.0]}, "no usable place"),
        ({"type": "drag", "handle": "no.such", "value": 1.0}, "no such handle"),
        ({"type": "set", "key": "mechanism.frame", "value": "nan mm"}, "mechanism.frame"),
        ({"type": "set", "key": "requirement.law", "value": '{ csv = "/etc/hostname" }'}, "cannot name a file"),
        ({"type": "lock", "size": "neck", "locked": True}, "no such dimension"),
        ({"type": "open", "text": "a = [", "title": "x"}, "not valid TOML"),
        ({"type": "open", "text": "a = " + "[" * 5000, "title": "x"}, "nested too deeply"),
        ({"type": "open", "fragment": "***"}, "the link contains no problem"),
        ({"type": "open", "name": "/etc/hostname"}, "no such shipped problem"),
        ({"type": "draw", "points": [[0, 0], [1, 1]]}, "3 to 10,000 points"),
        ({"type": "draw", "points": [[0, 0]] * 9, "closed": True}, "smaller than"),
        ({"type": "choose", "candidate": 0}, "no candidates"),
        ({"type": "export", "format": "exe"}, "unknown format"),
    ],
)
def test_bad_requests_give_one_fault_and_change_nothing(page: Page, request_: dict[str, Any], words: str) -> None:
    before = page.ask("save")[0]["text"]
    answers = page.ask(**{("kind" if key == "type" else key): value for key, value in request_.items()})
    assert [answer["type"] for answer in answers] == ["fault"]
    assert words in answers[0]["message"]
    assert page.ask("save")[0]["text"] == before


@pytest.mark.parametrize(
    ("handle", "value", "words"),
    [
        ("mechanism.frame", -5.0, "A length must be positive."),
        ("limits.transmission_angle.min", 150.0, "The lower limit is above the upper."),
        ("mechanism.coupler.bounds", [300.0, 300.0], "Both bounds are the same."),
    ],
)
def test_a_drag_to_an_impossible_value_is_refused_with_a_reason(page: Page, handle: str, value: Any, words: str) -> None:
    before = page.state("search")
    moved = page.state("drag", handle=handle, value=value, moving=True)
    assert moved["status"] == "infeasible"
    assert moved["conclusion"].startswith(words)
    assert values(moved) == values(before)
    fault, *states = page.ask("drag", handle=handle, value=value, moving=False)
    assert fault["type"] == "fault"
    assert fault["message"].startswith(words)
    assert fault["message"].endswith("as before the drag.")
    assert states[-1]["status"] == "verified"
    assert states[-1]["document"] == before["document"]
    assert values(states[-1]) == pytest.approx(values(before), rel=1e-9)


def test_a_limit_that_is_dragged_to_zero_keeps_its_handle(page: Page) -> None:
    page.ask("drag", handle="limits.transmission_angle.min", value=0.0, moving=True)
    back = page.state("drag", handle="limits.transmission_angle.min", value=40.0, moving=True)
    assert back["status"] == "not verified"
    page.patient = False
    zero = page.state("drag", handle="limits.transmission_angle.min", value=0.0, moving=False)
    page.patient = True
    assert next(one["value"] for one in zero["handles"] if one["id"] == "limits.transmission_angle.min") == 0.0
    page.state("undo")


def test_handles_keep_their_kind_while_one_is_dragged() -> None:
    """Also a pivot that is dragged over another joint, and links that no longer meet."""
    page = Page()
    rest = {one["id"]: (one["kind"], "at" in one) for one in page.state("open", name="six-bar")["handles"]}
    for x in (1500.0, 1200.0, 400.0, 0.0, -300.0):
        state = page.state("drag", handle="mechanism.ground.D.x", at=[x, 0.0], moving=True)
        assert {one["id"]: (one["kind"], "at" in one) for one in state["handles"]} == rest
    page.ask("drag", handle="mechanism.ground.D.x", at=[1500.0, 0.0], moving=True)
    for length, status, words in (
        (1100.0, "not verified", "these dimensions."),
        (900.0, "not verified", "at every position of its drive."),
        (100.0, "infeasible", "cannot be assembled at any position of its drive."),
        (1150.0, "not verified", "these dimensions."),
    ):
        state = page.state("drag", handle="mechanism.links.link2.length", value=length, moving=True)
        assert {one["id"]: (one["kind"], "at" in one) for one in state["handles"]} == rest
        assert (state["status"], words in state["conclusion"]) == (status, True), (length, state["conclusion"])


def test_a_traced_point_belongs_to_its_body() -> None:
    """Its path has the colour of that body, not of the last one."""
    scene = Page(patient=False).ask("open", name="path-arc5")[0]["scene"]
    assert scene["owner"] == {"P": "coupler"}
    assert scene["bodies"][-1]["name"] == "rocker"


def test_saving_says_that_an_editor_has_changed_the_file(tmp_path: Path) -> None:
    """Who copies the saved file over it would lose that change without notice."""
    file = tmp_path / "mine.toml"
    text = named("crank-rocker").text
    file.write_text(text, encoding="utf-8")
    page = Page(patient=False)
    page.ask("start", name=str(file))
    page.ask("set", key="mechanism.frame", value="510 mm")
    (answer,) = page.ask("save")
    assert not answer["changed_on_disk"]
    file.write_text(answer["text"], encoding="utf-8")  # the saved file in its place
    page.ask("set", key="mechanism.frame", value="520 mm")
    assert not page.ask("save")[0]["changed_on_disk"]
    file.write_text(text.replace("100 mm", "101 mm"), encoding="utf-8")
    assert page.ask("save")[0]["changed_on_disk"]
    file.unlink()
    assert not page.ask("save")[0]["changed_on_disk"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("kind", ["pipe", "device", "too long", "folder"])
def test_saving_and_opening_do_not_wait_for_a_file_that_is_none(tmp_path: Path, kind: str) -> None:
    """Another program can put anything in the place of a file that is open."""
    file = tmp_path / "mine.toml"
    file.write_text(named("scotch-yoke").text, encoding="utf-8")
    page, answers = Page(patient=False), list[Any]()
    page.ask("start", name=str(file))
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    elif kind == "device":
        file.symlink_to("/dev/zero")
    elif kind == "folder":
        file.mkdir()
    else:
        file.write_text("# " + 2_000_000 * "x", encoding="utf-8")

    def work() -> None:
        answers.extend(page.ask("save"))
        answers.extend(page.ask("start", name=str(file)))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(20.0)
    assert [answer["type"] for answer in answers] == ["file", "fault"]
    assert answers[0]["changed_on_disk"]
    words = {"pipe": "a pipe or a device", "device": "a pipe or a device", "folder": "a folder", "too long": "larger than"}
    assert words[kind] in answers[1]["message"]


def test_no_file_can_lie_beside_a_problem_without_a_folder() -> None:
    """Such a name must not be one that another user of the machine could make."""
    line = [[100.0 * math.cos(t), 50.0 * math.sin(t)] for t in np.linspace(0.0, 6.0, 20)]
    text = named("toggle-press").text
    for document in (from_template("wiper"), from_template("path"), from_text(text, "law"), curve_problem(line, closed=True)):
        assert document.problem.model is not None
        with pytest.raises(FileExistsError):
            (document.folder / document.file).parent.mkdir(parents=True)
        with pytest.raises(NotADirectoryError):
            (document.folder / document.file).write_text("")


def test_an_export_that_cannot_be_written_is_a_fault(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    (fault,) = page.ask("export", format=["dxf"])
    assert "expected a text" in fault["message"]

    def full(*arguments: Any, **more: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryDirectory", full)
    (fault,) = page.ask("export", format="dxf")
    assert fault["message"].startswith("A file cannot be read or written: No space left on device.")


def test_a_text_from_the_page_cannot_read_files(tmp_path: Any) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("x,y\n1,2\n3,4\n5,6\n", encoding="utf-8")
    text = named("path-ellipse10").text
    begin = text.index("points = [\n")
    hostile = text[:begin] + f'points = {{ csv = "{secret}" }}\n' + text[text.index("]\n\n[limits]") + 2 :]
    answers = Page().ask("open", text=hostile, title="x")
    assert [answer["type"] for answer in answers] == ["fault"]
    assert "cannot read other files" in answers[0]["message"]


def test_files_that_a_problem_reads_are_named_and_not_linked(tmp_path: Any) -> None:
    """A problem file that is saved or sent without them cannot be solved."""
    text = named("path-ellipse10").text
    begin = text.index("points = [\n")
    (tmp_path / "points.csv").write_text("x_mm,y_mm\n0,0\n10,5\n20,0\n", encoding="utf-8")
    (tmp_path / "a.toml").write_text(
        text[:begin] + 'points = { csv = "points.csv" }\n' + text[text.index("]\n\n[limits]") + 2 :], encoding="utf-8"
    )
    page = Page(patient=False)
    page.ask("start", name=str(tmp_path / "a.toml"))
    assert page.ask("save")[0]["files"] == ["points.csv"]
    (fault,) = page.ask("link")
    assert (fault["type"], "contains no other files" in fault["message"]) == ("fault", True)
    page.ask("open", name="crank-rocker")
    assert page.ask("save")[0]["files"] == []
    assert page.ask("link")[0]["type"] == "link"


@pytest.mark.slow
def test_a_conclusion_writes_every_length_in_mm() -> None:
    conclusion = design_of(optlink.solve(optlink.load("path-bean"))).conclusion
    assert "root mean square 0.1382 mm" in conclusion
    assert "µm" not in conclusion


def test_a_link_holds_the_problem_and_no_more_than_a_file() -> None:
    text = named("motion-3-poses").text
    assert inflated(deflated(text)) == text
    with pytest.raises(optlink.InputError, match="longer than"):
        inflated(deflated("a" * 50_000_000))


@pytest.mark.parametrize(
    "name", ["crank-rocker", "path-closed18", "shaper-design", "law-six-bar", "function-log10", "toggle-press"]
)
def test_a_changed_text_has_the_changed_values_and_all_other_lines(name: str) -> None:
    document = named(name)
    for knob in [knob for knob in knobs(document.problem) if knob.value][:4]:
        change = {knob.key: exact_text(1.01 * knob.value, knob.unit)}
        changed = document.with_changes(change)
        assert changed.problem.raw == document.problem.override(change).raw
        lost = set(document.text.splitlines()) - set(changed.text.splitlines())
        gone = document.text.partition("[expected]")[2].splitlines()
        assert len(lost - {"[expected]", *gone}) <= 1, knob.key


def test_a_section_is_written_again_where_its_layout_cannot_be_kept() -> None:
    text = 'title = "x"\n# kept\n[limits]\ncrank = "full rotation" # told\n'
    old, new = tables(text, ""), {"title": "x", "limits": {"crank": "span", "link_ratio": [0.1, 9.0]}}
    changed = rewritten(text, old, new)
    assert tables(changed, "") == new
    assert "# kept" in changed


def test_a_released_dimension_stays_in_its_line() -> None:
    document = named("balance-four-bar")
    lines, released = document.text.splitlines(), document.released("crank").text.splitlines()
    at = lines.index('crank = "50.8 mm"')
    assert released[at].startswith("crank = {bounds = [")
    assert released[:at] + released[at + 1 : at + 9] == lines[:at] + lines[at + 1 : at + 9]


def test_the_title_of_a_document_is_no_path() -> None:
    from optlink.studio.document import from_text

    document = from_text(named("crank-rocker").text, "../../etc/x y;.toml")
    assert isinstance(document, Document)
    assert document.file == "xy.toml"


@pytest.mark.parametrize(
    ("name", "handle", "value"),
    [
        ("stroke-crank-rocker", "mechanism.frame", 500.0),
        pytest.param("stroke-crank-rocker", "mechanism.frame", 2.0, marks=pytest.mark.slow),
        pytest.param("crank-rocker", "mechanism.crank", 480.0, marks=pytest.mark.slow),
        pytest.param("crank-rocker", "limits.transmission_angle.min", 88.0, marks=pytest.mark.slow),
    ],
)
def test_a_conflict_outlives_the_release(name: str, handle: str, value: float) -> None:
    """With no price and no objective of the last design, and with the handle where the hand has left it."""
    page = Page()
    begun = page.state("open", name=name)
    moved = page.state("drag", handle=handle, value=value, moving=True)
    assert moved["status"] == "infeasible"
    states = page.ask("drag", handle=handle, value=value, moving=False)
    assert len(states) > 2
    rest = next(one for one in begun["handles"] if one["id"] == handle)
    for shown in states:
        assert shown["status"] in ("infeasible", "failed")
        assert moved["conflicts"][0] in shown["conflicts"] or "cannot be met" in shown["conclusion"], shown["conclusion"]
        assert (shown["active"], shown["objective"]["value"], shown["checks"]) == ([], None, None)
        assert shown["unchecked"] == "No validated design."
        (knob,) = (one for one in shown["handles"] if one["id"] == handle)
        assert knob["value"] == pytest.approx(value)
        if "at" in rest and "along" in rest:
            shift = np.subtract(knob["at"], rest["at"]) @ np.array(rest["along"])
            assert handle != "mechanism.frame" or shift == pytest.approx(value - rest["value"])
    low, high = knob["feasible"]
    assert low < high
    assert not low <= value <= high
    assert page.state("undo")["active"] != []


def test_a_machine_that_cannot_be_assembled_stays_so_after_the_release() -> None:
    page = Page()
    state = page.state("open", name="balance-four-bar")
    assert "agree" in state["unchecked"]
    first, last = page.ask("drag", handle="mechanism.coupler", value=5.0, moving=False)
    assert (first["status"], last["status"]) == ("infeasible", "failed")
    assert first["conflicts"]
    assert last["conflicts"]
    assert "cannot be assembled" in first["conclusion"]
    state = Page().state("open", name="oscillating-cylinder")
    assert "no singular position" in state["unchecked"]


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.2, 0.5])
def test_four_bars_for_a_curve_are_sorted_by_the_error_that_they_show(bend: float) -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
    curve = np.column_stack([90.0 * np.cos(t) + 60.0 * bend * np.cos(3.0 * t), 50.0 * np.sin(t) + 70.0 * bend * np.sin(2.0 * t)])
    answers = Page().ask("draw", points=curve.tolist(), closed=True)
    shown = [[item["error"] for item in answer["items"]] for answer in answers]
    assert len(shown[-1]) > 1
    assert shown == [sorted(errors) for errors in shown]


@pytest.mark.slow
def test_a_drawn_curve_gets_four_bars_and_a_drawing() -> None:
    page = Page()
    t = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    curve = np.column_stack([100.0 * np.cos(t) + 15.0 * np.cos(2.0 * t), 60.0 * np.sin(t)]).tolist()
    answers = page.ask("draw", points=curve, closed=True)
    assert [answer["type"] for answer in answers] == ["candidates"] * len(answers)
    assert answers[-1]["done"]
    best = answers[-1]["items"][0]
    assert best["valid"]
    assert best["error"] < 2.0
    assert len(best["curve"]) == len(best["scene"]["drive"]["values"])
    page.patient = False
    assert {design.assembly for design in page.session._curve.designs} == {"left", "right"}
    for k, item in list(enumerate(answers[-1]["items"]))[::-1]:
        state = page.state("choose", candidate=k)
        assert state["status"] == "verified"
        assert max(point["deviation"] for point in state["targets"]["points"]) == pytest.approx(item["error"], rel=1e-3)
    for format in ("dxf", "svg", "csv", "html"):
        answer = page.ask("export", format=format)[0]
        assert answer["name"] == f"drawn-curve.{format}"
        assert len(answer["data"]) > 1000


@pytest.mark.slow
def test_a_curve_that_four_bars_fit_poorly_gets_a_six_bar_that_starts_with_the_same_curve() -> None:
    page = Page()
    side = np.linspace(-50.0, 50.0, 20, endpoint=False)
    quarter = np.column_stack([side, np.full(20, -50.0)])
    square = np.vstack([quarter, quarter[:, ::-1] * (-1, 1), -quarter, quarter[:, ::-1] * (1, -1)])
    done = page.ask("draw", points=square.tolist(), closed=True)[-1]
    assert done["poor"]
    four_bar = done["items"][0]
    page.patient = False
    state = page.state("choose", candidate="six-bar")
    assert [one["name"] for one in state["scene"]["bodies"]] == ["crank", "coupler", "rocker", "link", "arm"]
    begun = [at for at in state["scene"]["points"]["P"] if at]
    assert len(begun) == 73  # over the whole revolution
    apart = [min(math.dist(at, place) for place in four_bar["curve"] if place) for at in begun]
    assert max(apart) < 0.6 * max(map(math.dist, begun, begun[1:]))  # between its positions


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-closed18", "shaper-design", "motion-3-poses", "stroke-crank-rocker", "law-slider-crank"])
def test_a_followed_optimum_is_validated_on_release(name: str) -> None:
    page = Page()
    state = page.state("open", name=name)
    page.patient = False
    handle = next(h for h in state["handles"] if h["kind"] == "point" or h["id"].startswith(("limits.stroke", "requirement.s")))
    at = np.array(handle.get("at") or [handle["value"]], dtype=float)
    fields = {"at": (at + 0.01).tolist()} if handle["kind"] == "point" else {"value": 1.01 * float(at[0])}
    moved = page.state("drag", handle=handle["id"], moving=True, **fields)
    assert moved["status"] == "not verified"
    released = page.state("drag", handle=handle["id"], moving=False, **fields)
    assert released["status"] == "verified"
    assert released["objective"]["value"] == pytest.approx(moved["objective"]["value"], rel=1e-4, abs=1e-12)


def test_no_verdict_outlives_its_problem() -> None:
    """Where no optimum lies near the last one and the search is stopped, the page must not keep the former verdict."""
    page = Page()
    page.ask("open", name="crank-rocker")

    def stopped(work: Callable[[], Any]) -> Any:
        raise KeyboardInterrupt

    page.session._interruptible = stopped
    assert page.state("drag", handle="limits.transmission_angle.min", value=88.0, moving=False)["status"] == "infeasible"
    assert page.ask("export", format="svg")[0]["type"] == "fault"
    assert page.state("undo")["status"] == "verified"
    assert page.state("redo")["status"] == "infeasible"
    last = page.session._last
    assert last is not None
    assert last[0].checks is None


def test_a_stop_ends_only_the_computation_that_it_means() -> None:
    before = signal.getsignal(signal.SIGINT)
    interrupts = Interrupts()

    def failing() -> None:
        raise SystemError

    try:
        interrupts.begin(1)
        interrupts.stop(1)  # before the computation allows it
        with pytest.raises(KeyboardInterrupt):
            interrupts.within(lambda: 1)
        interrupts.begin(2)
        assert interrupts.within(lambda: 2) == 2
        interrupts.begin(7)
        with pytest.raises(KeyboardInterrupt):  # a library made another error of the interrupt
            interrupts.within(lambda: setattr(interrupts, "_stopped", 7) or failing())
        interrupts.begin(3)
        interrupts.stop(2)  # too late
        with pytest.raises(SystemError):
            interrupts.within(failing)
        assert interrupts.within(lambda: interrupts.stop(2) or 3) == 3
        lost = []

        def busy(seconds: float) -> None:
            end = time.perf_counter() + seconds
            while time.perf_counter() < end:
                time.sleep(0.005)

        def swallowing() -> None:  # as a callback of a library does
            try:
                busy(20.0)
            except KeyboardInterrupt:
                lost.append(True)
            busy(20.0)

        threading.Timer(0.05, interrupts.stop, [3]).start()
        with pytest.raises(KeyboardInterrupt):
            interrupts.within(swallowing)
        assert lost
        interrupts.begin(4)
        sent = []

        def send() -> None:
            with interrupts.held():
                interrupts.stop(4)
                sent.append("whole")

        with pytest.raises(KeyboardInterrupt):
            interrupts.within(send)
        assert sent == ["whole"]
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def benchmark_() -> Any:
    path = Path(__file__).parents[2] / "benchmarks" / "studio.py"
    spec = importlib.util.spec_from_file_location("studio_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_random_drags_show_nothing_as_verified_that_the_validator_rejects(benchmark_: Any) -> None:
    pages = benchmark_.random_drags(("crank-rocker", "stroke-crank-rocker"), 80, seed=2, watch=lambda text: None)
    for page in pages:
        assert page.wrong == []
        assert all(words.endswith("as before the drag.") for words in page.faults)
        assert page.tally["not verified"] > 20
    assert sum(page.tally["judged"] for page in pages) > 1


@pytest.mark.slow
def test_saved_problems_are_solved_to_the_same_design(benchmark_: Any) -> None:
    assert benchmark_.saved_problems(("crank-rocker", "stroke-crank-rocker"), 2, watch=lambda text: None) == []


def test_a_maximised_quantity_has_its_own_sign() -> None:
    raw = {**optlink.load("stroke-crank-rocker").raw, "expected": None}
    raw["objective"] = {"quantity": "transmission angle", "of": "C", "measure": "least", "sense": "maximise"}
    shown = state.objective(read({key: value for key, value in raw.items() if value is not None}), -0.5)
    assert shown is not None
    assert (shown["value"], shown["unit"]) == (pytest.approx(math.degrees(0.5)), "deg")


def test_the_best_transmission_is_shown_as_an_angle() -> None:
    shown = state.objective(optlink.load("transmission-optimal"), math.cos(math.radians(37.73)))
    assert shown == {"label": "transmission angle from 90 deg", "value": pytest.approx(90.0 - 37.73), "unit": "deg"}


LINKED = """
[mechanism]
frame = "500 mm"
crank = "100 mm"
coupler = { start = "400 mm", bounds = ["100 mm", "900 mm"] }
rocker = { equals = "0.5*coupler + 3 mm" }
[requirement]
law = "psi0 + 2/(3*pi)*(phi - phi0)^2"
span = "90 deg"
[limits]
transmission_angle = ["40 deg", "140 deg"]
"""


def test_a_linked_dimension_follows_a_drag_and_is_not_dragged_itself():
    page = Page()
    state = page.state("open", text=LINKED, title="linked")
    rocker = next(one for one in state["variables"] if one["name"] == "rocker")
    assert rocker["equals"] == "0.5*coupler + 3 mm"
    assert "mechanism.rocker" not in [handle["id"] for handle in state["handles"]]
    moved = page.state("drag", handle="mechanism.frame", value=520.0, moving=True)
    best = optlink.solve(read(LINKED).override({"mechanism.frame": "520 mm"}))
    for name in ("coupler", "rocker"):
        assert values(moved)[name] == pytest.approx(1e3 * best.design[name], rel=1e-9)
    for request in (
        {"kind": "drag", "handle": "mechanism.rocker", "value": 240.0, "moving": True},
        {"kind": "lock", "size": "rocker", "locked": True},
        {"kind": "lock", "size": "rocker", "locked": False},
    ):
        (fault,) = page.ask(**request)
        assert fault["type"] == "fault"
        assert "rocker follows from other quantities: it equals 0.5*coupler + 3 mm" in fault["message"]
    page.ask("drag", handle="mechanism.frame", value=520.0, moving=False)
    assert saved(page).raw["mechanism"]["rocker"] == {"equals": "0.5*coupler + 3 mm"}


@pytest.mark.slow
def test_a_new_name_keeps_the_design_and_the_comments_and_is_undone() -> None:
    made = Page()
    before = made.state("new", template="stroke")
    made.state("lock", size="rod.length", locked=True)
    text, made.patient = made.ask("save")[0]["text"], False
    state = made.ask("rename", old="rod", new="conrod")[0]
    assert values(state)["conrod.length"] == values(before)["rod.length"]
    assert "conrod" in state["renamable"]
    assert made.ask("save")[0]["text"] == text.replace("rod = {", "conrod = {").replace('"rod"', '"conrod"')
    made.ask("rename", old="conrod", new="conrod")
    made.ask("lock", size="conrod.length", locked=False)
    assert made.ask("rename", old="conrod", new="A")[0]["message"].endswith(
        "A is the name of a joint. Choose another name for the body conrod"
    )
    for _ in range(2):
        made.ask("undo")
    assert made.ask("save")[0]["text"] == text
