"""Certificates of functions: both assembly modes are searched, and a better design becomes the answer."""

import pytest

import optlink
from optlink.tasks import design
from optlink.tasks.certify import certify

WORSE = {"crank": 0.307958, "coupler": 0.147785, "rocker": 0.15156, "phi0": -0.351946, "psi0": 0.242793}


@pytest.mark.slow
def test_the_certificate_of_a_local_optimum_finds_the_global_one_in_the_other_assembly_mode():
    problem = optlink.load("function-sin")
    right = optlink.load("function-sin", overrides={"mechanism.assembly": "right"})
    local = design.solve(right, "ipopt", begin=WORSE)
    assert local.valid
    assert local.objective == pytest.approx(0.00567908, rel=1e-5)
    result = certify(local, gap=1e-3, original=problem)
    assert result.valid
    assert result.assembly == "left"
    assert result.objective == pytest.approx(problem.spec.expected.objective, rel=1e-6)
    proof = result.certificate
    assert (proof.status, proof.improved, proof.open_boxes) == ("within gap", True, 0)
    assert 0.999 * result.objective <= proof.lower_bound < result.objective
    one_mode = certify(local, gap=1e-3).certificate  # the other mode is no part of this problem
    assert (one_mode.status, one_mode.improved) == ("within gap", False)
    assert one_mode.lower_bound > result.objective
    stopped = certify(local, gap=1e-3, boxes=200, original=problem)
    assert (stopped.certificate.status, stopped.certificate.lower_bound) == ("not closed", 0.0)
