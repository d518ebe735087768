"""optlink: describe a planar linkage and its requirements; get a design that is optimised, verified and explained.

>>> import optlink
>>> result = optlink.solve("crank-rocker")
>>> result.valid, round(result.design["coupler"] * 1e3, 3)
(True, 412.865)
"""

from optlink.namespace import namespace
from optlink.version import VERSION as __version__  # noqa: F401

_DEPRECATED = dict.fromkeys(("four_bar", "grashof", "sweep"), "optlink.linkage") | dict.fromkeys(
    (
        "ClearanceSimulation",
        "Comparison",
        "InverseMotion",
        "Tuning",
        "compare",
        "inverse_model",
        "simulate_clearance",
        "tune",
    ),
    "optlink.control",
)
"""Names of version 0.1 by their present namespaces; docs/stability.md states how long they still work."""
__all__, __getattr__, __dir__ = namespace(__name__, __file__, _DEPRECATED)
