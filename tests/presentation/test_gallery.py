"""Exact solutions as small moving pictures of a page: a click chooses one."""

import importlib

import numpy as np
import pytest

import optlink
from optlink.presentation.html.gallery import gallery
from tests.as_dyads import as_dyads
from tests.browser import faults, opened


def test_the_page_shows_them_all_in_motion(tmp_path, driver):
    """Each picture passes the first pose; its links keep their lengths."""
    result = optlink.synthesis.exact("motion-5-poses")
    shown = gallery(result)
    assert len(shown.pictures) == shown.count == 12
    first = result.problem.spec.data.columns[0, :2] * 1e3
    for picture, one in zip(shown.pictures, result.exact_solutions.solutions, strict=True):
        points = {name: np.array([place["x"], place["y"]]).T * [1.0, -1.0] for name, place in picture.motion["points"].items()}
        step = np.max(np.linalg.norm(np.diff(points["P"], axis=0), axis=1))
        assert np.min(np.linalg.norm(points["P"] - first, axis=1)) <= step
        coupler = np.linalg.norm(points["C"] - points["B"], axis=1)
        assert coupler == pytest.approx(1e3 * one.values["coupler"], abs=0.02)
        assert picture.reasons == one.reasons
    page = optlink.report(result, tmp_path / "page.html")
    assert opened(driver, page) == ([], [])
    assert faults(driver, "button-name", "list", "nested-interactive", "aria-allowed-attr") == []
    where = "return document.querySelector('.gallery li:nth-child(2) [data-body=crank]').getAttribute('transform')"
    before = driver.execute_script(where)
    driver.execute_script("document.querySelectorAll('.gallery li > button')[1].click()")
    told = driver.execute_script("return document.querySelector('.chosen .told').innerText")
    assert told.startswith(f"2 not usable\n\n{result.exact_solutions.solutions[1].reasons[0]}")
    button = driver.execute_script(
        "const one = document.querySelector('.gallery .controls button'); one.scrollIntoView(); one.click(); return one"
    )
    assert button.text.endswith("Pause")
    wait = importlib.import_module("selenium.webdriver.support.ui").WebDriverWait(driver, 30, 0.05)
    wait.until(lambda shown: shown.execute_script(where) != before)


def test_a_chain_of_dyads_has_pictures():
    shown = gallery(optlink.synthesis.exact(as_dyads(optlink.load("motion-5-poses"))))
    assert all(picture.motion for picture in shown.pictures)
