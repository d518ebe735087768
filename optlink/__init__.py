"""optlink: describe a planar linkage and its requirements; get a design that is optimised, verified and explained.

>>> import optlink
>>> result = optlink.solve("crank-rocker")
>>> result.valid, round(result.design["coupler"] * 1e3, 3)
(True, 412.865)
"""

from optlink.namespace import namespace
from optlink.version import VERSION as __version__  # noqa: F401

__all__, __getattr__, __dir__ = namespace(__name__, __file__)
