"""optlink: describe a planar linkage and its requirements; get a design that is optimised, verified and explained.

>>> import optlink
>>> result = optlink.solve("crank-rocker")
>>> result.valid, round(result.design["coupler"] * 1e3, 3)
(True, 412.865)
"""

from optlink.namespace import namespace
from optlink.version import VERSION as __version__  # noqa: F401

_DEPRECATED = {
    **{name: f"optlink.linkage.{name}" for name in ("four_bar", "grashof", "sweep")},
    **{name: f"optlink.control.{name}" for name in ("ClearanceSimulation", "Comparison", "InverseMotion", "Tuning")},
    **{name: f"optlink.control.{name}" for name in ("compare", "inverse_model", "simulate_clearance", "tune")},
    **dict.fromkeys(("CycleResult", "FunctionResult", "PathResult"), "optlink.SynthesisResult"),
    "PathDesign": "optlink.LinkageDesign",
}
"""Names of version 0.1 by those that took their place; they work for as long as docs/stability.md states."""
__all__, __getattr__, __dir__ = namespace(__name__, __file__, _DEPRECATED)
