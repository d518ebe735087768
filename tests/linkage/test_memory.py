"""Memory of intermediate arrays is used again, not returned to the system and mapped anew."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from optlink.linkage.fourbar import four_bar

sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": np.linspace(0.45, 0.55, 27)[:, None]}
phi = np.linspace(0.0, 6.0, 1440)

def faults():
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    four_bar().pose(sizes, (np.cos(phi), np.sin(phi)))
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begin

faults(), faults()
print(sum(faults() for _ in range(10)))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="describes the allocator of glibc")
def test_a_pose_of_many_designs_needs_no_new_pages() -> None:
    done = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 200  # one of the arrays alone has 76 pages
