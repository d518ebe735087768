"""Kinematics of planar linkages.

The formulas are elementwise and accept floats, arrays, casadi symbols and jets; the package imports numpy alone.
"""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.linkage: dyads fourbar
    optlink.linkage.arguments: reachable sweep travels
    optlink.linkage.fourbar: GrashofClass four_bar grashof
    optlink.linkage.jet: Jet
    optlink.linkage.mechanism: Mechanism Pose
    optlink.linkage.motion: Motion
    optlink.linkage.roberts: Cognate CouplerLinkage cognates
    optlink.linkage.stroke: Travel
    """,
)
