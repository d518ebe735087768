"""Options of the proof of a global optimum: useless and impossible ones are refused in one sentence."""

import pytest

from optlink.tasks.results.certificate import share_text


@pytest.mark.parametrize(
    ("share", "words"),
    [
        *((1.0, "100 %"), (0.3, "30 %"), (0.305, "31 %"), (0.04321, "4.4 %"), (1e-6, "0.0001 %"), (9.99e-5, "0.01 %")),
        *((2e-12, "0.0000000002 %"), (0.0, "rounding errors")),
    ],
)
def test_shares_are_rounded_up_with_all_their_zeros(share, words):
    assert share_text(share) == words
